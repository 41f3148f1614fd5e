"""Nominal sensitivities of sensors whose samples are raw counts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np

from imucal.errors import InputError, NotEnoughMotionError
from imucal.recording.recording import Recording
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["nominals_named", "require_nominals"]

# If the median raw acceleration divided by the nominal sensitivity is in this range, the nominal sensitivity
# is in counts per g and not per m/s^2. The range allows for biases and motion.
IN_G: Final = (0.75, 1.25)
# Start of the sentence with which the compiled library offers a model with fewer parameters.
OFFER: Final = "Without more motion"
# Words in the message of the compiled library if the rests and moves leave parameters undetermined. Other
# messages state that there are no usable rests or moves; a model with fewer parameters then does not help.
UNDETERMINED: Final = "not determine"


def require_nominals(recording: Recording, accel_nominal: float | None, gyro_nominal: float | None) -> None:
    """Raise InputError for a nominal sensitivity that cannot be that of the recording.

    This is so if the sensor is not in raw counts, or if the value for the accelerometer is in counts per g.
    """
    for name, nominal, samples, unit in (
        ("accel_nominal", accel_nominal, recording.specific_force, recording.accel_unit),
        ("gyro_nominal", gyro_nominal, recording.angular_rate, recording.gyro_unit),
    ):
        if nominal is not None and samples is not None and unit != "lsb":
            raise InputError(
                f"{name}={nominal} is only for a sensor in raw counts, but {recording.name} is in {unit}, "
                "where the nominal sensitivity is 1: leave it out, or give the columns in counts"
            )
    if accel_nominal is None or recording.specific_force is None or not len(recording):
        return
    size = float(np.nanmedian(np.linalg.norm(recording.specific_force, axis=1))) / accel_nominal
    if IN_G[0] < size < IN_G[1]:
        too = " Give gyro_nominal in lsb per rad/s: lsb per deg/s times 57.29578." if gyro_nominal else ""
        raise InputError(
            f"accel_nominal is in lsb per m/s^2. With {accel_nominal:g} the median acceleration of "
            f"{recording.name} is {size:.3g} m/s^2, so {accel_nominal:g} looks like lsb per g: give "
            f"accel_nominal={accel_nominal / STANDARD_GRAVITY_MPS2:.6g}.{too}"
        )


@contextmanager
def nominals_named(
    unit_data: Sequence[Recording], accel_nominal: float | None, gyro_nominal: float | None
) -> Iterator[None]:
    """Name the missing nominal sensitivities in the message of a NotEnoughMotionError.

    Models with fewer parameters hold some parameters at their nominal values, so for raw counts the compiled
    library offers such a model only if the nominal sensitivities are given.
    """
    try:
        yield
    except NotEnoughMotionError as error:
        first = unit_data[0]
        missing = [
            f"{name}=..., --{name.replace('_', '-')}, in lsb per {unit}"
            for name, nominal, raw_unit, unit in (
                ("accel_nominal", accel_nominal, first.accel_unit, "m/s^2"),
                ("gyro_nominal", gyro_nominal, first.gyro_unit, "rad/s"),
            )
            if raw_unit == "lsb" and nominal is None
        ]
        if not missing or OFFER in str(error) or UNDETERMINED not in str(error):
            raise
        raise NotEnoughMotionError(
            f"{error}. A model with fewer parameters may need less motion, but for raw counts it needs the "
            f"nominal sensitivities ({' and '.join(missing)})",
            error.findings,
        ) from None
