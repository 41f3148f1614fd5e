"""Driver of a stand that a program of the user moves (docs/external-stand.md).

The program reads commands from its standard input and answers each with a line on its standard output:

    move A B C    ok                  starts to turn the motors to these angles, deg, without waiting
    position      position A B C      the angles of the motors now, deg
    stop          ok                  stops the motors

An answer `error TEXT` to any command ends the run. Text that the program writes to standard error is
shown to the user.
"""

from __future__ import annotations

import shlex
import subprocess
import threading
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ImucalError, InputError
from imucal.rig.motion import Program
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Event, Position, Progress, Status

__all__ = ["ExternalDriver"]

Triple = tuple[float, float, float]
Waiting = Generator[None, None, None]

# Interval between two queries of the position, s.
QUERY_S: Final = 0.04
# Timeout of an answer, s, and timeout of the first answer, s. The first answer may take longer, because the
# program has to start.
ANSWER_S: Final = 3.0
FIRST_S: Final = 15.0
# A pose counts as reached if each motor is within this angle of its target, deg. The angle is larger than the
# error of a hobby servo. The recorded angles do not depend on this limit, because the program reports the
# actual angles.
NEAR_DEG: Final = 1.0
# The motors count as stalled if none of them turns by more than `STILL_DEG` within `STALL_S` before the
# target is reached.
STILL_DEG: Final = 0.2
STALL_S: Final = 5.0
# Duration of the rest at zero after the last move, s.
END_S: Final = 0.3
# PAUSE_S is the pause between two polls during the start, s. STOP_S is the time, s, within which the program
# must end after the command `stop`. A program that has not ended by then is terminated.
PAUSE_S: Final = 0.01
STOP_S: Final = 2.0


