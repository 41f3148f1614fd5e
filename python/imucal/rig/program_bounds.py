"""Checks a program for a stand. Values that no stand or gyroscope can follow are treated as mistakes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

__all__ = [
    "MAX_ACCELERATION_DPS2",
    "MAX_ANGLE_DEG",
    "MAX_DURATION_S",
    "MAX_RATE_DPS",
    "MAX_STEP_S",
    "Fault",
    "fault_of",
    "too_many",
    "turned_too_far",
]

# Largest accepted number of steps of a program. For comparison, a grid of 1 deg over the sphere has 64,800
# poses.
MAX_STEPS: Final = 100_000
# Largest accepted angle of a motor from its start, deg. It is a hundred revolutions, which would tear any
# cable.
MAX_ANGLE_DEG: Final = 36_000.0
# Largest accepted mean rate of a motor over a turn, deg/s. The largest range of MEMS gyroscopes is 4000
# deg/s.
MAX_RATE_DPS: Final = 5_000.0
# Largest accepted acceleration of a motor, deg/s^2. For comparison, a hobby servo that turns by 60 deg in 0.1
# s reaches 48,000 deg/s^2.
MAX_ACCELERATION_DPS2: Final = 200_000.0
# The peak acceleration of a turn is this number times the angle of the turn divided by the square of its
# duration.
PEAK_ACCELERATION: Final = 8.0
# Longest accepted turn or rest (a day) and longest accepted program (a week), s.
MAX_STEP_S: Final = 86_400.0
MAX_DURATION_S: Final = 7 * MAX_STEP_S


class Timed(Protocol):
    """A step of a program."""

    @property
    def turn_deg(self) -> tuple[float, float, float]:
        """Rotation of each motor, deg."""

    @property
    def move_s(self) -> float:
        """Duration of the rotation, s."""

    @property
    def hold_s(self) -> float:
        """Duration of the rest after the rotation, s."""


class Fault(NamedTuple):
    """The first field of a program that is out of bounds: its path and the reason."""

    path: str
    reason: str


def too_many(count: int) -> Fault | None:
    """The fault of a program with more than `MAX_STEPS` steps, or None."""
    if count > MAX_STEPS:
        return Fault("$.steps", f"has {count} items: a program has at most {MAX_STEPS} steps")
    return None


def fault_of(steps: Sequence[Timed]) -> Fault | None:
    """The first field that is out of bounds, or None. NaN is out of all bounds."""
    fault = too_many(len(steps))
    if fault is not None:
        return fault
    angles_deg, duration_s = [0.0, 0.0, 0.0], 0.0
    for index, step in enumerate(steps):
        path = f"$.steps[{index}]"
        for name, time_s in (("move_s", step.move_s), ("hold_s", step.hold_s)):
            if not 0.0 <= time_s <= MAX_STEP_S:
                too_long = f"is {time_s}: give 0 to {MAX_STEP_S:g} s, a day"
                return Fault(
                    f"{path}.{name}", too_long if time_s > 0 else f"is {time_s}, it must not be negative"
                )
        for motor, turn_deg in enumerate(step.turn_deg):
            angles_deg[motor] += turn_deg
            if not abs(angles_deg[motor]) <= MAX_ANGLE_DEG:
                return Fault(f"{path}.turn_deg[{motor}]", turned_too_far(angles_deg[motor], MAX_ANGLE_DEG))
            reason = _too_fast(abs(turn_deg), step.move_s)
            if reason is not None:
                return Fault(
                    f"{path}.turn_deg[{motor}]",
                    f"is {turn_deg}, but {path}.move_s is {step.move_s}: {reason}",
                )
        duration_s += step.move_s + step.hold_s
    if duration_s > MAX_DURATION_S:
        return Fault(
            "$.steps", f"take {duration_s:.6g} s: a program takes at most {MAX_DURATION_S:g} s, a week"
        )
    return None


def turned_too_far(angle_deg: float, most_deg: float) -> str:
    """The reason why a motor must not turn to this angle, as the end of a message."""
    return f"turns the motor to {angle_deg:.6g} deg from its start: give angles up to {most_deg:g} deg"


def _too_fast(turn_deg: float, move_s: float) -> str | None:
    if turn_deg == 0.0:
        return None
    if move_s == 0.0:
        return "the turn takes no time: give a positive move_s"
    rate, acceleration = turn_deg / move_s, PEAK_ACCELERATION * turn_deg / move_s / move_s
    if not rate <= MAX_RATE_DPS:
        return f"a mean rate of {rate:.3g} deg/s; give at most {MAX_RATE_DPS:g} deg/s"
    if not acceleration <= MAX_ACCELERATION_DPS2:
        return (
            f"an acceleration of {acceleration:.3g} deg/s^2; give at most {MAX_ACCELERATION_DPS2:g} deg/s^2"
        )
    return None
