"""Stands: drivers of the motors, recording of a unit's samples, and verdicts on units in production."""
