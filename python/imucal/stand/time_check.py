"""Check of the times that a unit sends as text without a checksum, by comparison with the host clock.

If a digit of a time is lost or changed on the line, the time is ahead of the host clock, or the next time is
smaller. Therefore each row is held back until the next row arrives. A row is said to continue an earlier row
if the step between their times is possible for the host times at which they arrived. If the next row
continues the held row, the held row is intact. If the next row does not continue the held row, but continues
rows before it, the held row is damaged. If later rows continue neither the held row nor earlier rows, the
unit has restarted. Times may lag behind the host clock by any duration, because rows can be delivered late,
but they cannot be ahead of the host clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

__all__ = ["TimeCheck", "Timed"]

# A row (the decoded numbers of one sample), and the host time of its arrival, s.
Timed: TypeAlias = tuple[tuple[float, ...], float]

# A sample time counts as damaged if it is ahead of the host clock by more than this time, s. The margin
# allows for the jitter of a busy host.
SLACK_S: Final = 0.1
# Largest accepted relative error of the unit's clock.
RATE_ERROR: Final = 0.02
# Longest time for which a row is held back, s. It is longer than the sampling interval of most units, and
# shorter than the time for which a recording waits for its last samples.
WAITS_S: Final = 0.1
# The check is switched off if this number of rows are held back and none of them continues another row.
MOST_WAITING: Final = 4


@dataclass
class _Waiting:
    """A row that is held back. `fits` is true if the row continues the accepted rows."""

    timed: Timed
    time_s: float
    fits: bool


class TimeCheck:
    """Returns intact rows and omits damaged rows.

    column   index of the time, or of the counter that gives it, in a row
    ticks_per_s  ticks per second of this column
    damaged  number of omitted rows
    is_void  whether the check is switched off because the unit's time does not run like the host clock
    """

    def __init__(self, column: int, ticks_per_s: float) -> None:
        self._column, self._ticks_per_s = column, ticks_per_s
        self.damaged = 0
        self.is_void = False
        self._waiting: list[_Waiting] = []
        # Time of the last intact row, and host time of its arrival, s.
        self._last: tuple[float, float] | None = None
        # Smallest difference so far between host time of arrival and time of a row, s.
        self._least_s = math.inf

    def passed(self, row: tuple[float, ...], arrived_s: float) -> list[Timed]:
        """Check a new row. Returns all rows that are now known to be intact, in order."""
        time_s = row[self._column] / self._ticks_per_s
        if self.is_void or not math.isfinite(time_s):
            return [(row, arrived_s)]
        new = _Waiting((row, arrived_s), time_s, fits=True)
        # Of the rows that are held back, only the first can continue the accepted rows.
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
                # `before` and `new` agree with each other, but not with the accepted rows. They are the first
                # rows of the unit, or the first rows after a restart.
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
        """The first unconfirmed row, if it continues the accepted rows and arrived over `WAITS_S` ago."""
        if not self._waiting or not self._waiting[0].fits or now_s - self._waiting[0].timed[1] < WAITS_S:
            return []
        return self._accept([self._waiting.pop(0)])

    def _continues(self, last_s: float, last_arrived_s: float, new: _Waiting) -> bool:
        """Whether the time step from an earlier row to `new` is possible for their times of arrival.

        The earlier row may have arrived late, so its delay is added to the longest possible step.
        """
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
                # Since the last row, the difference between host time and row time may have grown by the
                # rate error of the unit's clock.
                self._least_s += RATE_ERROR * max(arrived_s - self._last[1], 0.0)
            self._least_s = min(self._least_s, arrived_s - row.time_s)
            self._last = row.time_s, arrived_s
        return [row.timed for row in rows]


def _is_step(step_s: float, longest_s: float) -> bool:
    return 0.0 <= step_s <= (1.0 + RATE_ERROR) * longest_s + SLACK_S
