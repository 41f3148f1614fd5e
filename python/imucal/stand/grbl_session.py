"""A session with a GRBL 1.1 controller: its last state, and the exchanges for stop, reset and settings.

Exchanges that wait for answers are generators that yield while they wait, so that recording continues.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeAlias

from imucal.stand.clock import Clock
from imucal.stand.gcode import MotorLimits
from imucal.stand.grbl_port import HOLD, RESET, STATUS, GrblPort, Report, report_of
from imucal.stand.link import LinkLostError

__all__ = ["GrblSession", "Timeouts", "Triple"]

Triple: TypeAlias = tuple[float, float, float]
Waiting: TypeAlias = Generator[None, None, bool]

# Interval between status queries, s.
QUERY_S: Final = 0.1
# Attempts of a handshake.
TRIES: Final = 4
# Numbers of GRBL's settings for the first motor: highest rate, deg/min, and acceleration, deg/s^2. The next
# two numbers are those for the other motors.
FIRST_RATE, FIRST_ACCELERATION = 110, 120


@dataclass(frozen=True)
class Timeouts:
    """Timeouts of the driver, s.

    answer_s     for the answer to a query
    stall_s      for the answer to a line, in addition to the duration of the line
    reconnect_s  for a lost port to reappear
    """

    answer_s: float = 2.0
    stall_s: float = 3.0
    reconnect_s: float = 15.0


class GrblSession:
    """State of a session with a controller.

    report      last status report, None if there was none since the last reset
    reported_s  host time of the last report, s
    busy_s      host time of the last report with moving motors, s
    """

    def __init__(self, port: GrblPort, timeouts: Timeouts, clock: Clock) -> None:
        self.port = port
        self._clock = clock
        self.report: Report | None = None
        self.reported_s = self.busy_s = 0.0
        self._timeouts = timeouts
        self._queried_s = 0.0
        self._wco: tuple[float, ...] | None = None
        self._is_welcomed = False
        self._oks = 0
        self._settings: dict[int, float] = {}

    def receive(self) -> Sequence[str | Report]:
        """Received reports and other lines; also queries the status when a query is due."""
        now_s = self._clock.now_s()
        if now_s - self._queried_s >= QUERY_S:
            self._queried_s = now_s
            self.port.send(STATUS)
        received: list[str | Report] = []
        for line in self.port.lines():
            reported = report_of(line, self._wco)
            if reported is not None:
                self.report, self._wco = reported
                self.reported_s = now_s
                self.busy_s = self.busy_s if self.report.state == "Idle" else now_s
                received.append(self.report)
                continue
            self._is_welcomed = self._is_welcomed or line.startswith("Grbl ")
            self._oks += line == "ok"
            number, equals, value = line.removeprefix("$").partition("=")
            if line.startswith("$") and equals:
                with suppress(ValueError, IndexError):
                    self._settings[int(number)] = float(value.split()[0])
            received.append(line)
        return received

    @property
    def position_deg(self) -> Triple | None:
        """Machine position in the last report, deg."""
        return None if self.report is None else self.report.position_deg

    @property
    def motor_limits(self) -> MotorLimits:
        """The motor limits in the controller's settings."""
        rates = [self._settings[FIRST_RATE + axis] / 60.0 for axis in range(3)]
        accelerations = [self._settings[FIRST_ACCELERATION + axis] for axis in range(3)]
        return MotorLimits(
            (rates[0], rates[1], rates[2]), (accelerations[0], accelerations[1], accelerations[2])
        )

    def halt(self) -> Waiting:
        """Stop the motors; returns whether they are at rest."""
        self.report = None
        self.port.send(HOLD)
        return (yield from self.until(lambda: self.report is not None and self.report.stands))

    def handshake(self) -> Waiting:
        """Reset the controller and wait until it is unlocked and idle with known position and settings.

        A damaged welcome line is tolerated, as a status report gives the same information. Raises
        LinkLostError after `TRIES` attempts.
        """
        for _ in range(TRIES):
            self.report, self._is_welcomed = None, False
            self.port.send(RESET)
            yield from self.until(lambda: self._is_welcomed, self._timeouts.answer_s / 2)
            # Answers to lines sent before the reset have arrived by now; count from here.
            self.report, self._oks = None, 0
            self.port.send(b"$X\n")
            if not (yield from self.until(lambda: self._oks == 1 and self._is_ready())):
                continue
            # Wait for the complete answer; a late part would be taken for the answer to the next line.
            self.port.send(b"$$\n")
            if (yield from self.until(lambda: self._oks == 2 and self._has_settings())):
                return True
        raise LinkLostError(
            f"{self.port.name}: no GRBL 1.1 controller becomes ready: check port, baud rate and supply"
        )

    def until(self, condition: Callable[[], bool], longest_s: float | None = None) -> Waiting:
        """Wait for a condition; returns whether it came true within `longest_s` (default: `answer_s`)."""
        deadline_s = self._clock.now_s() + (self._timeouts.answer_s if longest_s is None else longest_s)
        while not condition():
            if self._clock.now_s() > deadline_s:
                return False
            yield
        return True

    def _is_ready(self) -> bool:
        return (
            self.report is not None and self.report.state == "Idle" and self.report.position_deg is not None
        )

    def _has_settings(self) -> bool:
        return all(
            self._settings.get(first + axis, 0.0) > 0.0
            for first in (FIRST_RATE, FIRST_ACCELERATION)
            for axis in range(3)
        )
