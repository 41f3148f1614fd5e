"""Estimation of a calibration from recordings, its evaluation, and its verdict."""
