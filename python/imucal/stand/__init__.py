"""Stands: drivers of the motors, recording of the unit, and verdicts on a unit of the production line."""
