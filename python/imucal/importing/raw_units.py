"""Units of raw samples in files of other programs."""

from __future__ import annotations

import math
from typing import Final

from imucal.calibration.triad import Triad
from imucal.errors import InputError
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["UNITS", "in_si", "per_si_unit"]

# For each sensor and each unit of raw samples: the size of one SI unit in this unit, such as 0.102 for g,
# because 1 m/s^2 = 0.102 g. The SI unit is first. Samples in a unit divided by this number are samples in the
# SI unit. Recordings are read in SI units.
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
    """The triad converted from a raw unit to raw samples in SI units; one SI unit is `per_si` raw units."""
    return Triad(triad.sensitivity / per_si, triad.bias / per_si)
