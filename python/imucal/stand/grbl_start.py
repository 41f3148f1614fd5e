"""Start of a session with a GRBL controller: its state, its settings, and the zero of the motors.

A stand is not moved unless the controller is idle, reports machine positions, and its motors are at zero. If
a decision of the user is needed, the start is refused with a message that names the option.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.errors import ImucalError, InputError
from imucal.stand.gcode import Block, MotorLimits
from imucal.stand.grbl_report import AXES, Triple
from imucal.stand.grbl_session import GrblSession, Waiting
from imucal.stand.link import LinkLostError

__all__ = ["NEAR_DEG", "Consent", "Ready", "prepared", "require_zero"]

# A motor counts as being at a position, such as zero, if it is within this angle of the position, deg.
NEAR_DEG: Final = 0.5
# Numbers of the GRBL settings for reports in inches ($13) and for soft limits ($20).
IN_INCHES, SOFT_LIMITS = 13, 20
# Numbers of the GRBL settings of the first axis: maximum rate, deg/min, acceleration, deg/s^2, and travel,
# deg. Each further axis has the next number.
FIRST_RATE, FIRST_ACCELERATION, FIRST_TRAVEL = 110, 120, 130
# Settings with this number or a larger one exist only in grblHAL.
FIRST_OF_HAL: Final = 300
# Timeout of the homing cycle, s.
HOMING_S: Final = 60.0
# Remedies for states in which a run cannot start.
STATES: Final = {
    "Hold": "a feed hold is active: end it at the controller (cycle start), or reset the controller",
    "Door": "the safety door is open: close it and reset the controller",
    "Sleep": "the controller sleeps and the motors are not powered: reset it and bring the motors to zero",
    "Check": "the controller is in check mode, in which nothing moves: end it ($C)",
    "Tool": "the controller waits for a tool change: end it at the controller",
    "Run": "the motors are moving: wait until they are at rest",
    "Jog": "the motors are moving: wait until they are at rest",
    "Home": "the motors are moving: wait until they are at rest",
}


@dataclass(frozen=True)
class Consent:
    """Actions that the user permits at the start.

    home        run the homing cycle ($H)
    unlock      unlock a controller that is locked by an alarm ($X)
    start_here  use the position of the motors at the start as their zero
    unwind      move the motors to the zero of the controller first
    """

    home: bool = False
    unlock: bool = False
    start_here: bool = False
    unwind: bool = False

    def __post_init__(self) -> None:
        if self.start_here and self.unwind:
            raise InputError("--start-here and --unwind exclude each other: give one of them")


@dataclass(frozen=True)
class Ready:
    """A controller that is ready to move.

    position_deg  machine position of the motors
    offset_deg    offset of work coordinates
    limits        rates and accelerations of the motors
    is_hal        whether the controller is grblHAL. It has tool offsets of all axes, and keeps the offset of
                  G92 over a restart
    """

    position_deg: Triple
    offset_deg: Triple
    limits: MotorLimits
    is_hal: bool


def prepared(session: GrblSession, consent: Consent, blocks: Sequence[Block]) -> Waiting:
    """Reset the controller and check it; returns `Ready`. Raises ImucalError with the remedy."""
    yield from _await_rest(session)
    try:
        yield from session.reset()
    except LinkLostError:
        raise ImucalError(
            f"{session.port.name}: no GRBL 1.1 controller becomes ready: check port, baud rate and supply"
        ) from None
    yield from _unlocked(session, consent)
    first = session.parser.indices
    axes = [base + axis for base in (FIRST_RATE, FIRST_ACCELERATION, FIRST_TRAVEL) for axis in first]
    settings = yield from session.settings([IN_INCHES, SOFT_LIMITS, *axes])
    letters = "".join(AXES[axis] for axis in first)
    count = session.report.count if session.report is not None else 0
    if max(first) >= count:
        raise ImucalError(
            f"--axes {letters}: the controller has {count} axes ({AXES[:count]}): name three of them"
        )
    missing = [f"${number}" for number in (IN_INCHES, *axes[:6]) if number not in settings]
    if missing:
        raise ImucalError(f"the controller does not report {', '.join(missing)}: check its cable")
    if settings[IN_INCHES]:
        if set(letters) - set("XYZ"):
            raise ImucalError("the controller reports inches for some of the axes ($13=1): set $13=0")
        session.parser.in_inches = True
    session.starting = False
    is_hal = any(number >= FIRST_OF_HAL for number in settings)
    if is_hal:
        # The driver sets targets by the tool offset. The tool offset is cleared here, because grblHAL keeps
        # the offset over a reset.
        yield from session.command("G49")
    position, offset = yield from _coordinates(session)
    yield from session.measure_delay()
    _require_travel(settings, axes[6:], blocks, letters)
    rates = [settings[FIRST_RATE + axis] / 60.0 for axis in first]
    accelerations = [settings[FIRST_ACCELERATION + axis] for axis in first]
    limits = MotorLimits(
        (rates[0], rates[1], rates[2]), (accelerations[0], accelerations[1], accelerations[2])
    )
    return Ready(position, offset, limits, is_hal)


def require_zero(position_deg: Triple, consent: Consent) -> None:
    """Raise ImucalError if the motors are not at zero and no option states how to proceed."""
    if max(map(abs, position_deg)) <= NEAR_DEG or consent.home or consent.start_here or consent.unwind:
        return
    at = ", ".join(f"{angle:.1f}" for angle in position_deg)
    raise ImucalError(
        f"the motors are not at zero but at {at} deg: give --unwind to turn them back to zero first, or "
        "--start-here if this position is the zero and no cable is wound"
    )


def _await_rest(session: GrblSession) -> Waiting:
    """Wait for a first report and for the end of a motion of an earlier run.

    Raises ImucalError with the remedy if the controller is then in a state of `STATES`.
    """
    yield from session.until(lambda: session.report is not None, session.timeouts.boot_s)
    moving = ("Run", "Jog", "Home")
    yield from session.until(
        lambda: session.report is None or session.report.state not in moving, session.timeouts.pause_s - 1.0
    )
    if session.report is not None and session.report.state in STATES:
        raise ImucalError(f"the stand cannot start: {STATES[session.report.state]}")


def _unlocked(session: GrblSession, consent: Consent) -> Waiting:
    """Home or unlock the controller if the user allows it; refuse a controller that stays locked."""
    if consent.home:
        session.port.send(b"$H\n")
        yield from session.until(lambda: bool(session.answers), HOMING_S)
        if session.answers[:1] != ["ok"]:
            raise ImucalError(
                f"homing has failed: {session.is_locked or ', '.join(session.answers) or 'no answer'}"
            )
        session.is_locked = ""
    elif session.report is None or session.report.state == "Alarm":
        why = f" ({session.is_locked})" if session.is_locked else ""
        if not consent.unlock:
            raise ImucalError(
                f"the controller is locked by an alarm{why}: free the stand and bring its motors to zero, "
                "then give --home to run the homing cycle, or --unlock to unlock it"
            )
        yield from session.command("$X")
        session.is_locked = ""
    if not (yield from session.until(lambda: session.report is not None and session.report.state == "Idle")):
        state = session.report.state if session.report else "silent"
        raise ImucalError(f"the stand cannot start: {STATES.get(state, f'the controller is {state}')}")


def _coordinates(session: GrblSession) -> Waiting:
    """Wait for a report, and return the machine position and the offset of the work coordinates."""
    session.report = session.offset_deg = None
    found = yield from session.until(
        lambda: (
            session.report is not None
            and session.report.position_deg is not None
            and session.offset_deg is not None
        ),
        session.timeouts.boot_s,
    )
    report, offset = session.report, session.offset_deg
    if found and report is not None and report.position_deg is not None and offset is not None:
        return report.position_deg, offset
    if report is not None and report.position_deg is None:
        raise ImucalError(
            "the controller reports work positions instead of machine positions: set $10=1 (GRBL) or $10=511 "
            "(grblHAL)"
        )
    raise ImucalError(
        "the controller does not report the offset of its work coordinates (WCO), which is needed to check "
        "each target before the motors move: set $10=1 (GRBL) or $10=511 (grblHAL)"
    )


def _require_travel(
    settings: dict[int, float], travels: Sequence[int], blocks: Sequence[Block], letters: str
) -> None:
    """If soft limits are on, refuse a program that exceeds the travel of an axis, before the first move.

    travels   number of the setting that contains the travel of each axis
    """
    if not settings.get(SOFT_LIMITS, 0.0):
        return
    angles = np.array([(0.0, 0.0, 0.0), *(block.angles_deg for block in blocks)])
    for letter, number, used in zip(letters, travels, np.ptp(angles, axis=0).tolist(), strict=True):
        travel = settings.get(number)
        if travel is not None and used > travel:
            raise ImucalError(
                f"soft limits are on ($20=1): the program turns {letter} over {used:.0f} deg, but ${number} "
                f"allows {travel:.0f} deg: set $20=0 or ${number}, or give another program"
            )
