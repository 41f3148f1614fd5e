"""Determines the time between the last sample of an interrupted run and the first sample after it.

After an interruption, samples may be delivered late, because a device or a network has stored them while no
program read them. They are never delivered early. The arrival of the first sample therefore does not give its
time, and the first samples are held back until their times are known. If one of them arrives at the time that
the clock of the unit predicts, this clock has continued. Otherwise the unit has restarted, or it sends no
time. The delay of the least delayed sample is then assumed to be zero.
"""

from __future__ import annotations

import math
from typing import Final

from imucal.stand.time_check import Timed

__all__ = ["WRAP_SHARE", "Continuation"]

# Longest time, s, for which samples are held back after an interruption.
WAITS_S: Final = 2.0
# The clock of the unit counts as continued during the interruption if a sample arrives at the time that this
# clock predicts. The accepted difference is NEAR_S, s, plus CLOCK_ERROR times the duration of the
# interruption.
NEAR_S: Final = 1.0
CLOCK_ERROR: Final = 1e-3
# A counter counts as wrapped if it jumps from the top of its range (at least this share of the range) to the
# bottom (at most 1 minus this share).
WRAP_SHARE: Final = 0.9


class Continuation:
    """Samples that are held back after an interruption, until their times are known.

    last_s    time of the last sample before the interruption, s
    host_s    host time at which this sample arrived, s
    per_s     counts per second of the counter that gives the time of a sample
    turn      value at which the counter wraps, or None
    is_clock  whether the counter is a clock of the unit, which may have continued
    waiting   the samples that are held back, with their host times of arrival
    """

    def __init__(
        self, last_s: float, host_s: float, *, per_s: float, turn: float | None, is_clock: bool
    ) -> None:
        self._last_s, self._host_s = last_s, host_s
        self._per_s, self._turn, self._is_clock = per_s, turn, is_clock
        self.waiting: list[Timed] = []
        self._first = self._before = self._wraps = 0.0
        self._has_restarted = False
        # Time from the last sample before the interruption to the first sample after it, s: the smallest of
        # the estimates from the arrival times. It is exact if one of these samples has arrived without delay.
        self._least_s = math.inf

    def add(self, timed: Timed, count: float) -> None:
        """Add a sample with the value of its counter."""
        if not self.waiting:
            self._first = self._before = count
        if count < self._before and not self._has_restarted:
            turn = self._turn
            has_wrapped = (
                turn is not None and self._before >= WRAP_SHARE * turn and count <= (1 - WRAP_SHARE) * turn
            )
            self._has_restarted = not has_wrapped
            self._wraps += turn if turn is not None and has_wrapped else 0.0
        self.waiting.append(timed)
        if not self._has_restarted:
            self._before = count
            since_first_s = (count + self._wraps - self._first) / self._per_s
            self._least_s = min(self._least_s, timed[1] - self._host_s - since_first_s)

    def shift(self, now_s: float) -> float | None:
        """Number to add to the counter: time = (counter + number) / `per_s`. None if it is not known yet."""
        if not self.waiting:
            return None
        after = (self._last_s + self._least_s) * self._per_s
        if self._is_clock:
            wraps = 0.0 if self._turn is None else self._turn * round((after - self._first) / self._turn)
            off_s = abs(self._first + wraps - after) / self._per_s
            if off_s < NEAR_S + CLOCK_ERROR * abs(self._least_s):
                return wraps
        if self._has_restarted or now_s - self.waiting[0][1] > WAITS_S:
            return max(after, self._last_s * self._per_s) - self._first
        return None
