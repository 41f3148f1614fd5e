"""Simulation of runs, with their ground truth."""
