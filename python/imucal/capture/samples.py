"""Storage for the samples of a growing recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.recording.recording import Recording
from imucal.stand.rows import recording_of
from imucal.stand.stream import TICKS_PER_S

__all__ = ["Samples"]

# Number of rows for which memory is reserved initially. The memory is doubled when it is full.
FIRST_ROWS: Final = 1 << 14


class Samples:
    """The samples of a growing recording: one row of numbers per sample, and the names of the columns."""

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        time = next(i for i, name in enumerate(columns) if name in TICKS_PER_S)
        self._time, self._ticks_per_s = time, TICKS_PER_S[columns[time]]
        self._rows = np.empty((FIRST_ROWS, len(self.columns)))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, rows: FloatArray) -> None:
        """Add rows, (N, columns)."""
        end = self._count + len(rows)
        while end > len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count : end] = rows
        self._count = end

    def truncate(self, count: int) -> None:
        """Keep the first `count` rows."""
        self._count = count

    @property
    def rows(self) -> FloatArray:
        """All rows, (N, columns)."""
        return self._rows[: self._count]

    def times_s(self, rows: FloatArray) -> FloatArray:
        """The times of rows since the first sample of the recording, s."""
        start = self._rows[0, self._time] if self._count else rows[0, self._time]
        times: FloatArray = (rows[:, self._time] - start) / self._ticks_per_s
        return times

    def recording(self) -> Recording:
        """The samples so far as a recording."""
        return recording_of(self.columns, self.rows, "the recording so far")
