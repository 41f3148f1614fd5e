"""A session with a GRBL controller: its last state, and the exchanges of commands, stop and reset.

Exchanges are generators that yield while they wait for answers, so that recording continues. A line is sent
only after the previous line was answered. A line that is refused or not answered is sent again. Repeating a
line is safe, because all lines of the driver are idempotent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from imucal.stand.clock import Clock
from imucal.stand.driver import Event
from imucal.stand.grbl_port import GOLDEN, HOLD, RESET, STATUS, GrblPort
from imucal.stand.grbl_report import (
    ALARMS,
    ERRORS,
    LOCKED_ERROR,
    Parser,
    Report,
    Triple,
    is_alarm,
    is_lock,
    is_welcome,
    number_in,
)
from imucal.stand.grbl_times import one_way_s
from imucal.stand.link import LinkLostError

__all__ = ["GrblSession", "StoppedError", "Timeouts", "TroubleError"]

Waiting: TypeAlias = Generator[None, None, Any]

# Number of attempts of a command, of a reset, and of reading the settings.
TRIES: Final = 6
# Time after a failed command in which late answers are discarded, s.
QUIET_S: Final = 0.3
# Interval between repeated requests to stop, s, because a single character may be lost.
STOP_EVERY_S: Final = 0.3
# Timeout for moving motors to stop, s.
STOP_S: Final = 6.0
# The shortest time between a query and its report is measured with this number of queries.
ROUND_TRIPS: Final = 16
# Longest pause before each of these queries, s. The pauses vary, because a controller or a port with a fixed
# cycle would otherwise answer with the same delay each time.
CYCLE_S: Final = 0.02
# A report that is delayed by more than the shortest delay plus this time, s, is not used. The time is shorter
# than the interval between queries, so that a report is also not used if it is assigned to an earlier query
# than its own, which happens after the loss of a query.
LATE_S: Final = 0.03
# Number of equal readings after which a setting counts as known. One reading is not sufficient, because the
# text has no checksum.
AGREEING: Final = 2


class StoppedError(Exception):
    """The run has to end, because the stand must not be moved without the user.

    `code` is a stable identifier.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code, self.message = code, message


