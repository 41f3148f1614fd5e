"""Recordings of a unit."""
