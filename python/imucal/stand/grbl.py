"""A stand whose motors a GRBL 1.1 controller turns (docs/stand.md).

Lines are sent ahead as far as the characters not yet answered fit into the controller's buffer, but no
move before the motors were seen at rest where the step before leads: a byte that is lost on the way may make
another angle of one. A step is done when its `G4` is answered, and that was seen. Whatever goes wrong (a
reset, an error, a lost byte, a silent or a pulled cable) has one way back: bring the motors to a stop, reset,
unlock, see where they are, and go on with the first step that is not done. Angles are absolute, so that a
step that is begun twice is one more rest and no error.
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
from imucal.stand.grbl_talk import GrblTalk, Patience, Triple
from imucal.stand.link import LinkLostError, serial_port

__all__ = ["GrblDriver"]

NAP_S: Final = 0.01
TRY_AGAIN_S: Final = 0.3
# How fast the motors go back to zero.
BACK_DPS: Final = 60.0
# A pose is reached if every motor is so near.
NEAR_DEG: Final = 0.5
# Ways back without a step done in between.
MOST_RETURNS: Final = 4
# Alarms that end a run: the motors ran into something, or the program would.
UNKNOWN_ALARM: Final = 0
FINAL_ALARMS: Final = (UNKNOWN_ALARM, 1, 2)
SETUP: Final = b"G21G90G94\n"


@dataclass(frozen=True)
class _Line:
    """A line of a step; `done` is the number of steps that are held once it is answered."""

    text: bytes
    step: int
    done: int | None


class GrblDriver:
    """Drives a program through a controller at a serial port.

    Zero is where the motors stand when it starts. After the last step they go back there, so that cables are
    as they were and the next program starts where this one did.

    axes       letters of the three motors, outer motor first
    open_port  opens the serial port of a name and a baud rate; LinkLostError with the reason if that fails
    """

    def __init__(
        self,
        program: Program,
        port: str,
        *,
        baud: int = 115200,
        axes: Axes | None = None,
        patience: Patience | None = None,
        clock: Clock = SYSTEM_CLOCK,
        open_port: Callable[[str, int], Any] = serial_port,
    ) -> None:
        self._program, self._axes = _and_back(program), axes or Axes()
        self._last_step = len(program.steps) - 1
        self._patience = patience or Patience()
        self._clock = clock
        self._talk = GrblTalk(GrblPort(port, baud, open_port), self._patience, clock)
        self._blocks: list[Block] = blocks_of(self._program, MotorLimits())
        # Where the controller sees the stand's zero: angle = position - zero.
        self._zero: Triple = (0.0, 0.0, 0.0)
        self._to_send: deque[_Line] = deque()
        self._sent: deque[_Line] = deque()
        # How many steps are sent, were seen at rest in their pose, have held it, and are done.
        self._begun = self._seen = self._held = self._done = 0
        self._returns = 0
        self._answered_s = 0.0
        # Where they stood when it went on, and where they have stood since though nobody told them to.
        self._from: Triple = (0.0, 0.0, 0.0)
        self._strayed: Triple | None = None
        # Where the controller last saw them before any trouble: reports after it may count from another zero.
        self._known: Triple | None = None
        self._trouble: Event | None = None
        self._lost_until_s: float | None = None
        self._alarm: int | None = None
        self._way_back: Generator[None, None, None] | None = None
        self._failed: Status | None = None
        self._readings: list[Position] = []
        self._happened: list[Event] = []

    def start(self) -> None:
        """Open the port and come to terms: who is there, what its motors can do, and where they stand."""
        try:
            self._talk.port.open()
            for _ in self._talk.handshake():
                self._talk.hear()
                self._clock.sleep(NAP_S)
        except LinkLostError as error:
            self._talk.port.close()
            raise ImucalError(f"the stand cannot be driven: {error}") from None
        self._zero = self._talk.position_deg or self._zero
        self._blocks = blocks_of(self._program, self._talk.motor_limits)
        self._go_on()

    def poll(self) -> Status:
        """Hear, ask, send."""
        if self._failed is None and self._done < len(self._blocks):
            try:
                for heard in self._talk.hear() if self._talk.port.is_open else ():
                    self._take(heard)
                if self._way_back is not None:
                    next(self._way_back, None)
                else:
                    self._look_for_trouble()
                    self._send()
            except LinkLostError as error:
                self._lost(str(error))
        return self._status()

    def see(self, samples: FloatArray) -> None:
        """The controller knows itself where the motors are."""

    def positions(self) -> Sequence[Position]:
        """Readings since the last call, in the stand's angles."""
        readings, self._readings = self._readings, []
        return readings

    def events(self) -> Sequence[Event]:
        """What happened since the last call."""
        happened, self._happened = self._happened, []
        return happened

    def close(self) -> None:
        """Stop the motors and let go."""
        with suppress(LinkLostError):
            if self._done < len(self._blocks):
                for _ in self._talk.halt():
                    self._talk.hear()
                    self._clock.sleep(NAP_S)
                self._talk.port.send(RESET)
        self._talk.port.close()

    def _status(self) -> Status:
        step = min(self._done, self._last_step)
        if self._failed is not None:
            return self._failed
        if self._done == len(self._blocks):
            return Status("finished", step)
        if self._done > self._last_step:
            return Status("moving", step, message="back to zero")
        if self._way_back is not None:
            return Status("moving", step, message="finding the way back")
        report = self._talk.report
        holds = report is not None and report.state == "Idle" and self._near(self._blocks[step].angles_deg)
        return Status("holding" if holds else "moving", step)

    # --- what the controller says ---

    def _take(self, heard: str | Report) -> None:
        if isinstance(heard, Report):
            self._take_report(heard)
        elif heard == "ok":
            self._answered()
        elif heard.startswith("error:"):
            code = _code(heard)
            self._in_trouble(
                "error", f"the controller answered error {code}: {ERRORS.get(code, 'see its manual')}"
            )
        elif heard.startswith("ALARM:"):
            self._alarm = _code(heard)
            self._in_trouble("alarm", f"alarm {self._alarm}: {ALARMS.get(self._alarm, 'see its manual')}")
        elif heard.startswith("Grbl "):
            self._in_trouble("reset", "the controller started anew")

    def _take_report(self, report: Report) -> None:
        angles = self._angles()
        if angles is None:
            return
        self._readings.append((self._talk.reported_s, *angles))
        if self._way_back is not None:
            return
        self._known = self._talk.position_deg
        steps = self._blocks[max(self._done - 1, 0) : self._done + 2]
        # The last of them, as an answer that was lost makes it seem one step behind.
        known = [self._from, *(step.angles_deg for step in steps)]
        ranges = [(min(motor) - NEAR_DEG, max(motor) + NEAR_DEG) for motor in zip(*known, strict=True)]
        if report.state == "Idle":
            self._strayed = None if any(map(self._near, known)) else angles
            if self._seen < len(self._blocks) and self._near(self._blocks[self._seen].angles_deg):
                self._seen += self._seen < self._begun
            self._settle()
        elif not all(low <= angle <= high for angle, (low, high) in zip(angles, ranges, strict=True)):
            # A digit too many may lead many turns away: not a moment to wait for the pose.
            self._in_trouble(
                "wrong_pose", f"the motors are on a way nobody sent them, at {_text(angles)} deg"
            )

    def _answered(self) -> None:
        """One line is read, or done: answers come in the order of the lines."""
        self._answered_s = self._clock.now_s()
        if self._way_back is not None or self._trouble is not None or not self._sent:
            return
        self._held = self._sent.popleft().done or self._held
        self._settle()

    def _settle(self) -> None:
        """A step that is held, and was seen where it should be, is done."""
        if self._held > self._done and self._strayed is not None:
            at = _text(self._strayed)
            self._in_trouble("wrong_pose", f"the motors stand at {at} deg in step {self._held}")
        elif min(self._held, self._seen) > self._done:
            self._done, self._returns = min(self._held, self._seen), 0

    def _angles(self) -> Triple | None:
        position = self._talk.position_deg
        if position is None:
            return None
        x, y, z = (p - zero for p, zero in zip(position, self._zero, strict=True))
        return (x, y, z)

    def _near(self, angles_deg: Sequence[float]) -> bool:
        at = self._angles()
        return at is not None and all(
            abs(angle - target) < NEAR_DEG for angle, target in zip(at, angles_deg, strict=True)
        )

    # --- what it is told ---

    def _go_on(self) -> None:
        """Line up all from the first step that is not done."""
        self._sent.clear()
        self._to_send = deque([_Line(SETUP, self._done, None)])
        for number, block in enumerate(self._blocks[self._done :], start=self._done):
            if block.feed_dpm is not None:
                move = block.move_line(self._axes, "G53G1", self._zero).encode() + b"\n"
                self._to_send.append(_Line(move, number, None))
            self._to_send.append(_Line(block.dwell_line().encode() + b"\n", number, number + 1))
        self._begun = self._seen = self._held = self._done
        self._answered_s = self._clock.now_s()
        self._from = self._angles() or self._from
        self._trouble = self._alarm = self._strayed = self._lost_until_s = None

    def _send(self) -> None:
        """What fits into the controller's buffer, but no move before the pose ahead of it was seen."""
        while self._to_send and self._to_send[0].step <= self._seen:
            line = self._to_send[0]
            if sum(len(sent.text) for sent in self._sent) + len(line.text) > RX_BUFFER - 1:
                return
            self._talk.port.send(line.text)
            self._sent.append(line)
            self._to_send.popleft()
            self._begun = max(self._begun, line.done or 0)

    # --- trouble, and the way back ---

    def _look_for_trouble(self) -> None:
        """A port that is silent; motors that stand while lines are not answered, as bytes were lost."""
        now_s = self._clock.now_s()
        report = self._talk.report
        if report is not None and report.state == "Alarm":
            self._alarm = UNKNOWN_ALARM
            self._in_trouble("alarm", "the controller is locked by an alarm whose number did not arrive")
        silent_s = now_s - max(self._talk.reported_s, self._answered_s)
        if silent_s > self._patience.stall_s:
            raise LinkLostError(f"{self._talk.port.name} has been silent for {silent_s:.1f} s")
        stood_s = now_s - max(self._answered_s, self._talk.busy_s)
        if self._sent and stood_s > self._blocks[self._done].hold_s + self._patience.stall_s:
            self._in_trouble(
                "stalled", f"the motors stand and a line has not been answered for {stood_s:.1f} s"
            )

    def _in_trouble(self, code: str, message: str) -> None:
        if self._trouble is not None or self._way_back is not None:
            return
        self._trouble = Event(code, message)
        if code == "alarm" and self._alarm in FINAL_ALARMS:
            self._fail(
                "alarm", f"{message}: free the stand, bring its motors to zero, and run the program again"
            )
            return
        self._happened.append(self._trouble)
        self._way_back = self._return(self._trouble)

    def _fail(self, code: str, message: str) -> None:
        self._failed = Status("failed", min(self._done, self._last_step), code, message)

    def _return(self, trouble: Event) -> Generator[None, None, None]:
        """Stop, reset, unlock, and go on."""
        self._returns += 1
        if self._returns > MOST_RETURNS:
            self._fail(
                trouble.code,
                f"{trouble.message}; {MOST_RETURNS} new starts have not ended step {self._done + 1}: "
                "look at the controller, its cable and its supply",
            )
            return
        if trouble.code != "reset":
            yield from self._talk.halt()
        yield from self._talk.handshake()
        self._keep_angles()
        self._happened.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))
        self._go_on()
        self._way_back = None

    def _keep_angles(self) -> None:
        """A controller that lost its supply takes where it stands for zero; the stand has not moved."""
        before, now = self._known, self._talk.position_deg
        self._known = now
        if before is None or now is None or any(now) or max(map(abs, before)) < NEAR_DEG:
            return
        x, y, z = (zero - angle for zero, angle in zip(self._zero, before, strict=True))
        self._zero = (x, y, z)
        self._happened.append(
            Event(
                "position_lost",
                "the controller takes where it stands for zero: angles go on from the last report",
            )
        )

    def _lost(self, reason: str) -> None:
        """The port is gone, or silent: open it again, for as long as patience lasts."""
        self._talk.port.close()
        now_s = self._clock.now_s()
        if self._lost_until_s is None:
            self._lost_until_s = now_s + self._patience.reconnect_s
            self._happened.append(Event("controller_lost", reason))
        if now_s > self._lost_until_s:
            self._fail(
                "controller_lost",
                f"{reason}; it has not come back within {self._patience.reconnect_s:.0f} s: check cable and "
                "supply, bring the motors to zero, and run the program again",
            )
        self._way_back = self._reconnect(reason)

    def _reconnect(self, reason: str) -> Generator[None, None, None]:
        again_s = self._clock.now_s() + TRY_AGAIN_S
        while self._clock.now_s() < again_s:
            yield
        self._talk.port.open()
        yield from self._return(Event("controller_lost", reason))


def _and_back(program: Program) -> Program:
    """The program, and a move to where it began."""
    x, y, z = (-sum(step.turn_deg[axis] for step in program.steps) for axis in range(3))
    back = Step((x, y, z), max(abs(x), abs(y), abs(z)) / BACK_DPS, 0.0)
    return Program((*program.steps, back), program.stand)


def _text(angles: Sequence[float]) -> str:
    return ", ".join(f"{angle:.2f}" for angle in angles)


def _code(line: str) -> int:
    digits = line.partition(":")[2].strip()
    return int(digits) if digits.isdigit() else 0
