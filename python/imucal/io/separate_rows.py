"""Resampling of tables in which accelerometer and gyroscope have separate rows, as after an outer join.

    time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps
    0.000,0.01,0.02,1.00,,,
    0.002,,,,0.1,-0.2,0.3

Programs that write several sensors with different time stamps to one table leave the cells of the sensors
without a sample empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from imucal.finding import Finding
from imucal.io.remarks import remark
from imucal.io.streams import LARGEST_RATIO, Stream, recording_from_streams
from imucal.recording.recording import Recording

__all__ = ["has_separate_rows", "on_one_clock"]

# Minimum share of the rows with samples that contain a sample of one sensor only. A smaller share is more
# likely caused by lost samples.
LEAST_ALONE: Final = 0.2
# Maximum number of consecutive samples of one sensor without a sample of the other. It is twice the largest
# ratio of the sampling rates that can be resampled. A longer run is more likely a failure of a sensor.
LONGEST_RUN: Final = 2 * int(LARGEST_RATIO)


def on_one_clock(recording: Recording) -> Recording:
    """The recording on one clock if its sensors have separate rows; any other recording unchanged."""
    force, rate = recording.specific_force, recording.angular_rate
    if force is None or rate is None or not has_separate_rows(recording):
        return recording
    accel, gyro = np.isfinite(force), np.isfinite(rate)
    has_accel, has_gyro = accel.all(axis=1), gyro.all(axis=1)
    is_partial = (accel.any(axis=1) & ~has_accel) | (gyro.any(axis=1) & ~has_gyro)
    is_alone = has_accel ^ has_gyro
    if (
        is_alone.sum() < LEAST_ALONE * (has_accel | has_gyro).sum()
        or not is_alone.any()
        or not (has_accel.any() and has_gyro.any())
        or is_partial.any()
        or recording.stand_rad is not None
        or not np.isfinite(recording.time_s).all()
        or max(_longest_run(has_accel, has_gyro), _longest_run(has_gyro, has_accel)) > LONGEST_RUN
    ):
        return recording
    joined = recording_from_streams(
        recording.name,
        _stream(recording, "the accelerometer", force, has_accel),
        _stream(recording, "the gyroscope", rate, has_gyro),
        recording.sources,
        recording.findings,
        accel_unit=recording.accel_unit,
        gyro_unit=recording.gyro_unit,
    )
    findings = joined.findings
    if recording.auxiliary:
        findings = (*findings, _left_out(recording.name, list(recording.auxiliary)))
    return replace(joined, column_units=recording.column_units, findings=findings)


def has_separate_rows(recording: Recording) -> bool:
    """Whether any row has samples of one sensor only. A part of a table suffices for this test."""
    force, rate = recording.specific_force, recording.angular_rate
    # A sum over all rows needs no memory and is finite in almost all tables. In a table with infinite
    # samples or an overflow of the sum, the rows are examined.
    if force is None or rate is None or (_is_finite(force) and _is_finite(rate)):
        return False
    return bool((np.isfinite(force).all(axis=1) ^ np.isfinite(rate).all(axis=1)).any())


def _is_finite(samples: Any) -> bool:
    with np.errstate(all="ignore"):
        return bool(np.isfinite(samples.sum(dtype=np.float64)))


def _left_out(file: str, columns: Sequence[str]) -> Finding:
    return remark(
        file,
        "resampled",
        f"the columns {', '.join(columns)} were left out, because the rows of both sensors were joined",
        "if a calibration needs them, write each row with the samples of both sensors",
    )


def _longest_run(of: Any, without: Any) -> int:
    """The largest number of samples of one sensor between two successive samples of the other."""
    counts = np.diff(np.cumsum(of)[without], prepend=0)
    return int(counts[1:].max(initial=0))


def _stream(recording: Recording, name: str, values: Any, which: Any) -> Stream:
    temperature = recording.temperature_degc
    if temperature is not None:
        known = np.isfinite(temperature)
        at_s = recording.time_s[which]
        temperature = np.interp(at_s, recording.time_s[known], temperature[known]) if known.any() else None
    return Stream(
        name,
        np.round(recording.time_s[which] * 1e9).astype(np.int64),
        np.asarray(values[which], dtype=np.float64),
        temperature,
    )
