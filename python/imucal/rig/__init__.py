"""The simulated unit and its temperature, the stand, and the motion."""
