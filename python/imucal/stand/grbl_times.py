"""Determines the instants of reported motor positions.

The latest possible instant of a position is the arrival of its report minus the shortest transmission time.
If a report is delivered late, this instant is too late. Later reports correct the instant: the motors do not
exceed their commanded rate, so they were at an earlier position at least (rotation / rate) before they were
at a later position. While the motors turn at this rate, one report that is not delayed corrects all late
reports before it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from imucal.stand.driver import Position
from imucal.stand.grbl_report import Triple

__all__ = ["Instants", "one_way_s"]

# The instant of a report may be corrected by reports that arrive up to this time later, s. About ten reports
# arrive in this time.
WITHIN_S: Final = 0.5
# Number of bits per character on the serial line, with start and stop bit.
BITS: Final = 10
# Largest correction of an instant, s. A larger discrepancy is not caused by a transmission delay, but by
# motors that exceed their commanded rate because of a feed override.
LARGEST_S: Final = 0.05


def one_way_s(shortest_s: float, length: int, baud: int) -> tuple[float, float]:
    """Shortest time from a query until the position is read, and from then until the report arrives, s.

    `shortest_s` is the shortest time from a query to the arrival of its report. It includes the transmission
    of the report, of `length` characters, which takes the time given by the baud rate, unless the line is
    faster, as with USB. Of the remaining time, one half is assumed to pass before the position is taken, and
    the other half after it.
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
    """Positions of the last half second, and their corrected instants."""

    def __init__(self) -> None:
        self._waiting: deque[_Reading] = deque()

    def add(self, latest_s: float, position_deg: Triple, rate_dps: float) -> None:
        """Add a position taken at `latest_s` or before, while the motors turned at most at `rate_dps`."""
        self._waiting.append(_Reading(latest_s, position_deg, rate_dps))

    def settled(self, now_s: float) -> list[Position]:
        """Positions whose instants are final (later reports cannot change them); all if `now_s` is inf."""
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
