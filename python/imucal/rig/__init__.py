"""Inputs of a simulation: the unit and its temperature, the stand, and the motion."""
