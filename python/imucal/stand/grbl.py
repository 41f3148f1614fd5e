"""Driver of a stand whose motors are controlled by GRBL 1.1 or grblHAL (docs/stand.md).

The motors never move to a target that the controller might have misread. For each step the driver sets the
origin of the work coordinates to the target, waits until a report confirms this offset, and then commands a
move to 0, 0, 0 (grbl_motors.py). If a byte is lost on the serial line, the move can fail or be too short, but
the motors cannot move past the target. The confirmed offset also proves that the controller has not
restarted, because a restart clears the offset.

A step is complete when its pose has been reported at rest for the hold time of the step. After a
communication fault (a refused command, a lost cable, a silent controller) the step is repeated from the
reported position. An alarm, a locked controller or a lost position ends the run: the stand is not moved again
without the user.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Final

from imucal.arrays import FloatArray
from imucal.errors import ImucalError
from imucal.rig.motion import Program, Step
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Event, Position, Progress, Status
from imucal.stand.gcode import Axes, Block, MotorLimits, blocks_of
from imucal.stand.grbl_motors import RETURN_DPS, Motors, sum_of, text_of
from imucal.stand.grbl_pause import Pause
from imucal.stand.grbl_port import RESET, GrblPort
from imucal.stand.grbl_report import Parser, Triple
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
# Duration of the rest at the zero angles after the last move, s. The controller reports the last motor angles
# of this move during the rest.
END_S: Final = 0.3
# The run fails after this number of consecutive recoveries from faults without a completed step.
MOST_RECOVERIES: Final = 4
# The run reports an event if the uncertainty of the motor angles during moves exceeds this angle, deg.
UNCERTAIN_DEG: Final = 1.0
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
    resume_hold  whether to end a feed hold, or the hold after a safety door was closed, without waiting for
               the user
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
        self._session = GrblSession(
            GrblPort(port, baud, open_port, clock), Parser(self._axes.letters), self._timeouts, clock
        )
        self._pause = Pause(self._session, self._timeouts, clock, resumes=resume_hold)
        self._blocks: list[Block] = blocks_of(self._program, MotorLimits())
        # Position that the controller reports at the zero of the stand, deg: angle = reported position -
        # zero.
        self.zero_deg: Triple = (0.0, 0.0, 0.0)
        self._motors: Motors | None = None
        self._done = 0
        self._recoveries = 0
        self._reconnect_until_s: float | None = None
        self._lost_reason = ""
        self._work: Waiting | None = None
        self._failed: Status | None = None
        self._instants = Instants()
        self._events: list[Event] = []

    def start(self) -> None:
        """Open the port, check the controller, and read the motor limits and the position."""
        try:
            self._session.port.open()
            ready: Ready = self._wait_for(prepared(self._session, self._consent, self._blocks))
            self._blocks = blocks_of(self._program, ready.limits)
            self.zero_deg, self._done = self._start_from(ready.position_deg)
            motors = Motors(self._session, self._axes, ready, self.zero_deg, self._instants)
            self._say_uncertainty()
        except (LinkLostError, StoppedError, TroubleError) as error:
            self._session.port.close()
            raise ImucalError(f"the stand cannot be driven: {error}") from None
        except BaseException:
            self._session.port.close()
            raise
        self._motors, self._work = motors, self._program_steps(motors)

    def poll(self) -> Status:
        """Process received lines, continue the program or a recovery, and return the state."""
        motors = self._motors
        if self._failed is None and self._work is not None and motors is not None:
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
                self._lost(motors, str(error))
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
        """Block until an exchange with the controller has ended, and return its result.

        Meanwhile no samples of the unit are recorded.
        """
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
        phase = "moving" if self._motors is None else self._motors.phase
        if phase == "holding":
            return Status("holding", step)
        return Status("moving", step, message="" if phase == "moving" else phase)

    def _start_from(self, position_deg: Triple) -> tuple[Triple, int]:
        """The zero of the motors and the number of completed steps, given the position of the motors."""
        if self._resume is None:
            require_zero(position_deg, self._consent)
            return ((0.0, 0.0, 0.0) if self._consent.unwind else position_deg), 0
        if self._consent.start_here or self._consent.home:
            # The motors are at zero. To reach the interrupted step, they repeat the moves of the completed
            # steps without holds between them.
            return position_deg, 0
        zero, step = self._resume.zero_deg, self._resume.steps_done
        poses = [(0.0, 0.0, 0.0), *(block.angles_deg for block in self._blocks)]
        track = Track(sum_of(zero, poses[step]), RETURN_DPS)
        track.command(sum_of(zero, poses[min(step + 1, len(poses) - 1)]), RETURN_DPS)
        if track.judge(position_deg, 0.0) != "accepted":
            raise ImucalError(
                f"the motors are at {text_of(position_deg)} deg, not where the interrupted run has left "
                "them: the controller has restarted, or they were moved. Bring the motors to zero by hand, "
                "and give --start-here"
            )
        return zero, step

    def _say_uncertainty(self) -> None:
        """Warn if the error of the motor angles during moves can exceed `UNCERTAIN_DEG`.

        Only the sum of the delays of a query and of its report is measured, and half of this sum is
        attributed to each delay. If the two delays differ, the angles are assigned to wrong instants.
        """
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

    # --- the program ---

    def _receive(self) -> None:
        for report in self._session.receive():
            if self._motors is not None:
                self._motors.take(report)

    def _program_steps(self, motors: Motors) -> Waiting:
        """Run all remaining steps. A step is repeated after a communication fault."""

        def reach(angles_deg: Sequence[float], feed_dpm: float | None = None) -> Waiting:
            yield from motors.reach(angles_deg, feed_dpm, self._done + 1)

        if self._consent.unwind and self._done == 0:
            yield from self._recovered(motors, lambda: reach((0.0, 0.0, 0.0)))
        first = self._done
        if self._resume is not None and first < self._resume.steps_done:
            for block in self._blocks[: self._resume.steps_done]:
                yield from self._recovered(motors, partial(reach, block.angles_deg, block.feed_dpm))
            self._done = self._resume.steps_done
        while self._done < len(self._blocks):
            yield from self._recovered(motors, partial(self._step, motors, self._blocks[self._done]))
            self._done += 1

    def _step(self, motors: Motors, block: Block) -> Waiting:
        yield from motors.reach(block.angles_deg, block.feed_dpm, self._done + 1)
        motors.phase = "holding"
        yield from motors.hold(block.dwell_s, self._done + 1)
        motors.phase = "moving"

    def _recovered(self, motors: Motors, work: Callable[[], Waiting]) -> Waiting:
        """Execute `work`. If a fault interrupts it, recover and execute it again."""
        self._recoveries = 0
        while True:
            try:
                yield from work()
            except TroubleError as trouble:
                yield from self._recover(motors, trouble)
            else:
                return

    # --- faults and recovery ---

    def _fail(self, code: str, message: str) -> None:
        self._failed = Status("failed", min(self._done, self._last_step), code, message)

    def _recover(self, motors: Motors, fault: TroubleError) -> Waiting:
        """Stop the motors and reset the controller. The run ends if the controller loses its position."""
        self._recoveries += 1
        self._events.append(Event(fault.code, fault.message))
        if self._recoveries > MOST_RECOVERIES:
            raise StoppedError(
                fault.code,
                f"{fault.message}; step {self._done + 1} is not done after {MOST_RECOVERIES} recoveries, "
                "check the controller, its cable and its supply",
            )
        motors.phase = "recovering from a fault"
        yield from self._session.halt()
        yield from motors.restart()
        self._events.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))

    def _lost(self, motors: Motors, reason: str) -> None:
        """Close a lost or silent port, and try to reconnect until `reconnect_s` has passed."""
        self._session.port.close()
        now_s = self._clock.now_s()
        if self._reconnect_until_s is None:
            self._reconnect_until_s = now_s + self._timeouts.reconnect_s
            self._events.append(Event("controller_lost", reason))
        self._lost_reason = reason
        self._pause.forget()
        motors.phase = "reconnecting"
        self._work = self._reconnect(motors)

    def _require_reconnection(self) -> None:
        """End the run if a lost port has not come back in time."""
        if self._reconnect_until_s is not None and self._clock.now_s() > self._reconnect_until_s:
            raise StoppedError(
                "controller_lost",
                f"{self._lost_reason}; no reconnection within {self._timeouts.reconnect_s:.0f} s: check "
                "cable and supply",
            )

    def _reconnect(self, motors: Motors) -> Waiting:
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
            yield from motors.restart()
        self._reconnect_until_s = None
        self._events.append(Event("resumed", f"with step {self._done + 1} of {len(self._blocks)}"))
        yield from self._program_steps(motors)


def _with_return(program: Program) -> Program:
    """The program with a final move back to its start."""
    x, y, z = (-sum(step.turn_deg[axis] for step in program.steps) for axis in range(3))
    back = Step((x, y, z), max(abs(x), abs(y), abs(z)) / RETURN_DPS, END_S)
    return Program((*program.steps, back), program.stand)
