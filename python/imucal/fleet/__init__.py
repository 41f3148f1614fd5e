"""Fleets of units: the store, calibrations on many machines, and statistics over units."""
