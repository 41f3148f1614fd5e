"""Removal of rows that a logger wrote twice, with the same time stamp and the same values."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.io.remarks import remark
from imucal.recording.recording import Recording

__all__ = ["has_equal_stamps", "without_copies"]

# Number of time stamps that are compared at once. This number fits into the processor's cache.
STAMPS_AT_ONCE: Final = 1 << 14


def has_equal_stamps(time_s: FloatArray) -> bool:
    """Whether any time stamp is equal to or earlier than the previous one, so that rows may be copies."""
    # The differences are computed in blocks, so that their memory does not grow with the recording.
    starts = range(0, len(time_s), STAMPS_AT_ONCE)
    return any((np.diff(time_s[at : at + STAMPS_AT_ONCE + 1]) <= 0).any() for at in starts)


def without_copies(recording: Recording) -> Recording:
    """The recording without exact copies of earlier rows, with a warning that reports their number.

    If there are also rows with equal time stamps but different values, no row is removed. The time stamps are
    then too coarse, and rows with equal values may be different samples.
    """
    time_s = recording.time_s
    if not has_equal_stamps(time_s):
        return recording
    there = (recording.specific_force, recording.angular_rate)
    columns = [time_s, *(column for samples in there if samples is not None for column in samples.T)]
    if recording.temperature_degc is not None:
        columns.append(recording.temperature_degc)
    if recording.stand_rad is not None:
        columns += [*recording.stand_rad.T]
    rows = np.column_stack(
        [np.asarray(c, dtype=np.float64) for c in (*columns, *recording.auxiliary.values())]
    )
    # Rows are compared byte by byte, so that NaN equals NaN.
    keys = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first = np.unique(keys, return_index=True)
    is_first = np.zeros(len(time_s), dtype=bool)
    is_first[first] = True
    count = int(np.count_nonzero(~is_first))
    if not count or len(np.unique(time_s[is_first])) < np.count_nonzero(is_first):
        return recording
    at = int(np.flatnonzero(~is_first)[0])
    warning = replace(
        remark(
            recording.name,
            "samples_duplicated",
            f"{count} rows are exact copies of an earlier row (time stamp and values), the first at "
            f"{time_s[at]:.6g} s; they were left out",
            "check the logger, which writes rows twice",
        ),
        count=count,
    )
    return replace(recording.rows(is_first), findings=(*recording.findings, warning))
