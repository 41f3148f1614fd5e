"""Simulated runs and their truth."""
