"""Whether what is bad was named, and what was named that is not bad.

A rest or move is named if it is left out. A bad stretch of a rest is dealt with if

    no rest overlaps it unnamed: the rest is named, or was not taken for one, or was cut there; or
    all moves to and from it are named: a force across gravity shows in nothing else; or
    a finding points at it.

A bad stretch of a move is dealt with if no move overlaps it unnamed, or a finding points at it. A good rest
or move must not be named; a move to or from a bad rest is neither good nor bad.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import imucal
from imucal.estimation.rests import Move, Rest

# Rests are found to a few hundredths of a second.
EDGE_S = 0.06
# A finding that spans more than a rest and a move points at nothing.
POINTED_S = 10.0


@dataclass(frozen=True)
class Bad:
    """A stretch of a run that spoils a rest or a move.

    of      "rest" or "move"
    to_see  whether the fit can see it; a stretch that harms nothing need not be named, and may be
    """

    of: str
    start_s: float
    end_s: float
    to_see: bool = True

    def touches(self, start_s: float, end_s: float) -> bool:
        edge_s = min(EDGE_S, (self.end_s - self.start_s) / 4.0)
        return start_s < self.end_s - edge_s and end_s > self.start_s + edge_s


@dataclass(frozen=True)
class Named:
    """How many bad stretches there were and were dealt with; how many good rests and moves, and named."""

    bad: int
    found: int
    good: int
    false: int


def score(result: imucal.CalibrationResult, bad: Sequence[Bad]) -> Named:
    rests = [(rest.start_s, rest.end_s, is_named(rest)) for rest in result.rests]
    ends = [(result.rests[move.from_rest], result.rests[move.to_rest]) for move in result.moves]
    names = [is_named(move) for move in result.moves]
    moves = [(a.end_s, b.start_s, named) for (a, b), named in zip(ends, names, strict=True)]
    with_rests = [(a.start_s, b.end_s, named) for (a, b), named in zip(ends, names, strict=True)]
    places = [finding.place for finding in result.findings if finding.place is not None]
    places = [place for place in places if place.end_s - place.start_s <= POINTED_S]

    def found(one: Bad) -> bool:
        def touched(kind: Sequence[tuple[float, float, bool]]) -> list[bool]:
            return [named for start, end, named in kind if one.touches(start, end)]

        around = touched(with_rests) if one.of == "rest" else []
        return (
            all(touched(rests if one.of == "rest" else moves))
            or (bool(around) and all(around))
            or any(one.touches(place.start_s, place.end_s) for place in places)
        )

    good = [
        named
        for start, end, named in (*rests, *with_rests)
        if not any(one.touches(start, end) for one in bad)
    ]
    to_see = [one for one in bad if one.to_see]
    return Named(len(to_see), sum(map(found, to_see)), len(good), sum(good))


def is_named(item: Rest | Move) -> bool:
    return item.excluded is not None
