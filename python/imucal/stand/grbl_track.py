"""Checks the plausibility of reported motor positions, which have no checksum.

A position is accepted if it is near the straight line of the commanded move, and if the motors can have
reached it since the last accepted position. All other reports are considered damaged, unless three
consecutive reports agree. In this case the motors have left the commanded line, or the controller has
restarted and counts its positions from zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from imucal.stand.grbl_report import Triple
from imucal.stand.grbl_start import NEAR_DEG

__all__ = ["Track"]

# A reported position is possible if the motors have rotated by at most RATE_FACTOR times the commanded rate
# times the time since the last accepted position, plus EXTRA_DEG, deg. Both numbers allow for errors of a few
# milliseconds in the instants of reports.
RATE_FACTOR: Final = 1.5
EXTRA_DEG: Final = 1.0
# An implausible position is treated as the real position of the motors, and not as a damaged report, if this
# number of consecutive reports agree on it.
AGREEING: Final = 3

Found = Literal["accepted", "suspect", "elsewhere", "jumped"]


class Track:
    """The commanded motion, and the last accepted position on it."""

    def __init__(self, position_deg: Triple, max_rate_dps: float) -> None:
        self.last_deg = position_deg
        self._start = self._target = np.array(position_deg)
        self._max_rate_dps = self._rate_dps = max_rate_dps
        self._last_s: float | None = None
        self._suspects: list[tuple[float, Triple]] = []

    @property
    def target_deg(self) -> Triple:
        """Target of the commanded move; without a move, the position at which the motors are at rest."""
        x, y, z = self._target.tolist()
        return (x, y, z)

    @property
    def rate_dps(self) -> float:
        """Combined rate of the commanded move, deg/s; at rest, the maximum rate."""
        return self._rate_dps or self._max_rate_dps

    def command(self, target_deg: Sequence[float], rate_dps: float) -> None:
        """Set the commanded move: from the last position to the target, at most at the rate `rate_dps`."""
        self._start, self._target = np.array(self.last_deg), np.array(target_deg)
        self._rate_dps = rate_dps
        self._suspects = []

    def judge(self, position_deg: Triple, instant_s: float) -> Found:
        """Whether a reported position is plausible.

        An implausible position is "suspect" until three reports agree on it. It is then "elsewhere" if the
        motors can have rotated to it since the last accepted position, and "jumped" otherwise.
        """
        passed_s = math.inf if self._last_s is None else instant_s - self._last_s
        if self._fits(position_deg, passed_s):
            self._suspects, self._last_s, self.last_deg = [], instant_s, position_deg
            return "accepted"
        if self._suspects and not self._reachable(self._suspects[-1], instant_s, position_deg):
            self._suspects = []
        self._suspects.append((instant_s, position_deg))
        if len(self._suspects) < AGREEING:
            return "suspect"
        if self._fits(position_deg, math.inf):
            # The position is ahead on the commanded path, because earlier reports were delayed or lost.
            self._suspects, self._last_s, self.last_deg = [], instant_s, position_deg
            return "accepted"
        first_s, first_deg = self._suspects[0]
        is_zero = all(max(map(abs, found)) < NEAR_DEG / 10 for _, found in self._suspects)
        last = (first_s - passed_s, self.last_deg)
        if is_zero or not self._reachable(last, first_s, first_deg):
            return "jumped"
        self._suspects, self._last_s, self.last_deg = [], instant_s, position_deg
        return "elsewhere"

    def _fits(self, position_deg: Triple, passed_s: float) -> bool:
        at, line = np.array(position_deg), self._target - self._start
        length = float(np.linalg.norm(line))
        along = line / length if length > 0.0 else line
        progress = float(along @ (at - self._start))
        before = float(along @ (np.array(self.last_deg) - self._start))
        nearest = self._start + along * min(max(progress, 0.0), length)
        if float(np.abs(at - nearest).max()) > NEAR_DEG:
            return False
        reach = RATE_FACTOR * self._rate_dps * passed_s + EXTRA_DEG
        return length == 0.0 or before - EXTRA_DEG <= progress <= before + reach

    def _reachable(self, before: tuple[float, Triple], instant_s: float, position_deg: Triple) -> bool:
        """Whether the motors can have reached this position from an earlier position (instant and angles)."""
        reach = RATE_FACTOR * self._max_rate_dps * max(instant_s - before[0], 0.0) + EXTRA_DEG
        return math.dist(before[1], position_deg) <= reach
