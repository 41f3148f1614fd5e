"""Talking with a GRBL 1.1 controller: what it said last, and how one comes to terms with it.

What takes time is a generator that yields while it waits, so that the recording goes on meanwhile.
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

__all__ = ["GrblTalk", "Patience", "Triple"]

Triple: TypeAlias = tuple[float, float, float]
Waiting: TypeAlias = Generator[None, None, bool]

QUERY_S: Final = 0.1
TRIES: Final = 4
FIRST_RATE, FIRST_ACCELERATION = 110, 120


@dataclass(frozen=True)
class Patience:
    """How long the driver waits, s.

    answer_s     for the answer to a question
    stall_s      for the answer to a line, beyond the time that the line takes
    reconnect_s  for a cable that is gone to come back
    """

    answer_s: float = 2.0
    stall_s: float = 3.0
    reconnect_s: float = 15.0


class GrblTalk:
    """The two sides of a port.

    report      the last status report, None before the first one since a reset
    reported_s  the host's time of it, and `busy_s` of the last one that was not idle
    """

    def __init__(self, port: GrblPort, patience: Patience, clock: Clock) -> None:
        self.port = port
        self._clock = clock
        self.report: Report | None = None
        self.reported_s = self.busy_s = 0.0
        self._patience = patience
        self._asked_s = 0.0
        self._wco: tuple[float, ...] | None = None
        self._welcomed = False
        self._oks = 0
        self._settings: dict[int, float] = {}

    def hear(self) -> Sequence[str | Report]:
        """What has arrived: reports, and the lines that are none; asks for a report when one is due."""
        now_s = self._clock.now_s()
        if now_s - self._asked_s >= QUERY_S:
            self._asked_s = now_s
            self.port.send(STATUS)
        heard: list[str | Report] = []
        for line in self.port.lines():
            reported = report_of(line, self._wco)
            if reported is not None:
                self.report, self._wco = reported
                self.reported_s = now_s
                self.busy_s = self.busy_s if self.report.state == "Idle" else now_s
                heard.append(self.report)
                continue
            self._welcomed = self._welcomed or line.startswith("Grbl ")
            self._oks += line == "ok"
            number, equals, value = line.removeprefix("$").partition("=")
            if line.startswith("$") and equals:
                with suppress(ValueError, IndexError):
                    self._settings[int(number)] = float(value.split()[0])
            heard.append(line)
        return heard

    @property
    def position_deg(self) -> Triple | None:
        """The machine position of the last report."""
        return None if self.report is None else self.report.position_deg

    @property
    def motor_limits(self) -> MotorLimits:
        """What the controller's settings let the motors do."""
        rates = [self._settings[FIRST_RATE + axis] / 60.0 for axis in range(3)]
        accelerations = [self._settings[FIRST_ACCELERATION + axis] for axis in range(3)]
        return MotorLimits(
            (rates[0], rates[1], rates[2]), (accelerations[0], accelerations[1], accelerations[2])
        )

    def halt(self) -> Waiting:
        """Bring the motors to a stop; whether they stand."""
        self.report = None
        self.port.send(HOLD)
        return (yield from self.until(lambda: self.report is not None and self.report.stands))

    def handshake(self) -> Waiting:
        """Reset, and wait until it answers as GRBL does, unlocked and idle, its position and settings known.

        A welcome that comes damaged is no harm: a status report says as much. LinkLostError if it does not
        come to that.
        """
        for _ in range(TRIES):
            self.report, self._welcomed = None, False
            self.port.send(RESET)
            yield from self.until(lambda: self._welcomed, self._patience.answer_s / 2)
            # What was on its way before the reset has arrived by now.
            self.report, self._oks = None, 0
            self.port.send(b"$X\n")
            if not (yield from self.until(lambda: self._oks == 1 and self._is_ready())):
                continue
            # All of it is waited for: an answer that came later would pass for that of another line.
            self.port.send(b"$$\n")
            if (yield from self.until(lambda: self._oks == 2 and self._has_settings())):
                return True
        raise LinkLostError(
            f"{self.port.name}: no GRBL 1.1 answers and gets ready: check port, baud rate and supply"
        )

    def until(self, condition: Callable[[], bool], longest_s: float | None = None) -> Waiting:
        """Whether it comes true in this time, that of an answer if not said."""
        deadline_s = self._clock.now_s() + (self._patience.answer_s if longest_s is None else longest_s)
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
