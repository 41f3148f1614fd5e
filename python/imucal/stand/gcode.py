"""Conversion of a program to G-code for GRBL 1.1, and the duration of the program on the controller.

Each step consists of a line that moves all motors to absolute angles, and a line with `G4`, which waits until
the motors are at rest and then dwells. Every move therefore starts and ends at rest, with a trapezoidal rate
profile (GRBL's planner.c). Let d be the combined rotation, deg: the root of the sum of the squared rotations
of the three motors. Let v be the feed, deg/s, and a the acceleration, deg/s^2, along this combined rotation.
The duration t of the move, s, is

    t = d / v + v / a    if v^2 / a <= d,    2 sqrt(d / a)    if the feed is not reached

GRBL treats rotary axes as linear axes, with 1 mm for 1 deg. The resolution of a dwell is 50 ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.errors import InputError
from imucal.rig.motion import Program, Step
from imucal.rig.program_bounds import MAX_DURATION_S, fault_of, turned_too_far

__all__ = ["Axes", "Block", "MotorLimits", "blocks_of", "gcode"]

# Resolution of GRBL's dwell time, s.
DWELL_STEP_S: Final = 0.05
# Number of decimals of angles and feeds. GRBL reads at most eight digits of a number.
ANGLE_DECIMALS: Final = 4
FEED_DECIMALS: Final = 2
# Lowest feed of GRBL, deg/min. GRBL raises lower feeds to this value.
LEAST_FEED_DPM: Final = 1.0
# Largest accepted angle of a motor relative to its start, deg. It is the largest number with eight digits of
# which four are decimals.
MAX_ANGLE_DEG: Final = 9999.9999
# Largest accepted rate, deg/s, and acceleration, deg/s^2, of a motor. The feed that corresponds to this rate,
# in deg/min with two decimals, has eight digits, the most that GRBL reads.
MAX_RATE_DPS: Final = 10_000.0
MAX_ACCELERATION_DPS2: Final = 1e6
# A move is reported as late if it takes longer than in the program by more than this time, s.
LATE_S: Final = 0.01


@dataclass(frozen=True)
class MotorLimits:
    """Limits of the three motors in the controller's settings.

    max_rate_dps       highest rate, deg/s (settings $110 to $112, which are in deg/min)
    acceleration_dps2  acceleration, deg/s^2 (settings $120 to $122)
    """

    max_rate_dps: tuple[float, float, float] = (360.0, 360.0, 360.0)
    acceleration_dps2: tuple[float, float, float] = (1000.0, 1000.0, 1000.0)

    def __post_init__(self) -> None:
        for name, most in (("max_rate_dps", MAX_RATE_DPS), ("acceleration_dps2", MAX_ACCELERATION_DPS2)):
            values = getattr(self, name)
            if len(values) != 3 or not all(0.0 < value <= most for value in values):
                raise InputError(f"{name} is {values}: three positive numbers up to {most:g} are needed")

    def along(self, turn_deg: Sequence[float]) -> tuple[float, float]:
        """Highest combined rate, deg/s, and acceleration, deg/s^2, of the motors in the move `turn_deg`."""
        length = math.hypot(*turn_deg)

        def most(limits: Sequence[float]) -> float:
            return min(
                limit * length / abs(turn) for limit, turn in zip(limits, turn_deg, strict=True) if turn
            )

        return most(self.max_rate_dps), most(self.acceleration_dps2)


@dataclass(frozen=True)
class Axes:
    """The axis letters of the three motors, outermost motor first."""

    letters: str = "XYZ"

    def __post_init__(self) -> None:
        if len(set(self.letters)) != 3 or not set(self.letters) <= set("XYZABCUVW"):
            raise InputError(
                f"the axes are {self.letters!r}: give three different letters, such as XYZ or ABC"
            )

    def words(self, angles_deg: Sequence[float]) -> str:
        """The G-code words of a position, such as X12.5Y-3Z0."""
        return "".join(
            f"{letter}{_number(angle, ANGLE_DECIMALS)}"
            for letter, angle in zip(self.letters, angles_deg, strict=True)
        )


@dataclass(frozen=True)
class Block:
    """One step of a program, as the controller executes it.

    angles_deg  target angles of the motors, deg, if all motors start at 0 deg
    feed_dpm    feed along the combined rotation, deg/min; None if no motor moves
    dwell_s     requested dwell after the move, s
    move_s      duration of the move on the controller, s
    late_s      `move_s` minus the duration in the program, s
    """

    angles_deg: tuple[float, float, float]
    feed_dpm: float | None
    dwell_s: float
    move_s: float
    late_s: float

    def dwell_line(self) -> str:
        """The line that waits for the end of the move and then dwells."""
        return f"G4P{_number(self.dwell_s, 3)}"

    def move_line(self, axes: Axes, words: str = "G1", shift_deg: Sequence[float] = (0.0, 0.0, 0.0)) -> str:
        """The G-code line of the move. `words` are the command words before the angles, such as G1.

        `shift_deg` is the position that the controller reports at the zero of the stand.
        """
        angles = [angle + shift for angle, shift in zip(self.angles_deg, shift_deg, strict=True)]
        return f"{words}{axes.words(angles)}F{_number(self.feed_dpm or LEAST_FEED_DPM, FEED_DECIMALS)}"

    @property
    def hold_s(self) -> float:
        """Actual dwell of the controller, s: `dwell_s` rounded up to a multiple of 50 ms as in GRBL."""
        return DWELL_STEP_S * float(np.ceil(np.float32(1.0 / DWELL_STEP_S) * np.float32(self.dwell_s)))


def blocks_of(program: Program, limits: MotorLimits) -> list[Block]:
    """The steps of a program for a controller with these limits. Numbers are rounded as in the G-code.

    Raises InputError for a program that no stand can follow, whose angles have too many digits for the
    controller, or that takes the controller longer than a week.
    """
    fault = fault_of(program.steps)
    if fault is not None:
        raise InputError(f"the program cannot run: {fault.path} {fault.reason}")
    blocks, before = [], (0.0, 0.0, 0.0)
    exact = np.cumsum([step.turn_deg for step in program.steps], axis=0)
    for index, motor in np.argwhere(np.abs(exact) > MAX_ANGLE_DEG).tolist():
        reason = turned_too_far(float(exact[index, motor]), MAX_ANGLE_DEG)
        raise InputError(f"the controller reads only 8 digits: $.steps[{index}].turn_deg[{motor}] {reason}")
    for step, sum_deg in zip(program.steps, exact, strict=True):
        x, y, z = (round(float(angle), ANGLE_DECIMALS) for angle in sum_deg)
        turn_deg = (x - before[0], y - before[1], z - before[2])
        blocks.append(_block(step, (x, y, z), turn_deg, limits))
        before = (x, y, z)
    if duration_s(blocks) > MAX_DURATION_S:
        raise InputError(
            f"the program takes {duration_s(blocks):.3g} s with these motors, more than {MAX_DURATION_S:g} s "
            "(a week): give higher rates and accelerations, or a shorter program"
        )
    return blocks


def gcode(blocks: Sequence[Block], axes: Axes, title: str) -> str:
    """The text of the G-code file. Its zero is the position of the motors at the start of the file."""
    angles = np.array([block.angles_deg for block in blocks])
    ranges = [
        f"({letter} from {low:.1f} to {high:.1f} deg)"
        for letter, low, high in zip(
            axes.letters, angles.min(axis=0, initial=0.0), angles.max(axis=0, initial=0.0), strict=True
        )
    ]
    lines = [
        f"({_comment(title)})",
        f"({len(blocks)} steps, {duration_s(blocks):.1f} s)",
        *ranges,
        "(degrees; all motors at zero before it starts)",
        "G21G90G94",
        f"G92{axes.words((0.0, 0.0, 0.0))}",
    ]
    for block in blocks:
        if block.feed_dpm is not None:
            lines.append(block.move_line(axes))
        lines.append(block.dwell_line())
    return "\n".join([*lines, "M2", ""])


def duration_s(blocks: Sequence[Block]) -> float:
    """Duration of the program on the controller, s."""
    return sum(block.move_s + block.hold_s for block in blocks)


def late(blocks: Sequence[Block]) -> list[int]:
    """Indices of the steps whose move takes longer on the controller than in the program."""
    return [number for number, block in enumerate(blocks) if block.late_s > LATE_S]


def _block(
    step: Step,
    angles_deg: tuple[float, float, float],
    turn_deg: tuple[float, float, float],
    limits: MotorLimits,
) -> Block:
    dwell_s = round(step.hold_s, 3)
    if not any(turn_deg):
        # If no motor moves, GRBL ignores the move. The planned time of the move is therefore added to the
        # dwell.
        return Block(angles_deg, None, round(step.hold_s + step.move_s, 3), 0.0, 0.0)
    length = math.hypot(*turn_deg)
    max_rate, acceleration = limits.along(turn_deg)
    rate = min(_rate(length, step.move_s, acceleration), max_rate)
    feed_dpm = max(round(60.0 * rate, FEED_DECIMALS), LEAST_FEED_DPM)
    move_s = _move_s(length, min(feed_dpm / 60.0, max_rate), acceleration)
    return Block(angles_deg, feed_dpm, dwell_s, move_s, move_s - step.move_s)


def _rate(length: float, move_s: float, acceleration: float) -> float:
    """Rate, deg/s, at which a move of `length` deg takes `move_s`.

    If even the fastest possible move takes longer than `move_s`, the result is the peak rate of that move.
    """
    root = (acceleration * move_s) ** 2 - 4.0 * acceleration * length
    if root < 0.0:
        return math.sqrt(acceleration * length)
    return (acceleration * move_s - math.sqrt(root)) / 2.0


def _move_s(length: float, rate: float, acceleration: float) -> float:
    if rate * rate / acceleration <= length:
        return length / rate + rate / acceleration
    return 2.0 * math.sqrt(length / acceleration)


def _number(value: float, decimals: int) -> str:
    """A number without trailing zeros, because the controller's buffer holds only 128 characters."""
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _comment(text: str) -> str:
    """Text valid as a G-code comment: printable ASCII without parentheses, at most 60 characters."""
    return "".join(c if c.isascii() and c.isprintable() and c not in "()" else "_" for c in text)[:60]
