"""Recordings of imu_tk: two ASCII files, accelerometer and gyroscope, with the columns time, x, y, z."""

from __future__ import annotations

import os
from typing import get_args

import numpy as np

from imucal.document.source import open_file
from imucal.errors import FormatError, InputError
from imucal.io.table import Table
from imucal.io.text import read_headerless
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import AccelUnit, GyroUnit, Recording
from imucal.units import TICKS_PER_S

__all__ = ["read_imu_tk"]


def read_imu_tk(
    accel_path: str | os.PathLike[str],
    gyro_path: str | os.PathLike[str],
    *,
    time_unit: str = "s",
    accel_unit: AccelUnit = "lsb",
    gyro_unit: GyroUnit = "lsb",
) -> Recording:
    """Read the two files of imu_tk, accelerometer first, gyroscope second.

    time_unit              s, ms, us or ns
    accel_unit, gyro_unit  unit of the numbers: raw counts ("lsb", as in the data of imu_tk) or SI units

    Raises FormatError if the time stamps of the two files differ.
    """
    if time_unit not in TICKS_PER_S:
        raise InputError(f"time_unit is {time_unit!r}: give one of {', '.join(TICKS_PER_S)}")
    for what, unit, known in (
        ("accel_unit", accel_unit, get_args(AccelUnit)),
        ("gyro_unit", gyro_unit, get_args(GyroUnit)),
    ):
        if unit not in known:
            raise InputError(
                f"{what} is {unit!r}: give one of {', '.join(known)}, and convert other units first"
            )
    accel_file, gyro_file = open_file(accel_path), open_file(gyro_path)
    accel_suffix = "lsb" if accel_unit == "lsb" else "mps2"
    gyro_suffix = "lsb" if gyro_unit == "lsb" else "radps"
    accel = read_headerless(accel_file, _names(time_unit, "accel", accel_suffix), 0)
    gyro = read_headerless(gyro_file, _names(time_unit, "gyro", gyro_suffix), 0)
    _require_same_time(accel, gyro)
    both = Table(
        f"{accel_file.name} + {gyro_file.name}",
        accel.names + gyro.names[1:],
        accel.columns + gyro.columns[1:],
        accel.place,
    )
    return recording_from_table(both, [accel_file.source, gyro_file.source])


def _names(time_unit: str, triad: str, unit: str) -> list[str]:
    return [f"time_{time_unit}", *(f"{triad}_{axis}_{unit}" for axis in "xyz")]


def _require_same_time(accel: Table, gyro: Table) -> None:
    if len(accel.columns[0]) != len(gyro.columns[0]):
        raise FormatError(
            f"{accel.file} has {len(accel.columns[0])} samples but {gyro.file} has {len(gyro.columns[0])}: "
            "resample them to common time stamps"
        )
    accel_time, gyro_time = (table.columns[0].to_numpy() for table in (accel, gyro))
    different = np.flatnonzero(accel_time != gyro_time)
    if len(different):
        row = int(different[0])
        raise FormatError(
            f"{accel.file} and {gyro.file} have different time stamps at {len(different)} samples, first at "
            f"{accel.place(row)}: {accel_time[row]} and {gyro_time[row]}: resample them to common time stamps"
        )
