"""Recordings of imu_tk: two ASCII files, accelerometer and gyroscope, with the columns time, x, y, z."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Final, get_args

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.finding import Finding
from imucal.io.remarks import remark
from imucal.io.scale import accel_reading
from imucal.io.sensor_files import read_pair
from imucal.io.text import head_of
from imucal.recording.recording import AccelUnit, GyroUnit, Recording

__all__ = ["read_imu_tk"]

# Number of samples that are tested for whole numbers. Samples with a fraction cannot be raw counts.
FIRST: Final = 2000


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
    # If a file has a header, units and axes are taken from the header.
    has_header = any(head_of(path)[1].names is not None for path in (accel_path, gyro_path))
    recording = read_pair(
        accel_path,
        gyro_path,
        time_unit=time_unit,
        accel_unit=accel_unit if accel_unit is not None or has_header else "lsb",
        gyro_unit=gyro_unit if gyro_unit is not None or has_header else "lsb",
    )
    if has_header or accel_unit is not None or gyro_unit is not None or _are_whole(recording):
        return recording
    return replace(recording, findings=(*recording.findings, _counts_assumed(recording)))


def _first(recording: Recording) -> FloatArray:
    return np.asarray(recording.specific_force, dtype=np.float64)[:FIRST]


def _are_whole(recording: Recording) -> bool:
    """Whether the samples can be counts; resampled counts are not whole."""
    first = _first(recording)
    return bool((first == np.round(first)).all()) or any(f.code == "resampled" for f in recording.findings)


def _counts_assumed(recording: Recording) -> Finding:
    return remark(
        recording.name,
        "counts_assumed",
        "the files have no header, so the numbers were taken as counts, but they are not whole "
        f"({accel_reading(_first(recording)).text})",
        "if they have a unit, give it with --accel-unit m/s^2 --gyro-unit rad/s",
    )
