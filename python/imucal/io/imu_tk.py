"""Recordings of imu_tk: two ASCII files, accelerometer and gyroscope, with the columns time, x, y, z."""

from __future__ import annotations

import os
from typing import get_args

from imucal.errors import InputError
from imucal.io.sensor_files import read_pair
from imucal.recording.recording import AccelUnit, GyroUnit, Recording

__all__ = ["read_imu_tk"]


def read_imu_tk(
    accel_path: str | os.PathLike[str],
    gyro_path: str | os.PathLike[str],
    *,
    time_unit: str | None = None,
    accel_unit: AccelUnit | None = None,
    gyro_unit: GyroUnit | None = None,
) -> Recording:
    """Read the two files of imu_tk, accelerometer first, gyroscope second.

    time_unit              s (default), ms, us or ns
    accel_unit, gyro_unit  unit of the numbers: raw counts ("lsb", default, as in the data of imu_tk) or SI
                           units

    Files of imu_tk have no header. If a file has a header, the header is used. Files with different time
    stamps are resampled.
    """
    for what, unit, known in (
        ("accel_unit", accel_unit, get_args(AccelUnit)),
        ("gyro_unit", gyro_unit, get_args(GyroUnit)),
    ):
        if unit is not None and unit not in known:
            raise InputError(
                f"{what} is {unit!r}: give one of {', '.join(known)}, and convert other units first"
            )
    return read_pair(accel_path, gyro_path, time_unit=time_unit, accel_unit=accel_unit, gyro_unit=gyro_unit)
