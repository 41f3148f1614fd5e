"""Recordings of a unit: samples of accelerometer and gyroscope, axis remapping, and tables of means."""
