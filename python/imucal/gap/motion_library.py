"""Motions of a stand that help to distinguish between effects, in ascending order of the user's effort."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.rig.motion import Program, Step

if TYPE_CHECKING:
    from imucal.recording.recording import Recording

__all__ = ["Suggestion", "suggestions"]

# Seed of the random rotations. It differs from the default seed 1, with which the present recordings were
# probably made, because the new motion must differ from the present motion.
SEED: Final = 2
# Number of moves of the random program.
MOVES: Final = 45
# Maximum rate of one motor in the random program, deg/s.
MAX_RATE_DPS: Final = 120.0
# Rates of one motor, deg/s, in the program with several rates.
RATES_DPS: Final = (15.0, 30.0, 60.0, 120.0)
# Rates of one motor, deg/s, in the program for gyroscopes with a large range.
FASTER_DPS: Final = (30.0, 120.0, 240.0)
# Number of moves at each rate in the programs with several rates.
MOVES_AT_A_RATE: Final = 14
# Rotation between consecutive rests in the program that rotates the unit in full circles, deg.
CIRCLE_DEG: Final = 15.0
# Half of the temperature range of the suggested thermal cycle, K. The cycle is centred at the mean
# temperature of the present recordings.
HALF_RANGE_K: Final = 15.0


@dataclass(frozen=True)
class Suggestion:
    """A motion to record next.

    words             description of the motion
    program           program for the stand
    temperature       temperature profile for `imucal simulate --temperature`; None to keep the temperature of
                      the recordings
    answers           phrase, such as "several rates". If the catalogue's advice on how to distinguish two
                      effects contains this phrase, the motion follows the advice
    on_its_own        whether the search must use the new recording alone, without the present recordings
    encoders          whether the motor angles of the stand must be recorded
    """

    words: str
    program: Program
    temperature: str | None = None
    answers: str = "other turns"
    on_its_own: bool = False
    encoders: bool = False


def suggestions(recordings: Sequence[Recording], needs: frozenset[str]) -> Iterator[Suggestion]:
    """All suggested motions; `needs` are the quantities on which the effects to be distinguished depend."""
    again = Program.random(seed=SEED, moves=MOVES, max_rate_dps=MAX_RATE_DPS)
    longer = Program.random(seed=SEED, moves=3 * MOVES, max_rate_dps=MAX_RATE_DPS)
    found = [
        Suggestion("new random turns", again),
        Suggestion(
            "rotations in both directions at several rates, 15 to 120 deg/s",
            _at_rates(RATES_DPS),
            answers="several rates",
        ),
        Suggestion("rests every 15 deg on three circles", _circles(), answers="rests every 15 deg"),
        Suggestion("three times as many random turns", longer, answers="several time constants"),
        Suggestion("rotations at up to 240 deg/s, if the gyroscope's range permits", _at_rates(FASTER_DPS)),
    ]
    # Effects that depend on the heading are searched in the new recording alone, because the change of the
    # heading between two recordings is unknown.
    alone = "attitude" in needs
    if alone:
        turned = Program((*_headings(), *again.steps))
        words = "turns of the heading in six poses, then random turns"
        found.insert(3, Suggestion(words, turned, answers="turns of the heading"))
    given = [r.temperature_degc for r in recordings if r.temperature_degc is not None]
    if "temperature" in needs and len(given) == len(recordings):
        middle = round(float(np.mean(np.concatenate(given))))
        low, high = middle - HALF_RANGE_K, middle + HALF_RANGE_K
        words = f"random turns while the unit heats and cools again, {low:g} to {high:g} degC"
        cycle = f"cycle:{low:g}:{high:g}:{again.duration_s:.0f}"
        found.insert(3, Suggestion(words, again, cycle, answers="heats and cools"))
    yield from (replace(suggestion, on_its_own=alone) for suggestion in found)
    if any(recording.stand_rad is None for recording in recordings):
        words = "random turns on a stand whose angles are recorded"
        yield Suggestion(words, again, answers="angles are known", on_its_own=True, encoders=True)


def _at_rates(rates_dps: Sequence[float]) -> Program:
    steps: list[Step] = []
    for k, rate in enumerate(rates_dps):
        steps += Program.random(seed=SEED + k, moves=MOVES_AT_A_RATE, max_rate_dps=rate).steps
    return Program(tuple(steps))


def _circles() -> Program:
    """A program that rotates the unit in steps about body x, y and z, with a rest after each step."""
    count = round(360.0 / CIRCLE_DEG)

    def circle(*turn_deg: float) -> list[Step]:
        first, second, third = turn_deg
        return [Step((first, second, third), 0.5, 3.0)] * count

    tilt, back = Step((0.0, 90.0, 0.0), 1.0, 3.0), Step((0.0, -90.0, 0.0), 1.0, 3.0)
    start = Step((0.0, 0.0, 0.0), 0.0, 3.0)
    return Program(
        (
            start,
            *circle(CIRCLE_DEG, 0.0, 0.0),
            *circle(0.0, CIRCLE_DEG, 0.0),
            tilt,
            *circle(0.0, 0.0, CIRCLE_DEG),
            back,
        )
    )


def _headings() -> list[Step]:
    """Rotations by 90 deg about the vertical, four in each of six poses (each body axis up and down)."""

    def go(*turn_deg: float) -> Step:
        first, second, third = turn_deg
        return Step((first, second, third), 1.5, 8.0)

    steps = [Step((0.0, 0.0, 0.0), 0.0, 8.0), *[go(0.0, 0.0, 90.0)] * 4, go(90.0, 0.0, 0.0)]
    for _ in range(4):
        steps += [*[go(0.0, 90.0, 0.0)] * 4, go(0.0, 0.0, 90.0)]
    return [*steps, go(90.0, 0.0, 0.0), *[go(0.0, 0.0, 90.0)] * 4]
