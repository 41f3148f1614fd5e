"""Times that a unit sends as text without a checksum, checked against the clock of the host.

A digit that is lost or changed on the line makes a time that is ahead of the host clock, or after which the
next one falls. So each row waits for the next one, which must continue it. If the next row continues the rows
before instead, the waiting row is damaged; if later rows continue neither, the unit has restarted. Times may
lag behind the host clock by any duration, because rows are delivered late; they cannot be ahead of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

__all__ = ["TimeCheck", "Timed"]

# A row, and the host time of its arrival, s.
Timed: TypeAlias = tuple[tuple[float, ...], float]

# A time is ahead if it exceeds the host clock by more than this, s: the jitter of a busy host.
SLACK_S: Final = 0.1
# Relative error of the unit's clock that is no contradiction.
RATE_ERROR: Final = 0.02
# Time for which a row waits for the next one, s: longer than the interval of most units, and shorter than the
# time for which a recording waits for its last samples.
WAITS_S: Final = 0.1
# Number of waiting rows, none of which continues another, after which the check ends.
MOST_WAITING: Final = 4


@dataclass
class _Waiting:
    """A row that no row has continued yet. `fits`: it continues the rows that have passed."""

    timed: Timed
    time_s: float
    fits: bool


class TimeCheck:
    """Passes rows on, the damaged ones left out.

    column   index of the time, or of the counter that gives it, in a row
    ticks_per_s  its ticks per second
    damaged  number of rows that were left out
    is_void  the unit's time does not run like the host clock, so that all rows pass
    """

    def __init__(self, column: int, ticks_per_s: float) -> None:
        self._column, self._ticks_per_s = column, ticks_per_s
        self.damaged = 0
        self.is_void = False
        self._waiting: list[_Waiting] = []
        # Time and arrival of the last row that passed, and the smallest difference of the two so far, s.
        self._last: tuple[float, float] | None = None
        self._least_s = math.inf

    def passed(self, row: tuple[float, ...], arrived_s: float) -> list[Timed]:
        """The rows that are now known to be intact, in order."""
        time_s = row[self._column] / self._ticks_per_s
        if self.is_void or not math.isfinite(time_s):
            return [(row, arrived_s)]
        new = _Waiting((row, arrived_s), time_s, fits=True)
        # A row that fits is the first of those that wait.
        first = self._waiting[0] if self._waiting and self._waiting[0].fits else None
        if first is not None and self._continues(first.time_s, first.timed[1], new):
            self._leave_out(self._waiting[1:], new)
            return self._accept([first])
        if self._last is not None and self._continues(*self._last, new):
            self._leave_out(self._waiting, new)
            return []
        for before in reversed(self._waiting):
            if not before.fits and self._follows(before, new):
                self._leave_out([w for w in self._waiting if w is not before and not w.fits], new)
                rows = [] if first is None else self._accept([first])
                # The first rows of the unit, or those after a restart.
                self._last, self._least_s = None, math.inf
                return rows + self._accept([before])
        new.fits = False
        self._waiting.append(new)
        if len(self._waiting) < MOST_WAITING:
            return []
        self.is_void = True
        waiting, self._waiting = self._waiting, []
        return [waiting_row.timed for waiting_row in waiting]

    def overdue(self, now_s: float) -> list[Timed]:
        """The row that has waited long enough for the next one, if there is one."""
        if not self._waiting or not self._waiting[0].fits or now_s - self._waiting[0].timed[1] < WAITS_S:
            return []
        return self._accept([self._waiting.pop(0)])

    def _continues(self, last_s: float, last_arrived_s: float, new: _Waiting) -> bool:
        """Whether a row continues one whose delivery may have been late: the unit has gone on meanwhile."""
        late_s = max(last_arrived_s - last_s - self._least_s, 0.0)
        return _is_step(new.time_s - last_s, new.timed[1] - last_arrived_s + late_s)

    @staticmethod
    def _follows(before: _Waiting, new: _Waiting) -> bool:
        return _is_step(new.time_s - before.time_s, new.timed[1] - before.timed[1])

    def _leave_out(self, damaged: list[_Waiting], new: _Waiting) -> None:
        self.damaged += len(damaged)
        self._waiting = [new]

    def _accept(self, rows: list[_Waiting]) -> list[Timed]:
        for row in rows:
            arrived_s = row.timed[1]
            if self._last is not None:
                # Clocks whose rates differ let the difference grow.
                self._least_s += RATE_ERROR * max(arrived_s - self._last[1], 0.0)
            self._least_s = min(self._least_s, arrived_s - row.time_s)
            self._last = row.time_s, arrived_s
        return [row.timed for row in rows]


def _is_step(step_s: float, longest_s: float) -> bool:
    return 0.0 <= step_s <= (1.0 + RATE_ERROR) * longest_s + SLACK_S
