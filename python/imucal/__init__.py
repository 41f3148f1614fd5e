"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference."""

from __future__ import annotations

from imucal.errors import FitError, FormatError, ImucalError, InputError, NotEnoughMotionError
from imucal.finding import Finding, Place
from imucal.io import read, write
from imucal.recording import Recording, Source

__all__ = [
    "Finding",
    "FitError",
    "FormatError",
    "ImucalError",
    "InputError",
    "NotEnoughMotionError",
    "Place",
    "Recording",
    "Source",
    "read",
    "write",
]
