"""A triad (three sensor axes of one kind), and the body frame in which both triads of a unit are expressed.

    measured = sensitivity * true + bias

The sensitivity is the product of scale factors and misalignment. In the calibrations of this package the
accelerometer defines the body frame: its sensitivity is symmetric in the frame "symmetric" and lower
triangular in the frame "triangular", so it has six free entries. In the frame "given", which another program
or the composition of two calibrations defines, it has nine. The gyroscope's sensitivity always has nine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from imucal.arrays import FloatArray, as_matrix
from imucal.errors import InputError

__all__ = [
    "ACCEL_ENTRIES",
    "BASE",
    "FRAMES",
    "GYRO_ENTRIES",
    "Frame",
    "Parameter",
    "Triad",
    "as_estimated_frame",
    "as_frame",
    "base_count",
    "frame_of",
]

Frame: TypeAlias = Literal["symmetric", "triangular", "given"]
FRAMES: Final[tuple[Frame, ...]] = ("symmetric", "triangular", "given")
# For each body frame, row and column of the free entries of the accelerometer's sensitivity, in the order of
# the parameters.
ACCEL_ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "symmetric": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "triangular": ("xx", "yy", "zz", "yx", "zx", "zy"),
    "given": ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"),
}
GYRO_ENTRIES: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
# Number of parameters of both triads in the frames "symmetric" and "triangular". In tables and covariances,
# these parameters precede the parameters of effects.
BASE: Final = 21
# Largest accepted condition number of a sensitivity matrix. The condition number of real triads is below 2.
# If it is 100, two axes are within about a degree of each other, or one axis has almost no sensitivity. The
# correction then multiplies noise and rounding errors by up to 100.
MAX_CONDITION: Final = 100.0


def as_frame(name: str) -> Frame:
    """The body frame of this name; raises InputError for an unknown name."""
    for frame in FRAMES:
        if name == frame:
            return frame
    raise InputError(f"frame is {name!r}: give symmetric or triangular")


def as_estimated_frame(name: str) -> Frame:
    """The body frame of a calibration from recordings; raises InputError for any other name."""
    frame = as_frame(name)
    if frame == "given":
        raise InputError(f"frame is {name!r}: give symmetric or triangular")
    return frame


def base_count(frame: Frame, *, has_gyroscope: bool = True) -> int:
    """Number of parameters of both triads, or of an accelerometer alone, in this body frame."""
    return 3 + len(ACCEL_ENTRIES[frame]) + (3 + len(GYRO_ENTRIES) if has_gyroscope else 0)


def frame_of(sensitivity: FloatArray) -> Frame:
    """Frame "symmetric" or "triangular" if an accelerometer's sensitivity has this form, else "given"."""
    # A symmetric sensitivity must also have positive eigenvalues. For example, a rotation by 180 deg is
    # symmetric but has negative eigenvalues.
    if np.array_equal(sensitivity, sensitivity.T) and bool((np.linalg.eigvalsh(sensitivity) > 0).all()):
        return "symmetric"
    if np.array_equal(sensitivity, np.tril(sensitivity)) and bool((np.diag(sensitivity) > 0).all()):
        return "triangular"
    return "given"


@dataclass(frozen=True, eq=False)
class Triad:
    """Three sensor axes of one kind: sensitivity (3, 3) in raw units per SI unit, bias (3,) in raw units.

    Raises InputError if a shape is wrong, a number is not finite, or the sensitivity is nearly singular.
    """

    sensitivity: FloatArray
    bias: FloatArray

    def __post_init__(self) -> None:
        sensitivity = as_matrix(self.sensitivity, "sensitivity", (3, 3))
        object.__setattr__(self, "sensitivity", sensitivity)
        object.__setattr__(self, "bias", as_matrix(self.bias, "bias", (3,)))
        # The matrix is divided by its largest entry, because squares of the entries may overflow.
        condition = np.linalg.cond(sensitivity / (np.abs(sensitivity).max() or 1.0))
        if not condition < MAX_CONDITION:
            rows = [[float(f"{entry:.4g}") for entry in row] for row in sensitivity.tolist()]
            raise InputError(
                f"the sensitivity {rows} is nearly singular: an axis is missing, or two axes are nearly "
                f"parallel; its condition number is {condition:.3g}, that of a sensor is below "
                f"{MAX_CONDITION:g}"
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
