"""Motors of a stand under a GRBL controller: their reported position, and moves to confirmed targets.

For each move the origin of the work coordinates is set to the target by `G92`. With grblHAL it is set by
`G43.1`, because grblHAL keeps the offset of G92 over a restart, so that the restart would not be detected.
When a report has confirmed this offset, a move to 0, 0, 0 is commanded. A move has ended when reports show
the motors at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from imucal.stand.gcode import ANGLE_DECIMALS, Axes
from imucal.stand.grbl_report import Report, Triple
from imucal.stand.grbl_session import GrblSession, StoppedError, TroubleError, Waiting
from imucal.stand.grbl_start import Ready
from imucal.stand.grbl_times import Instants
from imucal.stand.grbl_track import Track

__all__ = ["RETURN_DPS", "Motors", "sum_of", "text_of"]

# Rate at which the motors return to zero, deg/s.
RETURN_DPS: Final = 60.0
# Maximum number of attempts to set a target, and to reach it. If all attempts fail, the controller is reset
# and the step is repeated.
MOST_MOVES: Final = 4
# A motor is at its target if it deviates by at most this angle, deg. Reports have a resolution of 0.001 deg.
AT_TARGET_DEG: Final = 0.02
# A reported offset of the work coordinates counts as equal to the requested offset if they differ by at most
# this angle, deg. It allows for half a unit of the last digit of a report, and for rounding.
SAME_DEG: Final = 0.0015
# A restart of the controller sets the offset of the work coordinates to a known value, by which the restart
# is detected. A target whose offset equals this value is displaced by this angle, deg, so that a restart can
# still be detected.
MARK_DEG: Final = 0.004
# Timeout of a move: the planned duration times this factor, plus `Timeouts.stall_s`.
SLOW_FACTOR: Final = 1.5
# The status says that a move takes longer than planned if the move has not ended this time, s, after its
# planned end.
SLOW_S: Final = 2.0
# Modal G-codes for all lines: millimetres (degrees for rotary axes), absolute positions. With inverse time
# feed (G93), GRBL refuses an axis word without a feed in the same line. A line with G92 has no feed. If
# the word G92 is lost, GRBL therefore refuses the rest of the line, which would otherwise be a move.
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


class Motors:
    """The motors of a controller that is ready.

    zero_deg  position that the controller reports at the zero of the stand: angle = reported position - zero
    instants  object that receives the reported angles and corrects their instants
    phase     current activity of the motors in words, such as moving or holding
    """

    def __init__(
        self, session: GrblSession, axes: Axes, ready: Ready, zero_deg: Triple, instants: Instants
    ) -> None:
        self._session, self._axes, self._ready = session, axes, ready
        self._zero_deg, self._instants = zero_deg, instants
        self._timeouts = session.timeouts
        self._move_line = MOVE.format(*axes.letters)
        self._track = Track(ready.position_deg, max(ready.limits.max_rate_dps) * 3**0.5)
        self._latest: Report | None = session.report
        # Offset of the work coordinates that the controller has confirmed, and a later reported offset that
        # contradicts it.
        self._offset_deg: Triple | None = None
        self._contradicting: Triple | None = None
        self.phase = "moving"

    # --- reports ---

    def take(self, report: Report) -> None:
        """Take a status report of the controller. Raises StoppedError if the position is lost."""
        self._latest = report
        self._check_offset(report)
        self._judge(report)

    def restart(self) -> Waiting:
        """Reset the controller while no motor moves. It must keep its position and must not be locked."""
        self._offset_deg = self._contradicting = None
        yield from self._session.reset()
        self._track.command(self._track.last_deg, 0.0)
        idle = yield from self._session.until(
            lambda: self._session.report is not None and self._session.report.state == "Idle"
        )
        if not idle:
            state = self._session.report.state if self._session.report else "silent"
            raise StoppedError("alarm", f"the controller is locked after a reset (state {state})")
        # During this pause about ten reports arrive. Three reports that agree show whether the position has
        # survived the reset (`Track`).
        yield from self._session.pause(self._timeouts.answer_s / 4)

    def _judge(self, report: Report) -> None:
        """Record a plausible position. Three reports of an impossible position end the run."""
        position, track = report.position_deg, self._track
        if position is None or self._session.starting or self._session.is_late(report):
            return
        latest_s = self._session.latest_s(report)
        found = track.judge(position, latest_s)
        if found == "jumped":
            raise StoppedError(
                "position_lost",
                f"the reported position has jumped from {text_of(track.last_deg)} to "
                f"{text_of(position)} deg, which is not possible: the controller has restarted",
            )
        if found == "elsewhere":
            self.phase = "elsewhere"
        if found != "accepted":
            return
        self._instants.add(latest_s, _difference(position, self._zero_deg), track.rate_dps)

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

    # --- moves ---

    def reach(self, angles_deg: Sequence[float], feed_dpm: float | None, step: int) -> Waiting:
        """Set and confirm the target, and move to it until the motors are reported at rest there.

        feed_dpm  feed along the combined rotation, deg/min; None for `RETURN_DPS`
        step      number of the step, for messages
        """
        self.phase = "moving"
        target = self._marked(sum_of(self._zero_deg, angles_deg))
        yield from self._session.command(SETUP_HAL if self._ready.is_hal else SETUP)
        yield from self._set_offset(target)
        if not self._ready.is_hal:
            yield from self._session.command(MOVING)
        feed = feed_dpm or RETURN_DPS * 60.0
        for _ in range(MOST_MOVES):
            if self._rests_at(target):
                return
            # The feed has no decimal point, because the loss of a decimal point would multiply the rate.
            yield from self._session.command(f"F{max(round(feed), 1)}")
            self._track.command(target, feed / 60.0)
            duration_s = self._duration_s(target, feed)
            yield from self._session.command(self._move_line)
            yield from self._arrive(target, duration_s)
        if not self._rests_at(target):
            at = text_of(self._track.last_deg)
            raise TroubleError("wrong_pose", f"the motors are at rest at {at} deg in step {step}")

    def _arrive(self, target: Triple, duration_s: float) -> Waiting:
        """Wait until the motors are at rest, at the target or elsewhere."""
        begun_s = self._session.now_s()
        has_moved = False
        while True:
            yield
            waited_s = self._session.now_s() - begun_s
            if self.phase == "elsewhere":
                at = text_of(_difference(self._track.last_deg, self._zero_deg))
                raise TroubleError("wrong_pose", f"the motors are off the commanded path, at {at} deg")
            if self._rests_at(target):
                return
            report = self._latest
            is_idle = report is not None and report.state == "Idle"
            has_moved = has_moved or not is_idle
            if is_idle and waited_s > (self._timeouts.stall_s / 3 if has_moved else self._timeouts.stall_s):
                return
            if waited_s > duration_s + SLOW_S and self.phase == "moving":
                self.phase = "waiting for the end of a move that takes longer than planned"
            if waited_s > SLOW_FACTOR * duration_s + self._timeouts.stall_s:
                raise TroubleError(
                    "stalled", f"a move of {duration_s:.1f} s has not ended after {waited_s:.1f} s"
                )

    def hold(self, dwell_s: float, step: int) -> Waiting:
        """Wait until the reports have shown the motors at rest in the pose for the time `dwell_s`."""
        target = self._track.target_deg
        since_s: float | None = None
        away_s: float | None = None
        while True:
            report = self._latest
            if report is not None and report.position_deg is not None:
                if report.state == "Idle" and _near(report.position_deg, target, AT_TARGET_DEG):
                    since_s = report.arrived_s if since_s is None else since_s
                    away_s = None
                    if report.arrived_s - since_s >= dwell_s:
                        return
                else:
                    away_s = report.arrived_s if away_s is None else away_s
                    if report.arrived_s - away_s > self._timeouts.stall_s / 3:
                        raise TroubleError(
                            "wrong_pose",
                            f"the motors have left the pose of step {step} during its hold",
                        )
            yield

    def _set_offset(self, target: Triple) -> Waiting:
        """Make the target the origin of the work coordinates, and wait for the report that confirms it."""
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
        raise TroubleError("error", f"the controller does not confirm the target {text_of(target)} deg")

    def _marked(self, target: Triple) -> Triple:
        """The target, displaced slightly if its offset equals the offset of a restarted controller."""
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
        turn = _difference(target, self._track.last_deg)
        if not any(turn):
            return 0.0
        length = sum(angle**2 for angle in turn) ** 0.5
        highest, acceleration = self._ready.limits.along(turn)
        rate = min(feed_dpm / 60.0, highest)
        return float(length / rate + rate / acceleration)


def sum_of(a: Sequence[float], b: Sequence[float]) -> Triple:
    """The angles `a` plus the angles `b`, for each of the three motors."""
    x, y, z = (first + second for first, second in zip(a, b, strict=True))
    return (x, y, z)


def _difference(a: Sequence[float], b: Sequence[float]) -> Triple:
    x, y, z = (first - second for first, second in zip(a, b, strict=True))
    return (x, y, z)


def _near(a: Sequence[float], b: Sequence[float], within_deg: float) -> bool:
    return all(abs(first - second) < within_deg for first, second in zip(a, b, strict=True))


def text_of(angles: Sequence[float]) -> str:
    """Three angles as text, in the unit of the angles."""
    return ", ".join(f"{angle:.2f}" for angle in angles)
