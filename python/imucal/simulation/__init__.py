"""Simulated runs, with their truth."""
