"""Instants of reported motor positions.

A position is taken at the latest the shortest time of a report before its report arrives. A report that is
delivered late makes this bound late. Motors do not exceed their commanded rate, so later reports correct it:
while the motors turn at this rate, one prompt report decides about all late ones before it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from imucal.stand.driver import Position
from imucal.stand.grbl_report import Triple

__all__ = ["Instants", "one_way_s"]

# Time, s, for which later reports may correct an instant, about ten reports.
WITHIN_S: Final = 0.5
# Bits on the line for each character of a report.
BITS: Final = 10
# Largest correction, s. A larger one is no delay: the motors exceed their commanded rate, because the feed is
# overridden.
LARGEST_S: Final = 0.05


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


@dataclass(frozen=True)
class _Reading:
    latest_s: float
    position_deg: Triple
    rate_dps: float


class Instants:
    """Positions of the last half second, and their instants once they are known."""

    def __init__(self) -> None:
        self._waiting: deque[_Reading] = deque()

    def add(self, latest_s: float, position_deg: Triple, rate_dps: float) -> None:
        """A position that was taken at a host time or before, while the motors turned at most at a rate."""
        self._waiting.append(_Reading(latest_s, position_deg, rate_dps))

    def settled(self, now_s: float) -> list[Position]:
        """Positions whose instants later reports do not change any more; all with an infinite time."""
        instants: deque[float] = deque()
        following: _Reading | None = None
        for reading in reversed(self._waiting):
            at_s = reading.latest_s
            if following is not None:
                turned_deg = math.dist(reading.position_deg, following.position_deg)
                before_s = instants[0] - turned_deg / max(reading.rate_dps, following.rate_dps)
                if at_s - LARGEST_S < before_s < at_s:
                    at_s = before_s
            instants.appendleft(at_s)
            following = reading
        done: list[Position] = []
        while self._waiting and self._waiting[0].latest_s <= now_s - WITHIN_S:
            done.append((instants.popleft(), *self._waiting.popleft().position_deg))
        return done
