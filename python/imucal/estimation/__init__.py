"""From recordings to a calibration and its verdict."""
