"""What is turned and what turns it: the simulated unit and its temperature, the stand, and the motion."""
