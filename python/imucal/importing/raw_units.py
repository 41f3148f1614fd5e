"""Units of raw samples in files of other programs."""

from __future__ import annotations

import math
from typing import Final

from imucal.calibration.triad import Triad
from imucal.errors import InputError
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["UNITS", "in_si", "per_si_unit"]

# For each sensor, the units of raw samples, with the SI unit first. The number of a unit states how many of
# these units equal one SI unit: 0.102 for g, because 1 m/s^2 = 0.102 g. A sample divided by this number is in
# the SI unit. Calibrations are converted to SI units, because recordings are read in SI units.
UNITS: Final[dict[str, dict[str, float]]] = {
    "accelerometer": {"m/s^2": 1.0, "g": 1 / STANDARD_GRAVITY_MPS2, "mg": 1e3 / STANDARD_GRAVITY_MPS2},
    "gyroscope": {"rad/s": 1.0, "deg/s": math.degrees(1.0), "mdeg/s": 1e3 * math.degrees(1.0)},
}


def per_si_unit(sensor: str, unit: str) -> float:
    """One SI unit expressed in `unit`, such as 0.102 for g. Raises InputError for an unknown unit."""
    if unit not in UNITS[sensor]:
        raise InputError(f"the unit of the {sensor} is {unit!r}: give {', '.join(UNITS[sensor])} or lsb")
    return UNITS[sensor][unit]


def in_si(triad: Triad, per_si: float) -> Triad:
    """The triad for samples in SI units, from the triad for samples in a raw unit.

    per_si   one SI unit expressed in the raw unit
    """
    return Triad(triad.sensitivity / per_si, triad.bias / per_si)
