"""Driver of a stand whose motors are controlled by GRBL 1.1 (docs/stand.md).

Lines are sent ahead as long as the unanswered characters fit into the controller's buffer. A move is sent
only after the motors were reported at rest in the pose of the step before it, because a byte lost in
transmission can change the target angle of a move. A step is done when its `G4` is answered and its pose was
reported.

All faults (a reset, an error, a lost byte, a silent or disconnected cable) have the same recovery: stop the
motors, reset and unlock the controller, read its position, and continue with the first step that is not done.
Angles are absolute, so a repeated step only adds another rest in the same pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from imucal.arrays import FloatArray
from imucal.errors import ImucalError
from imucal.rig.motion import Program, Step
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Event, Position, Status
from imucal.stand.gcode import Axes, Block, MotorLimits, blocks_of
from imucal.stand.grbl_port import ALARMS, ERRORS, RESET, RX_BUFFER, GrblPort, Report
from imucal.stand.grbl_session import GrblSession, Timeouts, Triple
from imucal.stand.link import LinkLostError, serial_port

__all__ = ["GrblDriver"]

# Pause between two polls of the port while starting or closing, s.
PAUSE_S: Final = 0.01
# Pause before a lost port is opened again, s.
REOPEN_S: Final = 0.3
# Rate at which the motors return to zero after the program, deg/s.
RETURN_DPS: Final = 60.0
# Largest deviation of each motor from its target, deg, at which a pose counts as reached.
NEAR_DEG: Final = 0.5
# Number of consecutive recoveries without progress after which the run fails.
MOST_RECOVERIES: Final = 4
# Alarms that end a run because the stand is not free to move: unknown, limit switch (1), soft limit (2).
UNKNOWN_ALARM: Final = 0
FINAL_ALARMS: Final = (UNKNOWN_ALARM, 1, 2)
# Modes of all lines: millimetres (degrees here), absolute positions, feed per minute.
SETUP: Final = b"G21G90G94\n"


@dataclass(frozen=True)
class _Line:
    """A line of G-code; `done` is the number of steps completed once it is answered, None for a move."""

    text: bytes
    step: int
    done: int | None


class GrblDriver:
    """Runs a program with a GRBL controller on a serial port.

    Zero is the position of the motors at the start. After the last step the motors return to zero, so that
    cables are unwound and the next program starts from the same position.

    port       name of the serial port
    baud       baud rate
    axes       axis letters of the three motors, outermost motor first
    open_port  opens the serial port with a name and a baud rate; raises LinkLostError if that fails
    """

    def __init__(
        self,
        program: Program,
        port: str,
        *,
        baud: int = 115200,
        axes: Axes | None = None,
        timeouts: Timeouts | None = None,
        clock: Clock = SYSTEM_CLOCK,
        open_port: Callable[[str, int], Any] = serial_port,
    ) -> None:
        self._program, self._axes = _with_return(program), axes or Axes()
        self._last_step = len(program.steps) - 1
        self._timeouts = timeouts or Timeouts()
        self._clock = clock
        self._session = GrblSession(GrblPort(port, baud, open_port), self._timeouts, clock)
        self._blocks: list[Block] = blocks_of(self._program, MotorLimits())
        # Controller position of the stand's zero, deg: angle = position - zero.
        self._zero: Triple = (0.0, 0.0, 0.0)
        self._to_send: deque[_Line] = deque()
        self._sent: deque[_Line] = deque()
        # Number of steps that were sent, whose pose was reported at rest, whose dwell was answered, and that
        # are done.
        self._begun = self._seen = self._held = self._done = 0
        self._recoveries = 0
        self._answered_s = 0.0
        # Angles at the last (re)start, and reported angles at rest that belong to no recent step.
        self._start_deg: Triple = (0.0, 0.0, 0.0)
        self._unexpected_deg: Triple | None = None
        # Last position before a fault; positions reported after it may refer to another zero.
        self._last_position_deg: Triple | None = None
        self._fault: Event | None = None
        self._reconnect_until_s: float | None = None
        self._alarm: int | None = None
        self._recovery: Generator[None, None, None] | None = None
        self._failed: Status | None = None
        self._readings: list[Position] = []
        self._events: list[Event] = []

    def start(self) -> None:
        """Open the port, check the controller, and read the motor limits and the position."""
        try:
            self._session.port.open()
            for _ in self._session.handshake():
                self._session.receive()
                self._clock.sleep(PAUSE_S)
        except LinkLostError as error:
            self._session.port.close()
            raise ImucalError(f"the stand cannot be driven: {error}") from None
        self._zero = self._session.position_deg or self._zero
        self._blocks = blocks_of(self._program, self._session.motor_limits)
        self._queue_steps()

    def poll(self) -> Status:
        """Process received lines, run a recovery if there is a fault, and send the next lines."""
        if self._failed is None and self._done < len(self._blocks):
            try:
                for received in self._session.receive() if self._session.port.is_open else ():
                    self._handle(received)
                if self._recovery is not None:
                    next(self._recovery, None)
                else:
                    self._check_connection()
                    self._send()
            except LinkLostError as error:
                self._lost(str(error))
        return self._status()

    def observe(self, samples: FloatArray) -> None:
        """Not needed: the controller reports the position of the motors."""

    def positions(self) -> Sequence[Position]:
        """Motor angles reported since the last call, relative to the stand's zero."""
        readings, self._readings = self._readings, []
        return readings

    def events(self) -> Sequence[Event]:
        """Events since the last call."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """Stop the motors and close the port."""
        with suppress(LinkLostError):
            if self._done < len(self._blocks):
                for _ in self._session.halt():
                    self._session.receive()
                    self._clock.sleep(PAUSE_S)
                self._session.port.send(RESET)
        self._session.port.close()

    def _status(self) -> Status:
        step = min(self._done, self._last_step)
        if self._failed is not None:
            return self._failed
        if self._done == len(self._blocks):
            return Status("finished", step)
        if self._done > self._last_step:
            return Status("moving", step, message="returning to zero")
        if self._recovery is not None:
            return Status("moving", step, message="recovering from a fault")
        report = self._session.report
        holds = report is not None and report.state == "Idle" and self._near(self._blocks[step].angles_deg)
        return Status("holding" if holds else "moving", step)

    # --- received lines ---

    def _handle(self, received: str | Report) -> None:
        if isinstance(received, Report):
            self._handle_report(received)
        elif received == "ok":
            self._handle_ok()
        elif received.startswith("error:"):
            code = _code(received)
            self._start_recovery(
                "error", f"the controller answered error {code}: {ERRORS.get(code, 'see its manual')}"
            )
        elif received.startswith("ALARM:"):
            self._alarm = _code(received)
            self._start_recovery("alarm", f"alarm {self._alarm}: {ALARMS.get(self._alarm, 'see its manual')}")
        elif received.startswith("Grbl "):
            self._start_recovery("reset", "the controller has restarted")

    def _handle_report(self, report: Report) -> None:
        angles = self._angles()
        if angles is None:
            return
        self._readings.append((self._session.reported_s, *angles))
        if self._recovery is not None:
            return
        self._last_position_deg = self._session.position_deg
        steps = self._blocks[max(self._done - 1, 0) : self._done + 2]
        # Includes the previous step, because a lost answer makes the done count lag by one.
        known = [self._start_deg, *(step.angles_deg for step in steps)]
        ranges = [(min(motor) - NEAR_DEG, max(motor) + NEAR_DEG) for motor in zip(*known, strict=True)]
        if report.state == "Idle":
            self._unexpected_deg = None if any(map(self._near, known)) else angles
            if self._seen < len(self._blocks) and self._near(self._blocks[self._seen].angles_deg):
                self._seen += self._seen < self._begun
            self._update_done()
        elif not all(low <= angle <= high for angle, (low, high) in zip(angles, ranges, strict=True)):
            # A damaged digit can cause a move of many turns, so the recovery does not wait for the pose.
            self._start_recovery(
                "wrong_pose", f"the motors are outside the commanded range, at {_text(angles)} deg"
            )

    def _handle_ok(self) -> None:
        """Handle an `ok`: answers come in the order of the lines."""
        self._answered_s = self._clock.now_s()
        if self._recovery is not None or self._fault is not None or not self._sent:
            return
        self._held = self._sent.popleft().done or self._held
        self._update_done()

    def _update_done(self) -> None:
        """Count a step as done once its dwell is answered and its pose was reported."""
        if self._held > self._done and self._unexpected_deg is not None:
            at = _text(self._unexpected_deg)
            self._start_recovery("wrong_pose", f"the motors are at rest at {at} deg in step {self._held}")
        elif min(self._held, self._seen) > self._done:
            self._done, self._recoveries = min(self._held, self._seen), 0

    def _angles(self) -> Triple | None:
        position = self._session.position_deg
        if position is None:
            return None
        x, y, z = (p - zero for p, zero in zip(position, self._zero, strict=True))
        return (x, y, z)

    def _near(self, angles_deg: Sequence[float]) -> bool:
        at = self._angles()
        return at is not None and all(
            abs(angle - target) < NEAR_DEG for angle, target in zip(at, angles_deg, strict=True)
        )

    # --- sent lines ---

    def _queue_steps(self) -> None:
        """Queue the lines of all steps that are not done."""
        self._sent.clear()
        self._to_send = deque([_Line(SETUP, self._done, None)])
        for number, block in enumerate(self._blocks[self._done :], start=self._done):
            if block.feed_dpm is not None:
                move = block.move_line(self._axes, "G53G1", self._zero).encode() + b"\n"
                self._to_send.append(_Line(move, number, None))
            self._to_send.append(_Line(block.dwell_line().encode() + b"\n", number, number + 1))
        self._begun = self._seen = self._held = self._done
        self._answered_s = self._clock.now_s()
        self._start_deg = self._angles() or self._start_deg
        self._fault = self._alarm = self._unexpected_deg = self._reconnect_until_s = None

    def _send(self) -> None:
        """Send lines that fit into the buffer, but no move before the preceding pose is reported."""
        while self._to_send and self._to_send[0].step <= self._seen:
            line = self._to_send[0]
            if sum(len(sent.text) for sent in self._sent) + len(line.text) > RX_BUFFER - 1:
                return
            self._session.port.send(line.text)
            self._sent.append(line)
            self._to_send.popleft()
            self._begun = max(self._begun, line.done or 0)

    # --- faults and recovery ---

    def _check_connection(self) -> None:
        """Detect an alarm, a silent port, and motors at rest while a line stays unanswered."""
        now_s = self._clock.now_s()
        report = self._session.report
        if report is not None and report.state == "Alarm":
            self._alarm = UNKNOWN_ALARM
            self._start_recovery("alarm", "the controller is locked by an alarm whose number did not arrive")
        silent_s = now_s - max(self._session.reported_s, self._answered_s)
        if silent_s > self._timeouts.stall_s:
            raise LinkLostError(f"{self._session.port.name} has been silent for {silent_s:.1f} s")
        at_rest_s = now_s - max(self._answered_s, self._session.busy_s)
        if self._sent and at_rest_s > self._blocks[self._done].hold_s + self._timeouts.stall_s:
            self._start_recovery(
                "stalled", f"the motors are at rest and a line has not been answered for {at_rest_s:.1f} s"
            )

    def _start_recovery(self, code: str, message: str) -> None:
        if self._fault is not None or self._recovery is not None:
            return
        self._fault = Event(code, message)
        if code == "alarm" and self._alarm in FINAL_ALARMS:
            self._fail(
                "alarm", f"{message}: free the stand, bring its motors to zero, and run the program again"
            )
            return
        self._events.append(self._fault)
        self._recovery = self._recover(self._fault)

    def _fail(self, code: str, message: str) -> None:
        self._failed = Status("failed", min(self._done, self._last_step), code, message)

    def _recover(self, fault: Event) -> Generator[None, None, None]:
        """Recover: stop, reset, unlock, and queue the remaining steps."""
        self._recoveries += 1
        if self._recoveries > MOST_RECOVERIES:
            self._fail(
                fault.code,
                f"{fault.message}; step {self._done + 1} is not done after {MOST_RECOVERIES} recoveries: "
                "check the controller, its cable and its supply",
            )
            return
        if fault.code != "reset":
            yield from self._session.halt()
        yield from self._session.handshake()
        self._restore_zero()
        self._events.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))
        self._queue_steps()
        self._recovery = None

    def _restore_zero(self) -> None:
        """Correct the zero after a power loss, which resets the controller's position without a move."""
        before, now = self._last_position_deg, self._session.position_deg
        self._last_position_deg = now
        if before is None or now is None or any(now) or max(map(abs, before)) < NEAR_DEG:
            return
        x, y, z = (zero - angle for zero, angle in zip(self._zero, before, strict=True))
        self._zero = (x, y, z)
        self._events.append(
            Event(
                "position_lost",
                "the controller has reset its position to zero: angles continue from the last report",
            )
        )

    def _lost(self, reason: str) -> None:
        """Close a lost or silent port and reconnect until `reconnect_s` has passed."""
        self._session.port.close()
        now_s = self._clock.now_s()
        if self._reconnect_until_s is None:
            self._reconnect_until_s = now_s + self._timeouts.reconnect_s
            self._events.append(Event("controller_lost", reason))
        if now_s > self._reconnect_until_s:
            self._fail(
                "controller_lost",
                f"{reason}; no reconnection within {self._timeouts.reconnect_s:.0f} s: check cable and "
                "supply, bring the motors to zero, and run the program again",
            )
        self._recovery = self._reconnect(reason)

    def _reconnect(self, reason: str) -> Generator[None, None, None]:
        again_s = self._clock.now_s() + REOPEN_S
        while self._clock.now_s() < again_s:
            yield
        self._session.port.open()
        yield from self._recover(Event("controller_lost", reason))


def _with_return(program: Program) -> Program:
    """The program with a final move back to its start."""
    x, y, z = (-sum(step.turn_deg[axis] for step in program.steps) for axis in range(3))
    back = Step((x, y, z), max(abs(x), abs(y), abs(z)) / RETURN_DPS, 0.0)
    return Program((*program.steps, back), program.stand)


def _text(angles: Sequence[float]) -> str:
    return ", ".join(f"{angle:.2f}" for angle in angles)


def _code(line: str) -> int:
    digits = line.partition(":")[2].strip()
    return int(digits) if digits.isdigit() else 0
