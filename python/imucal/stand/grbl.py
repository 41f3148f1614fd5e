"""Driver of a stand whose motors are controlled by GRBL 1.1 or grblHAL (docs/stand.md).

The motors never move to a target that the controller might have misread. For each step the driver sets the
origin of the work coordinates to the target (`G92`; `G43.1` with grblHAL, which stores G92), waits until a
report confirms this offset, and then commands a move to 0, 0, 0. A byte lost on the way can prevent or
shorten a move, but cannot send the motors past the target. The confirmed offset also proves that the
controller has not restarted, because a restart clears the offset.

A step is complete when its pose has been reported at rest for the hold time of the step. After a fault of the
line (a refused line, a lost cable, a silent controller) the step is repeated from the reported position. An
alarm, a locked controller or a lost position ends the run: the stand is not moved again without the user.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from imucal.arrays import FloatArray
from imucal.errors import ImucalError
from imucal.rig.motion import Program, Step
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Event, Position, Progress, Status
from imucal.stand.gcode import ANGLE_DECIMALS, Axes, Block, MotorLimits, blocks_of
from imucal.stand.grbl_pause import Pause
from imucal.stand.grbl_port import RESET, GrblPort
from imucal.stand.grbl_report import Parser, Report, Triple
from imucal.stand.grbl_session import GrblSession, StoppedError, Timeouts, TroubleError, Waiting
from imucal.stand.grbl_start import Consent, Ready, prepared, require_zero
from imucal.stand.grbl_times import Instants
from imucal.stand.grbl_track import Track
from imucal.stand.link import LinkLostError, serial_port

__all__ = ["GrblDriver"]

# Pause between two polls of the port while starting or closing, s.
PAUSE_S: Final = 0.01
# Pause before a lost port is opened again, s.
REOPEN_S: Final = 0.3
# Rate at which the motors return to zero, deg/s.
RETURN_DPS: Final = 60.0
# Duration of the rest at zero after the last move, s, during which the last angles of the move are reported.
END_S: Final = 0.3
# The run fails after this number of consecutive recoveries from faults without a completed step.
MOST_RECOVERIES: Final = 4
# Maximum number of attempts to set a target, and to reach it. If all attempts fail, the controller is reset
# and the step is repeated.
MOST_MOVES: Final = 4
# A motor is at its target if it deviates by at most this angle, deg. Reports have a resolution of 0.001 deg.
AT_TARGET_DEG: Final = 0.02
# A reported offset of the work coordinates counts as equal to the requested offset if they differ by at most
# this angle, deg. It allows for half a unit of the last digit of a report, and for rounding.
SAME_DEG: Final = 0.0015
# The offset of the work coordinates after a restart of the controller is known, and a restart is detected by
# this offset. A target that would have the same offset is displaced by this angle, deg, so that a restart can
# still be detected.
MARK_DEG: Final = 0.004
# Timeout of a move: the planned duration times this factor, plus `Timeouts.stall_s`.
SLOW_FACTOR: Final = 1.5
# The run reports an event if the uncertainty of the motor angles during moves exceeds this angle, deg.
UNCERTAIN_DEG: Final = 1.0
# A message reports that a move takes longer if it has not ended this time, s, after its planned end.
SLOW_S: Final = 2.0
# Modal G-codes for all lines: millimetres (degrees for rotary axes), absolute positions. With inverse time
# feed (G93), GRBL refuses an axis word without a feed in the same line. Therefore a line from which the word
# G92 was lost does not move the motors.
SETUP: Final = "G21G90G93G1F1"
# Modes for the move: feed per minute (G94), and no motion mode (G80), so that GRBL refuses a move from which
# the word G1 was lost. This line is sent after the target is confirmed, because GRBL refuses G92 after G80.
MOVING: Final = "G94G80"
# Modal G-codes for grblHAL, without G80 and G93, because grblHAL refuses G43.1 after them.
SETUP_HAL: Final = "G21G90G94"
# Line that moves all axes to the work position zero. The zeros have a decimal point, so that a single damaged
# bit changes them by less than a degree. The command G1 is the last word of the line. If it were the first
# word and the letter X were lost, `G1X.0` would be read as `G1.0`, which moves only the other motors.
MOVE: Final = "{}.0{}.0{}.0G1"
FINAL: Final = "free the stand, bring its motors to zero, and run the program again"


class GrblDriver:
    """Runs a program with a GRBL controller on a serial port.

    The zero of the motors is the zero of the controller, or the position at the start with
    `Consent.start_here` or `Consent.home`. After the last step the motors return to zero, which unwinds the
    cables.

    port       name of the serial port
    baud       baud rate
    axes       axis letters of the three motors, outermost motor first
    consent    actions that the user permits at the start
    resume_hold  end a feed hold, or a hold after a safety door was closed, without waiting for the user
    resume     continue an interrupted run
    open_port  function that opens the serial port with a name and a baud rate; raises LinkLostError on
               failure
    """

    def __init__(
        self,
        program: Program,
        port: str,
        *,
        baud: int = 115200,
        axes: Axes | None = None,
        consent: Consent | None = None,
        resume_hold: bool = False,
        resume: Progress | None = None,
        timeouts: Timeouts | None = None,
        clock: Clock = SYSTEM_CLOCK,
        open_port: Callable[[str, int], Any] = serial_port,
    ) -> None:
        self._program, self._axes = _with_return(program), axes or Axes()
        self._last_step = len(program.steps) - 1
        self._timeouts = timeouts or Timeouts()
        self._consent, self._resume = consent or Consent(), resume
        self._clock = clock
        letters = self._axes.letters
        self._session = GrblSession(
            GrblPort(port, baud, open_port, clock), Parser(letters), self._timeouts, clock
        )
        self._pause = Pause(self._session, self._timeouts, clock, resumes=resume_hold)
        self._move_line = MOVE.format(*letters)
        self._blocks: list[Block] = blocks_of(self._program, MotorLimits())
        # Position that the controller reports at the zero of the stand, deg: angle = reported position -
        # zero.
        self.zero_deg: Triple = (0.0, 0.0, 0.0)
        self._ready: Ready | None = None
        self._track: Track | None = None
        # Offset of the work coordinates that the controller has confirmed, and a later reported offset that
        # contradicts it.
        self._offset_deg: Triple | None = None
        self._contradicting: Triple | None = None
        self._latest: Report | None = None
        self._done = 0
        self._recoveries = 0
        self._reconnect_until_s: float | None = None
        self._lost_reason = ""
        self._work: Waiting | None = None
        self._phase = "moving"
        self._failed: Status | None = None
        self._instants = Instants()
        self._events: list[Event] = []

    def start(self) -> None:
        """Open the port, check the controller, and read the motor limits and the position."""
        try:
            self._session.port.open()
            ready = self._wait_for(prepared(self._session, self._consent, self._blocks))
            self._ready = ready
            self._blocks = blocks_of(self._program, ready.limits)
            self._track = Track(ready.position_deg, max(ready.limits.max_rate_dps) * 3**0.5)
            self.zero_deg, self._done = self._start_from(ready.position_deg)
            self._say_uncertainty()
        except (LinkLostError, StoppedError, TroubleError) as error:
            self._session.port.close()
            raise ImucalError(f"the stand cannot be driven: {error}") from None
        except BaseException:
            self._session.port.close()
            raise
        self._work = self._program_steps()

    def poll(self) -> Status:
        """Process received lines, continue the program or a recovery, and return the state."""
        if self._failed is None and self._work is not None:
            try:
                self._require_reconnection()
                self._receive()
                if not self._pause.is_active():
                    next(self._work)
            except StopIteration:
                self._work = None
            except StoppedError as error:
                self._fail(error.code, f"{error.message}: {FINAL}")
            except LinkLostError as error:
                self._lost(str(error))
            self._events += self._pause.take_events()
            self._events += self._session.events
            self._session.events = []
        return self._status()

    def observe(self, samples: FloatArray) -> None:
        """Does nothing, because the controller reports the motor positions, so samples are not needed."""

    def positions(self) -> Sequence[Position]:
        """Motor angles reported since the last call, relative to the stand's zero."""
        is_over = self._work is None or self._failed is not None
        return self._instants.settled(math.inf if is_over else self._clock.now_s())

    def events(self) -> Sequence[Event]:
        """Events since the last call."""
        events, self._events = self._events, []
        return events

    def progress(self) -> Progress | None:
        """Number of completed steps, and the zero of the motors."""
        return Progress(min(self._done, self._last_step + 1), self.zero_deg)

    def close(self) -> None:
        """Stop the motors and close the port. A locked controller is left locked."""
        with suppress(LinkLostError, StoppedError):
            moves = self._work is not None and self._failed is None and self._session.port.is_open
            if moves and self._wait_for(self._session.halt()):
                self._session.port.send(RESET)
        self._session.port.close()

    def _wait_for(self, waiting: Waiting) -> Any:
        """Wait until an exchange with the controller has ended, without recording, and return its result."""
        while True:
            try:
                self._receive()
                next(waiting)
            except StopIteration as end:
                return end.value
            self._clock.sleep(PAUSE_S)

    def _status(self) -> Status:
        step = min(self._done, self._last_step)
        if self._failed is not None:
            return self._failed
        if self._work is None:
            return Status("finished", step)
        if self._pause.message:
            return Status("moving", step, message=self._pause.message)
        if self._done > self._last_step:
            return Status("moving", step, message="returning to zero")
        if self._phase == "holding":
            return Status("holding", step)
        return Status("moving", step, message="" if self._phase == "moving" else self._phase)

    def _start_from(self, position_deg: Triple) -> tuple[Triple, int]:
        """The zero of the motors, and the number of steps that are already completed, from their position."""
        if self._resume is None:
            require_zero(position_deg, self._consent)
            return ((0.0, 0.0, 0.0) if self._consent.unwind else position_deg), 0
        if self._consent.start_here or self._consent.home:
            # The motors are at zero. To reach the interrupted step, they repeat the moves of the completed
            # steps without holds between them.
            return position_deg, 0
        zero, step = self._resume.zero_deg, self._resume.steps_done
        poses = [(0.0, 0.0, 0.0), *(block.angles_deg for block in self._blocks)]
        track = Track(_sum(zero, poses[step]), RETURN_DPS)
        track.command(_sum(zero, poses[min(step + 1, len(poses) - 1)]), RETURN_DPS)
        if track.judge(position_deg, 0.0) != "accepted":
            raise ImucalError(
                f"the motors are at {_text(position_deg)} deg, not where the interrupted run has left them: "
                "the controller has restarted, or they were moved. Bring the motors to zero by hand, and "
                "give --start-here"
            )
        return zero, step

    def _say_uncertainty(self) -> None:
        """Warn if the unknown instants of the reported angles make the angles in moves uncertain."""
        half_s = (self._session.port.shortest_s or 0.0) / 2
        rate_dps = max((block.feed_dpm or 0.0 for block in self._blocks), default=0.0) / 60.0
        if half_s * rate_dps > UNCERTAIN_DEG:
            self._events.append(
                Event(
                    "angles_uncertain",
                    f"a report arrives {2e3 * half_s:.0f} ms after its query: if the delays of query and "
                    f"report differ, angles during moves are wrong by up to {half_s * rate_dps:.1f} deg at "
                    f"{rate_dps:.0f} deg/s",
                )
            )

    # --- received reports ---

    def _receive(self) -> None:
        for report in self._session.receive():
            self._latest = report
            if self._track is not None:
                self._check_offset(report)
                self._judge(report)

    def _judge(self, report: Report) -> None:
        """Record a plausible position. Three reports of an impossible position end the run."""
        position, track = report.position_deg, self._track
        if position is None or track is None or self._session.starting:
            return
        if self._session.is_late(report):
            return
        latest_s = self._session.latest_s(report)
        found = track.judge(position, latest_s)
        if found == "jumped":
            raise StoppedError(
                "position_lost",
                f"the reported position has jumped from {_text(track.last_deg)} to {_text(position)} deg, "
                "which is not possible: the controller has restarted",
            )
        if found == "elsewhere":
            self._phase = "elsewhere"
        if found != "accepted":
            return
        self._instants.add(latest_s, _difference(position, self.zero_deg), track.rate_dps)

    def _check_offset(self, report: Report) -> None:
        """Detect a restart of the controller by the loss of the confirmed offset.

        The welcome message of a restart may be lost.
        """
        if self._offset_deg is None or report.offset_deg is None:
            return
        if _near(report.offset_deg, self._offset_deg, SAME_DEG):
            self._contradicting = None
            return
        before, self._contradicting = self._contradicting, report.offset_deg
        if before == report.offset_deg:
            raise StoppedError(
                "position_lost",
                "the controller has lost its work offset, so it has restarted, and the position of the "
                "motors is not known",
            )

    # --- the program ---

    def _program_steps(self) -> Waiting:
        """Run all remaining steps. A step is repeated after a fault of the line."""
        if self._consent.unwind and self._done == 0:
            yield from self._recovered(lambda: self._reach((0.0, 0.0, 0.0), RETURN_DPS * 60.0, None))
        first = self._done
        if self._resume is not None and first < self._resume.steps_done:
            for block in self._blocks[: self._resume.steps_done]:
                yield from self._recovered(lambda b=block: self._reach(b.angles_deg, b.feed_dpm, b))  # type: ignore[misc]
            self._done = self._resume.steps_done
        while self._done < len(self._blocks):
            block = self._blocks[self._done]
            yield from self._recovered(lambda b=block: self._step(b))  # type: ignore[misc]
            self._done += 1

    def _recovered(self, work: Callable[[], Waiting]) -> Waiting:
        """Execute `work`. If a fault interrupts it, recover and execute it again."""
        self._recoveries = 0
        while True:
            try:
                yield from work()
            except TroubleError as trouble:
                yield from self._recover(trouble)
            else:
                return

    def _step(self, block: Block) -> Waiting:
        yield from self._reach(block.angles_deg, block.feed_dpm, block)
        self._phase = "holding"
        yield from self._hold(block)
        self._phase = "moving"

    def _reach(self, angles_deg: Sequence[float], feed_dpm: float | None, block: Block | None) -> Waiting:
        """Set and confirm the target, and move to it until the motors are reported at rest there."""
        self._phase = "moving"
        target = self._marked(_sum(self.zero_deg, angles_deg))
        is_hal = self._ready is not None and self._ready.is_hal
        yield from self._session.command(SETUP_HAL if is_hal else SETUP)
        yield from self._set_offset(target)
        if not is_hal:
            yield from self._session.command(MOVING)
        feed = feed_dpm or RETURN_DPS * 60.0
        for _ in range(MOST_MOVES):
            if self._rests_at(target):
                return
            # The feed has no decimal point, because the loss of a decimal point would multiply the rate.
            yield from self._session.command(f"F{max(round(feed), 1)}")
            assert self._track is not None
            self._track.command(target, feed / 60.0)
            duration_s = self._duration_s(target, feed)
            yield from self._session.command(self._move_line)
            yield from self._arrive(target, duration_s)
        if not self._rests_at(target):
            at = _text(self._track.last_deg) if self._track else ""
            raise TroubleError("wrong_pose", f"the motors are at rest at {at} deg in step {self._done + 1}")

    def _arrive(self, target: Triple, duration_s: float) -> Waiting:
        """Wait until the motors are at rest, at the target or elsewhere."""
        begun_s = self._session.now_s()
        has_moved = False
        while True:
            yield
            waited_s = self._session.now_s() - begun_s
            if self._phase == "elsewhere":
                assert self._track is not None
                at = _text(_difference(self._track.last_deg, self.zero_deg))
                raise TroubleError("wrong_pose", f"the motors are off the commanded path, at {at} deg")
            if self._rests_at(target):
                return
            report = self._latest
            is_idle = report is not None and report.state == "Idle"
            has_moved = has_moved or not is_idle
            if is_idle and waited_s > (self._timeouts.stall_s / 3 if has_moved else self._timeouts.stall_s):
                return
            if waited_s > duration_s + SLOW_S and self._phase == "moving":
                self._phase = "waiting for the end of a move that takes longer than planned"
            if waited_s > SLOW_FACTOR * duration_s + self._timeouts.stall_s:
                raise TroubleError(
                    "stalled", f"a move of {duration_s:.1f} s has not ended after {waited_s:.1f} s"
                )

    def _hold(self, block: Block) -> Waiting:
        """Wait until the reports have shown the motors at rest in the pose for the hold time."""
        assert self._track is not None
        target = self._track.target_deg
        since_s: float | None = None
        away_s: float | None = None
        while True:
            report = self._latest
            if report is not None and report.position_deg is not None:
                if report.state == "Idle" and _near(report.position_deg, target, AT_TARGET_DEG):
                    since_s = report.arrived_s if since_s is None else since_s
                    away_s = None
                    if report.arrived_s - since_s >= block.dwell_s:
                        return
                else:
                    away_s = report.arrived_s if away_s is None else away_s
                    if report.arrived_s - away_s > self._timeouts.stall_s / 3:
                        raise TroubleError(
                            "wrong_pose",
                            f"the motors have left the pose of step {self._done + 1} during its hold",
                        )
            yield

    def _set_offset(self, target: Triple) -> Waiting:
        """Make the target the origin of the work coordinates, and wait for the report that confirms it."""
        assert self._ready is not None and self._track is not None
        # If a report contradicts the previous offset, the report is damaged or the controller has restarted.
        # Further reports show which is the case.
        yield from self._session.until(lambda: self._contradicting is None, self._timeouts.boot_s)
        self._offset_deg = self._contradicting = None
        for _ in range(MOST_MOVES):
            # The argument of G92 is the present position in the new coordinates. The argument of G43.1 is
            # added to the offset at the start.
            code, words = (
                ("G43.10", _difference(target, self._ready.offset_deg))
                if self._ready.is_hal
                else ("G92", _difference(self._track.last_deg, target))
            )
            yield from self._session.command(f"{code}{self._axes.words(words)}")
            # Reports that arrived before the answer are not used, because they may confirm an earlier attempt
            # although the last attempt was damaged.
            self._session.offset_deg = None
            yield from self._session.until(
                lambda: (
                    self._session.offset_deg is not None and _near(self._session.offset_deg, target, SAME_DEG)
                )
            )
            if self._session.offset_deg is not None and _near(self._session.offset_deg, target, SAME_DEG):
                self._offset_deg = target
                return
        raise TroubleError("error", f"the controller does not confirm the target {_text(target)} deg")

    def _marked(self, target: Triple) -> Triple:
        """The target, displaced slightly if its offset equals the offset of a restarted controller."""
        assert self._ready is not None
        x, y, z = (round(angle, ANGLE_DECIMALS - 1) for angle in target)
        if _near((x, y, z), self._ready.offset_deg, MARK_DEG / 2) or not any((x, y, z)):
            x += MARK_DEG
        return (x, y, z)

    def _rests_at(self, target: Triple) -> bool:
        report = self._latest
        return (
            report is not None
            and report.state == "Idle"
            and report.position_deg is not None
            and _near(report.position_deg, target, AT_TARGET_DEG)
        )

    def _duration_s(self, target: Triple, feed_dpm: float) -> float:
        """Duration of the move from the last position, s."""
        assert self._ready is not None and self._track is not None
        turn = _difference(target, self._track.last_deg)
        if not any(turn):
            return 0.0
        length = sum(angle**2 for angle in turn) ** 0.5
        highest, acceleration = self._ready.limits.along(turn)
        rate = min(feed_dpm / 60.0, highest)
        return float(length / rate + rate / acceleration)

    # --- faults and recovery ---

    def _fail(self, code: str, message: str) -> None:
        self._failed = Status("failed", min(self._done, self._last_step), code, message)

    def _recover(self, fault: TroubleError) -> Waiting:
        """Stop the motors and reset the controller. Its position must survive the reset."""
        self._recoveries += 1
        self._events.append(Event(fault.code, fault.message))
        if self._recoveries > MOST_RECOVERIES:
            raise StoppedError(
                fault.code,
                f"{fault.message}; step {self._done + 1} is not done after {MOST_RECOVERIES} recoveries, "
                "check the controller, its cable and its supply",
            )
        self._phase = "recovering from a fault"
        yield from self._session.halt()
        yield from self._restart()
        self._events.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))

    def _restart(self) -> Waiting:
        """Reset the controller while no motor moves. It must keep its position and must not be locked."""
        assert self._track is not None
        self._offset_deg = self._contradicting = None
        yield from self._session.reset()
        self._track.command(self._track.last_deg, 0.0)
        idle = yield from self._session.until(
            lambda: self._session.report is not None and self._session.report.state == "Idle"
        )
        if not idle:
            state = self._session.report.state if self._session.report else "silent"
            raise StoppedError("alarm", f"the controller is locked after a reset (state {state})")
        # During this pause about three reports arrive, which show whether the position has survived the
        # reset.
        yield from self._session.pause(self._timeouts.answer_s / 4)

    def _lost(self, reason: str) -> None:
        """Close a lost or silent port and reconnect until `reconnect_s` has passed."""
        self._session.port.close()
        now_s = self._clock.now_s()
        if self._reconnect_until_s is None:
            self._reconnect_until_s = now_s + self._timeouts.reconnect_s
            self._events.append(Event("controller_lost", reason))
        self._lost_reason = reason
        self._pause.forget()
        self._phase = "reconnecting"
        self._work = self._reconnect()

    def _require_reconnection(self) -> None:
        """End the run if a lost port has not come back in time."""
        if self._reconnect_until_s is not None and self._clock.now_s() > self._reconnect_until_s:
            raise StoppedError(
                "controller_lost",
                f"{self._lost_reason}; no reconnection within {self._timeouts.reconnect_s:.0f} s: check "
                "cable and supply",
            )

    def _reconnect(self) -> Waiting:
        again_s = self._clock.now_s() + REOPEN_S
        while self._clock.now_s() < again_s:
            yield
        self._session.port.open()
        self._session.reported_s = self._clock.now_s()
        self._session.report = None
        if (yield from self._session.until(lambda: self._session.report is not None)):
            # The controller must report the confirmed offset again. A restarted controller has lost it.
            self._session.offset_deg = None
            yield from self._session.until(
                lambda: self._session.offset_deg is not None, self._timeouts.boot_s
            )
        else:
            yield from self._restart()
        self._reconnect_until_s = None
        self._events.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))
        yield from self._program_steps()


def _with_return(program: Program) -> Program:
    """The program with a final move back to its start."""
    x, y, z = (-sum(step.turn_deg[axis] for step in program.steps) for axis in range(3))
    back = Step((x, y, z), max(abs(x), abs(y), abs(z)) / RETURN_DPS, END_S)
    return Program((*program.steps, back), program.stand)


def _sum(a: Sequence[float], b: Sequence[float]) -> Triple:
    x, y, z = (first + second for first, second in zip(a, b, strict=True))
    return (x, y, z)


def _difference(a: Sequence[float], b: Sequence[float]) -> Triple:
    x, y, z = (first - second for first, second in zip(a, b, strict=True))
    return (x, y, z)


def _near(a: Sequence[float], b: Sequence[float], within_deg: float) -> bool:
    return all(abs(first - second) < within_deg for first, second in zip(a, b, strict=True))


def _text(angles: Sequence[float]) -> str:
    return ", ".join(f"{angle:.2f}" for angle in angles)
