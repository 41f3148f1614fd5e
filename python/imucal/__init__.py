"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.

    rec = imucal.read("run.csv")
    result = imucal.calibrate(rec, control=imucal.read("control.csv"))
    result.calibration.save("unit-0042.json")
    rate, force = result.calibration.apply(rec.angular_rate, rec.specific_force)

SI units, rows are samples, a still sensor reads +g on the axis that points up, measured = T true + bias.
"""

from __future__ import annotations

from imucal.calibration import Calibration, Parameter, Provenance, Triad
from imucal.errors import FitError, FormatError, ImucalError, InputError, NotEnoughMotionError
from imucal.finding import Finding, Place
from imucal.io import read, write
from imucal.recording import Recording, Source

__all__ = [
    "Calibration",
    "Finding",
    "FitError",
    "FormatError",
    "ImucalError",
    "InputError",
    "NotEnoughMotionError",
    "Parameter",
    "Place",
    "Provenance",
    "Recording",
    "Source",
    "Triad",
    "read",
    "write",
]