class ExternalDriver:
    """Runs a motion program on a stand that a command of the user moves. All motors are at zero at the start.

    command     the command with its arguments, as typed in a shell; it is started without a shell
    start_here  use the position of the motors at the start as their zero
    unwind      move the motors to zero first
    """

    def __init__(
        self,
        program: Program,
        command: str,
        *,
        start_here: bool = False,
        unwind: bool = False,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        if start_here and unwind:
            raise InputError("--start-here and --unwind exclude each other: give one of them")
        self._words = shlex.split(command)
        if not self._words:
            raise InputError(
                "the command of the stand is empty: give --command, such as 'python my_stand.py'"
            )
        sums = np.cumsum([step.turn_deg for step in program.steps], axis=0)
        self._poses: list[Triple] = [(x, y, z) for x, y, z in sums.tolist()]
        self._holds_s = [step.hold_s for step in program.steps]
        self._start_here, self._unwind, self._clock = start_here, unwind, clock
        self._zero: Triple = (0.0, 0.0, 0.0)
        self._process: subprocess.Popen[str] | None = None
        # Host time of arrival, s, and text of the answers.
        self._lines: deque[tuple[float, str]] = deque()
        self._answers: deque[str] = deque()
        self._asked_s: float | None = None
        self._queried_s = self._heard_s = 0.0
        self._angles: Triple | None = None
        self._read_s = 0.0
        self._done = 0
        self._phase = "moving"
        self._work: Waiting | None = None
        self._failed: Status | None = None
        self._readings: list[Position] = []

    def start(self) -> None:
        """Start the command and read the position."""
        try:
            self._process = subprocess.Popen(
                self._words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
            )
        except OSError as error:
            raise ImucalError(f"{self._words[0]} cannot be started: {error.strerror}") from None
        threading.Thread(target=self._listen, daemon=True).start()
        self._heard_s = self._clock.now_s() + FIRST_S - ANSWER_S
        while self._angles is None and self._failed is None:
            self._receive()
            self._clock.sleep(PAUSE_S)
        if self._failed is None and self._angles is not None and not self._is_near(self._angles, self._zero):
            if self._start_here:
                self._zero = self._angles
            elif not self._unwind:
                at = ", ".join(f"{angle:.1f}" for angle in self._angles)
                self._fail(
                    "not_at_zero",
                    f"the motors are not at zero but at {at} deg: give --unwind to turn them back to zero "
                    "first, or --start-here if this position is the zero and no cable is wound",
                )
        if self._failed is not None:
            message = self._failed.message
            self.close()
            raise ImucalError(f"the stand cannot be driven: {message}")
        self._readings = []
        self._work = self._steps()

    def poll(self) -> Status:
        """Process answers, query the position, and continue the motion program."""
        if self._failed is None and self._work is not None:
            self._receive()
            if self._failed is None:
                try:
                    next(self._work)
                except StopIteration:
                    self._work = None
        step = min(self._done, len(self._poses) - 1)
        if self._failed is not None:
            return self._failed
        if self._work is None:
            return Status("finished", step)
        return Status("holding" if self._phase == "holding" else "moving", step, message=self._phase)

    def observe(self, samples: FloatArray) -> None:
        """Does nothing, because the stand's program reports the motor angles."""

    def positions(self) -> Sequence[Position]:
        """Motor angles reported since the last call, at the instants halfway between query and answer."""
        readings, self._readings = self._readings, []
        return readings

    def events(self) -> Sequence[Event]:
        """Empty, because every fault ends the run."""
        return ()

    def progress(self) -> Progress | None:
        """None, because the run cannot be resumed."""
        return None

    def close(self) -> None:
        """Stop the motors and end the command."""
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(OSError, ValueError):
            if process.stdin is not None:
                process.stdin.write("stop\n")
                process.stdin.close()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.terminate()

    def _listen(self) -> None:
        process = self._process
        if process is None or process.stdout is None:
            return
        with suppress(OSError, ValueError):
            for line in process.stdout:
                self._lines.append((self._clock.now_s(), line.strip()))

    def _send(self, command: str) -> None:
        try:
            if self._process is not None and self._process.stdin is not None:
                self._process.stdin.write(f"{command}\n")
                self._process.stdin.flush()
        except (OSError, ValueError):
            code = None if self._process is None else self._process.poll()
            self._fail("stand_exited", f"{self._words[0]} has ended, exit code {code}")

    def _receive(self) -> None:
        """Read the answers, and query the position when the last query is answered."""
        now_s = self._clock.now_s()
        while self._lines:
            at_s, line = self._lines.popleft()
            self._heard_s = max(self._heard_s, at_s)
            word, _, rest = line.partition(" ")
            if word == "error":
                self._fail("stand_error", f"{self._words[0]} reports: {rest or 'an error without a text'}")
            elif word == "position":
                self._take_position(rest, at_s)
            elif line:
                self._answers.append(line)
        if self._process is not None and self._process.poll() is not None and not self._lines:
            self._fail("stand_exited", f"{self._words[0]} has ended, exit code {self._process.returncode}")
        elif now_s - self._heard_s > ANSWER_S:
            self._fail(
                "stand_silent",
                f"{self._words[0]} has not answered for {now_s - self._heard_s:.0f} s: does it flush its "
                "output?",
            )
        elif self._asked_s is None and now_s - self._queried_s >= QUERY_S:
            self._asked_s = self._queried_s = now_s
            self._send("position")

    def _take_position(self, text: str, at_s: float) -> None:
        try:
            x, y, z = (float(number) for number in text.split())
        except ValueError:
            self._fail("stand_error", f"{self._words[0]} answers `position {text}`: three angles are needed")
            return
        if not np.isfinite([x, y, z]).all():
            self._fail(
                "stand_error", f"{self._words[0]} answers `position {text}`: the angles are not finite"
            )
            return
        asked_s, self._asked_s = self._asked_s, None
        self._angles, self._read_s = (x, y, z), at_s if asked_s is None else (asked_s + at_s) / 2
        a, b, c = (angle - zero for angle, zero in zip(self._angles, self._zero, strict=True))
        self._readings.append((self._read_s, a, b, c))

    def _steps(self) -> Waiting:
        if self._unwind:
            yield from self._reach((0.0, 0.0, 0.0))
        for pose, hold_s in zip(self._poses, self._holds_s, strict=True):
            yield from self._reach(pose)
            yield from self._hold(pose, hold_s)
            self._done += 1
        self._phase = "returning to zero"
        yield from self._reach((0.0, 0.0, 0.0))
        yield from self._hold((0.0, 0.0, 0.0), END_S)

    def _reach(self, pose: Triple) -> Waiting:
        target = self._target(pose)
        self._phase = "moving"
        self._answers.clear()
        self._send("move " + " ".join(f"{angle:.4f}" for angle in target))
        asked_s = self._clock.now_s()
        while not self._answers:
            if self._clock.now_s() - asked_s > ANSWER_S:
                self._fail("stand_silent", f"{self._words[0]} does not answer to move")
                return
            yield
        if self._answers[0] != "ok":
            self._fail("stand_error", f"{self._words[0]} answers {self._answers[0]!r} to move: ok is needed")
            return
        before, since_s = self._angles, self._clock.now_s()
        while self._angles is None or not self._is_near(self._angles, target):
            if before is None or (self._angles and not self._is_near(self._angles, before, STILL_DEG)):
                before, since_s = self._angles, self._clock.now_s()
            if self._clock.now_s() - since_s > STALL_S:
                at = ", ".join(f"{angle:.1f}" for angle in self._angles or ())
                self._fail("stalled", f"the motors have stopped at {at} deg, short of step {self._done + 1}")
                return
            yield

    def _hold(self, pose: Triple, hold_s: float) -> Waiting:
        """Wait until all angles reported during the hold time are those of the pose and do not change."""
        target, since_s, first = self._target(pose), self._read_s, self._angles
        self._phase = "holding"
        while self._read_s - since_s < hold_s:
            yield
            if self._angles is None or first is None or not self._is_near(self._angles, target):
                yield from self._reach(pose)
                since_s, first = self._read_s, self._angles
                self._phase = "holding"
            elif not self._is_near(self._angles, first, STILL_DEG):
                # The angles still change, so the hold time starts again.
                since_s, first = self._read_s, self._angles
            if self._failed is not None:
                return

    def _target(self, pose: Triple) -> Triple:
        x, y, z = (angle + zero for angle, zero in zip(pose, self._zero, strict=True))
        return (x, y, z)

    def _is_near(self, a: Triple, b: Triple, within_deg: float = NEAR_DEG) -> bool:
        return all(abs(first - second) <= within_deg for first, second in zip(a, b, strict=True))

    def _fail(self, code: str, message: str) -> None:
        if self._failed is None:
            self._failed = Status("failed", min(self._done, len(self._poses) - 1), code, message)
