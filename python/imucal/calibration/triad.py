"""Three axes of one kind, and the body frame in which two such triads are expressed.

    measured = sensitivity * true + bias

The sensitivity is the product of scale factors and misalignment. The accelerometer defines the body frame:
its sensitivity is symmetric in the frame "symmetric" and lower triangular in the frame "triangular", so it
has six free entries. The gyroscope's sensitivity has nine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from imucal.arrays import FloatArray, as_matrix
from imucal.errors import InputError

__all__ = ["ACCEL_ENTRIES", "BASE", "FRAMES", "GYRO_ENTRIES", "Frame", "Parameter", "Triad", "as_frame"]

Frame: TypeAlias = Literal["symmetric", "triangular"]
FRAMES: Final[tuple[Frame, ...]] = ("symmetric", "triangular")
# Row and column of the free entries of the sensitivity, in the order of the parameters.
ACCEL_ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "symmetric": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "triangular": ("xx", "yy", "zz", "yx", "zx", "zy"),
}
GYRO_ENTRIES: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
# Number of parameters of both triads, which come before those of effects in a table and in a covariance.
BASE: Final = 21
# Largest condition number of a sensitivity. Real triads are below 2. At 100 two axes are within a degree of
# each
# other, or one is nearly dead, and the correction multiplies noise and rounding by this number.
MAX_CONDITION: Final = 100.0


def as_frame(name: str) -> Frame:
    """The body frame of this name; raises InputError for an unknown name."""
    for frame in FRAMES:
        if name == frame:
            return frame
    raise InputError(f"frame is {name!r}: give symmetric or triangular")


@dataclass(frozen=True, eq=False)
class Triad:
    """Three axes of one kind: sensitivity (3, 3) in raw units per SI unit, bias (3,) in raw units.

    Raises InputError if a shape is wrong, a number is not finite, or the sensitivity is nearly singular.
    """

    sensitivity: FloatArray
    bias: FloatArray

    def __post_init__(self) -> None:
        sensitivity = as_matrix(self.sensitivity, "sensitivity", (3, 3))
        object.__setattr__(self, "sensitivity", sensitivity)
        object.__setattr__(self, "bias", as_matrix(self.bias, "bias", (3,)))
        # Divided by the largest entry, because squares of the entries may overflow.
        condition = np.linalg.cond(sensitivity / (np.abs(sensitivity).max() or 1.0))
        if not condition < MAX_CONDITION:
            raise InputError(
                f"the sensitivity {sensitivity.tolist()} is nearly singular: its condition number is "
                f"{condition:.3g}, that of a sensor is below {MAX_CONDITION:g}: an axis is missing, or two "
                "axes are "
                "nearly parallel"
            )


@dataclass(frozen=True)
class Parameter:
    """One parameter of the sensor model: its value and standard deviation (1 sigma) in `unit`.

    The standard deviation is None if it is not known.
    """

    name: str
    value: float
    std: float | None
    unit: str
