"""imu_tk: text files of 21 numbers, one per sensor.

    corrected = T K (raw - B)

A file has the misalignment matrix T and the scale matrix K row by row, then the bias B (CalibratedTriad_ in
calibration.h of imu_tk, save, load and unbiasNormalize). It does not state the raw unit. The unit is inferred
from the scale if the scale permits only one unit.
"""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import Final

import numpy as np

from imucal.calibration.triad import Triad
from imucal.errors import FormatError, InputError
from imucal.importing.raw_units import UNITS, in_si, per_si_unit
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["IMU_TK"]

COUNT: Final = 21
SENSORS: Final = {"acc": "accelerometer", "gyr": "gyroscope"}
# A file of imu_tk does not state its raw unit. A unit is possible if the sensitivity differs from the
# sensitivity of a perfect sensor in this unit by less than this factor. Scale factor errors of MEMS sensors
# are smaller.
SAME_UNIT: Final = 1.3


def recognises(content: Content) -> bool:
    """Whether the file has 21 numbers and nothing else."""
    return content.document is None and len(_numbers(content.text) or ()) == COUNT


def _numbers(text: str) -> list[float] | None:
    words = re.sub(r"#.*", "", text).split()
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of the sensors from one or two files."""
    triads: dict[str, Triad] = {}
    units = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
    given = {"accelerometer": wanted.accel_unit, "gyroscope": wanted.gyro_unit}
    for place, content in enumerate(contents):
        sensor = _sensor(content.name, place, len(contents))
        if sensor in triads:
            raise InputError(f"{content.name}: a second file of the {sensor}: give one of each sensor")
        triad = _triad(content)
        unit = given[sensor] or _unit(content.name, sensor, triad)
        if unit != "lsb":
            triad = in_si(triad, per_si_unit(sensor, unit))
        triads[sensor], units[sensor] = triad, "lsb" if unit == "lsb" else units[sensor]
    return Found(
        triads.get("accelerometer"),
        triads.get("gyroscope"),
        accel_unit=units["accelerometer"],
        gyro_unit=units["gyroscope"],
        missing=("noise",),
    )


def _sensor(name: str, place: int, count: int) -> str:
    """The sensor of a file, from its name, or from its index `place` if there are two files."""
    found = [sensor for word, sensor in SENSORS.items() if word in PurePath(name).name.lower()]
    if len(found) == 1:
        return found[0]
    if count == 2:
        return ("accelerometer", "gyroscope")[place]
    raise InputError(
        f"{name}: an imu_tk file does not state its sensor: give the file of the accelerometer and that of "
        "the gyroscope, in this order, or a name with acc or gyr"
    )


def _triad(content: Content) -> Triad:
    numbers = _numbers(content.text)
    if numbers is None or len(numbers) != COUNT:
        count = "other text" if numbers is None else f"{len(numbers)} numbers"
        raise FormatError(
            f"{content.name} has {count}: an imu_tk calibration has {COUNT} numbers, export it again"
        )
    values = np.array(numbers)
    if not np.isfinite(values).all():
        raise FormatError(f"{content.name}: a number is not finite: export it again")
    misalignment, scale, bias = values[:9].reshape(3, 3), values[9:18].reshape(3, 3), values[18:]
    if (scale != np.diag(np.diag(scale))).any() or not np.diag(scale).all():
        raise FormatError(
            f"{content.name}: the second matrix must be the diagonal of the scales, without zeros: the file "
            "is damaged, or of another program"
        )
    return Triad(np.linalg.inv(misalignment @ scale), bias)


def _unit(name: str, sensor: str, triad: Triad) -> str:
    """The raw unit inferred from the scale. Raises InputError if it is ambiguous."""
    option = "accel_unit" if sensor == "accelerometer" else "gyro_unit"
    si, *others = UNITS[sensor]
    size = float(np.cbrt(abs(np.linalg.det(triad.sensitivity))))
    near = [
        unit for unit, factor in UNITS[sensor].items() if factor / SAME_UNIT <= size <= factor * SAME_UNIT
    ]
    if near == [si]:
        return si
    if not near and size > 2.0:
        return "lsb"
    raise InputError(
        f"{name}: the {sensor} has {size:.4g} raw units per {si}, which may be {' or '.join(near or others)} "
        f"or counts: give {option}='{(near or others)[0]}' or {option}='lsb'"
    )


IMU_TK: Final = Reader(
    name="imu_tk",
    title="imu_tk: text files of both sensors, 21 numbers each",
    program="imu_tk",
    formula="corrected = T K (raw - B), for each sensor",
    source="imu_tk, calibration.h, CalibratedTriad_::unbiasNormalize",
    recognises=recognises,
    read=read,
    without="raw unit, covariance, temperature, noise",
    files=(1, 2),
)
