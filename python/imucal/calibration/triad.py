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

__all__ = ["ACCEL_ENTRIES", "FRAMES", "GYRO_ENTRIES", "Frame", "Parameter", "Triad", "as_frame"]

Frame: TypeAlias = Literal["symmetric", "triangular"]
FRAMES: Final[tuple[Frame, ...]] = ("symmetric", "triangular")
# Row and column of the free entries of the sensitivity, in the order of the parameters.
ACCEL_ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "symmetric": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "triangular": ("xx", "yy", "zz", "yx", "zx", "zy"),
}
GYRO_ENTRIES: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
# Largest condition number of a sensitivity. A larger one means that an axis is missing: its column is zero
# or parallel to another one.
MAX_CONDITION: Final = 1e12


def as_frame(name: str) -> Frame:
    """The body frame of this name; raises InputError for an unknown name."""
    for frame in FRAMES:
        if name == frame:
            return frame
    raise InputError(f"frame is {name!r}: give symmetric or triangular")


@dataclass(frozen=True, eq=False)
class Triad:
    """Three axes of one kind: sensitivity (3, 3) in raw units per SI unit, bias (3,) in raw units.

    Raises InputError if a shape is wrong, a number is not finite, or the sensitivity is singular.
    """

    sensitivity: FloatArray
    bias: FloatArray

    def __post_init__(self) -> None:
        sensitivity = as_matrix(self.sensitivity, "sensitivity", (3, 3))
        object.__setattr__(self, "sensitivity", sensitivity)
        object.__setattr__(self, "bias", as_matrix(self.bias, "bias", (3,)))
        if not np.linalg.cond(sensitivity) < MAX_CONDITION:
            raise InputError(f"the sensitivity {sensitivity.tolist()} has no inverse: an axis is missing")


@dataclass(frozen=True)
class Parameter:
    """One parameter of the sensor model: its value and standard deviation (1 sigma) in `unit`.

    The standard deviation is None if it is not known.
    """

    name: str
    value: float
    std: float | None
    unit: str