class TroubleError(Exception):
    """A step failed, but may be repeated after the motors have stopped. `code` is a stable identifier."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code, self.message = code, message


@dataclass(frozen=True)
class Timeouts:
    """Timeouts of the driver, s.

    answer_s     longest time until a line or a query is answered
    stall_s      longest time without a report of the controller, and longest time from the line that commands
                 a move until the motors move
    reconnect_s  longest time until a lost port reappears
    pause_s      longest time until the user ends a feed hold or closes the safety door
    boot_s       longest time until the first report of a controller that restarts when its port is opened
    """

    answer_s: float = 2.0
    stall_s: float = 3.0
    reconnect_s: float = 15.0
    pause_s: float = 15.0
    boot_s: float = 5.0


class GrblSession:
    """State of a session with a controller.

    report     last status report; None if none has arrived since the last reset
    offset_deg last reported offset of the work coordinates; None if none was reported since the last reset
    is_locked  text of the alarm or lock that was received while the session started
    starting   whether the session is starting. During the start, alarms and locks do not end the session,
               because the start handles them
    is_stopping  whether the driver is stopping the motors, so that a feed hold was caused by the driver
    events     events for the journal, which report the lines that had to be sent again
    """

    def __init__(self, port: GrblPort, parser: Parser, timeouts: Timeouts, clock: Clock) -> None:
        self.port, self.parser, self.timeouts = port, parser, timeouts
        self._clock = clock
        self.report: Report | None = None
        self.offset_deg: Triple | None = None
        self.starting = True
        self.is_stopping = False
        self.is_locked = ""
        self.events: list[Event] = []
        self.reported_s = clock.now_s()
        # Length of the last report, characters.
        self._length = 0
        self.answers: list[str] = []
        self._expects_welcome = True
        self._is_welcomed = False
        self._settings: dict[int, Counter[str]] = {}
        # Total duration of all pauses of the run, such as feed holds, s. All timeouts are extended by this
        # time.
        self.paused_s = 0.0

    def now_s(self) -> float:
        """Host time minus the total duration of all pauses, s."""
        return self._clock.now_s() - self.paused_s

    def receive(self) -> Sequence[Report]:
        """The reports since the last call; raises StoppedError for an alarm, a lock or a restart."""
        reports = []
        for arrived_s, asked_s, line in self.port.received():
            report = self.parser.report(line, arrived_s, asked_s)
            if report is None:
                self._take(line)
                continue
            self.report, self.reported_s = report, arrived_s
            self._length = len(line) + len("\r\n")
            self.offset_deg = report.offset_deg or self.offset_deg
            reports.append(report)
        return reports

    def is_late(self, report: Report) -> bool:
        """Whether a report was delayed, on the line or by a busy computer."""
        shortest_s = self.port.shortest_s
        if report.asked_s is None or shortest_s is None:
            return True
        return report.arrived_s - report.asked_s > shortest_s + LATE_S

    def latest_s(self, report: Report) -> float:
        """Latest possible host time at which the position of a report was taken."""
        return report.arrived_s - one_way_s(self.port.shortest_s or 0.0, self._length, self.port.baud)[1]

    def measure_delay(self) -> Waiting:
        """Measure the shortest time between a query and its report, one query at a time."""
        trips: list[float] = []
        self.port.queries = False
        yield from self.pause(self.timeouts.answer_s / 4)
        for number in range(ROUND_TRIPS):
            yield from self.pause(CYCLE_S * (number * GOLDEN % 1.0))
            self.report, asked_s = None, self._clock.now_s()
            self.port.send(STATUS)
            if (yield from self.until(lambda: self.report is not None)) and self.report is not None:
                trips.append(self.report.arrived_s - asked_s)
        if not trips:
            raise LinkLostError(f"{self.port.name}: the controller does not report its status")
        self.port.forget_queries()
        self.port.shortest_s = min(trips)
        self.port.queries = True

    def _take(self, line: str) -> None:
        """Handle a line that is not a report."""
        number, equals, value = line.removeprefix("$").partition("=")
        if line == "ok":
            self.answers.append(line)
        elif line.startswith("$") and equals and number.isdigit():
            self._settings.setdefault(int(number), Counter())[value.split(" ")[0]] += 1
        elif is_alarm(line):
            self._lock(_alarm_text(number_in(line)))
        elif is_lock(line):
            self._lock(f"the controller says {line}")
        elif is_welcome(line):
            if not self._expects_welcome:
                raise StoppedError(
                    "position_lost",
                    f"the controller has restarted ({line}), so the position of the motors is not known",
                )
            self._is_welcomed = True
        elif "r:" in line or line.startswith("err"):
            code = number_in(line)
            if code == LOCKED_ERROR:
                self._lock("the controller is locked: it answered error 9")
            self.answers.append(f"error {code}: {ERRORS.get(code, 'see the manual of the controller')}")

    def _lock(self, text: str) -> None:
        self.is_locked = self.is_locked or text
        if not self.starting:
            raise StoppedError("alarm", text)

    # --- exchanges ---

    def until(self, condition: Callable[[], bool], longest_s: float | None = None) -> Waiting:
        """Wait for a condition. Returns whether it became true within `longest_s` (default: `answer_s`)."""
        deadline_s = self.now_s() + (self.timeouts.answer_s if longest_s is None else longest_s)
        while not condition():
            if self.now_s() > deadline_s:
                return False
            yield
        return True

    def pause(self, duration_s: float) -> Waiting:
        """Wait for `duration_s`, s."""
        yield from self.until(lambda: False, duration_s)

    def command(self, text: str) -> Waiting:
        """Send a line until the controller accepts it. Raises TroubleError after `TRIES` attempts."""
        answer = ""
        for attempt in range(TRIES):
            if attempt:
                self.events.append(Event("line_repeated", f"{text}: {answer}; sent again"))
                # If the line end was lost, this byte ends the line, so that the next attempt is a separate
                # line.
                self.port.send(b"\n")
                yield from self.pause(QUIET_S)
            self.answers.clear()
            self.port.send(text.encode() + b"\n")
            if not (yield from self.until(lambda: bool(self.answers))):
                answer = f"no answer within {self.timeouts.answer_s:g} s"
                continue
            answer = self.answers[0]
            if answer == "ok":
                return
        raise TroubleError("error", f"the controller does not accept {text}: {answer}")

    def halt(self) -> Waiting:
        """Stop the motors. Returns whether they are at rest."""
        self.is_stopping = True
        asked_s = self._clock.now_s()
        sent_s = asked_s - STOP_EVERY_S
        while (now_s := self._clock.now_s()) - asked_s < STOP_S:
            if now_s - sent_s >= STOP_EVERY_S:
                sent_s = now_s
                self.port.send(HOLD)
            report = self.report
            if report is not None and (
                (report.state == "Hold" and report.stands)
                or (report.state in ("Door", "Sleep", "Alarm") and report.arrived_s > asked_s)
                or (report.state == "Idle" and now_s - asked_s > self.timeouts.answer_s)
            ):
                return True
            yield
        return False

    def reset(self) -> Waiting:
        """Reset the controller, and wait for its answer. Raises LinkLostError if no answer arrives.

        A damaged welcome line is tolerated, because a status report gives the same information. The caller
        checks whether the controller is locked afterwards.
        """
        for _ in range(TRIES):
            self.report, self.offset_deg = None, None
            self._is_welcomed, self._expects_welcome = False, True
            self.port.send(RESET)
            yield from self.until(lambda: self._is_welcomed, self.timeouts.answer_s / 2)
            if not (yield from self.until(lambda: self.report is not None and self.report.state != "Hold")):
                continue
            yield from self.pause(QUIET_S)
            self.answers.clear()
            self.port.send(b"\n")
            answered = yield from self.until(lambda: bool(self.answers))
            self.is_stopping = False
            if answered or self.is_locked or (self.report is not None and self.report.state == "Alarm"):
                self._expects_welcome = False
                return
        raise LinkLostError(f"{self.port.name}: the controller does not answer after a reset")

    def settings(self, needed: Sequence[int]) -> Waiting:
        """Read all settings until the needed settings have agreeing readings, at most `TRIES` times.

        Returns the values of all settings, by number, without those whose readings do not agree.
        """
        for _ in range(TRIES):
            self.answers.clear()
            self.port.send(b"$$\n")
            yield from self.until(lambda: bool(self.answers))
            yield from self.pause(QUIET_S / 3)
            if all(self._agreed(number) is not None for number in needed):
                break
        return {number: value for number in self._settings if (value := self._agreed(number)) is not None}

    def _agreed(self, number: int) -> float | None:
        values = self._settings.get(number, Counter()).most_common(1)
        if not values or values[0][1] < AGREEING:
            return None
        try:
            return float(values[0][0])
        except ValueError:
            return None


def _alarm_text(code: int) -> str:
    if code == 0:
        return "the controller reports an alarm, but the number of the alarm was lost"
    return f"alarm {code}: {ALARMS.get(code, 'see the manual of the controller')}"
