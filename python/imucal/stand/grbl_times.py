"""Instants of reported motor positions, from the bounds that the query and the arrival of a report give.

A position is taken after its query has reached the controller, and before its report leaves it. Either a
controller that waits before it takes the position or a report that is delivered late makes these bounds wide.
Motors do not exceed their commanded rate, so bounds of the reports before and after narrow them: while the
motors turn at this rate, one prompt report decides about all others.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from imucal.stand.driver import Position
from imucal.stand.grbl_report import Triple

__all__ = ["Instants", "one_way_s"]

# Time, s, for which later reports may narrow the bounds of a report, about ten reports.
WITHIN_S: Final = 0.5
# Bits on the line for each character of a report.
BITS: Final = 10
# Contradiction of the bounds, s, above which the motors have exceeded their commanded rate (an override of
# the feed rate), so that only a report's own bounds count.
CONTRADICTION_S: Final = 0.02


def one_way_s(shortest_s: float, length: int, baud: int) -> tuple[float, float]:
    """Shortest times, s, from the query to the position, and from the position to the arrival of the report.

    The characters of the report need the time that the baud rate tells, unless the line is not that slow, as
    with USB; the rest of the shortest time between query and report is divided equally.
    """
    sent_s = length * BITS / baud
    if sent_s > shortest_s:
        sent_s = 0.0
    half_s = (shortest_s - sent_s) / 2
    return half_s, half_s + sent_s


# Uncertainty of a position, deg, above which it is not used: half of the error that is acceptable in moves.
UNCERTAIN_DEG: Final = 0.5


@dataclass
class _Reading:
    early_s: float
    late_s: float
    position_deg: Triple
    rate_dps: float
    # The lower bound, narrowed by the reports before.
    after_s: float

    def uncertain_deg(self, upper_s: float, around: Sequence[_Reading | None]) -> float:
        """Angle that the motors turn between the bounds, at most that to the positions before and after."""
        turned = [math.dist(self.position_deg, other.position_deg) for other in around if other is not None]
        return min(abs(upper_s - self.after_s) / 2 * self.rate_dps, max(turned, default=math.inf))


class Instants:
    """Positions of the last half second, and their instants once they are known."""

    def __init__(self) -> None:
        self._waiting: deque[_Reading] = deque()
        self._before: _Reading | None = None

    def add(self, early_s: float, late_s: float, position_deg: Triple, rate_dps: float) -> None:
        """A position that was taken between two host times, while the motors turned at most at a rate."""
        reading = _Reading(early_s, late_s, position_deg, rate_dps, early_s)
        before = self._waiting[-1] if self._waiting else self._before
        if before is not None:
            reading.after_s = max(early_s, before.after_s + _shortest_s(before, reading))
            if reading.after_s > late_s + CONTRADICTION_S:
                reading.after_s = early_s
        self._waiting.append(reading)

    def settled(self, now_s: float) -> list[Position]:
        """Positions whose instants later reports do not change any more; all with an infinite time."""
        before_s = [0.0] * len(self._waiting)
        following: tuple[_Reading, float] | None = None
        for i in range(len(self._waiting) - 1, -1, -1):
            reading = self._waiting[i]
            before_s[i] = reading.late_s
            if following is not None:
                narrowed_s = following[1] - _shortest_s(reading, following[0])
                if narrowed_s > reading.early_s - CONTRADICTION_S:
                    before_s[i] = min(before_s[i], narrowed_s)
            following = reading, before_s[i]
        done = []
        for upper_s in before_s:
            if self._waiting[0].late_s > now_s - WITHIN_S:
                break
            before, self._before = self._before, self._waiting.popleft()
            around = [before, self._waiting[0] if self._waiting else None]
            if self._before.uncertain_deg(upper_s, around) <= UNCERTAIN_DEG:
                done.append(((self._before.after_s + upper_s) / 2, *self._before.position_deg))
        return done


def _shortest_s(first: _Reading, second: _Reading) -> float:
    """Time that the motors need at least between two positions, s."""
    return math.dist(first.position_deg, second.position_deg) / max(first.rate_dps, second.rate_dps)
