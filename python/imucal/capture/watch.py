"""Faults of the data while they arrive: findings of the checks, shaking, and rotations that are too fast."""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.capture.events import Event, Kind
from imucal.capture.poses import angle_deg
from imucal.capture.sight import Sight
from imucal.finding import Finding
from imucal.recording.recording import Recording

__all__ = ["Watch"]

# Warnings of the checks that a person can act on while recording; all others wait for the calibration, which
# sees the whole recording. Errors are always said, except those below.
SAID_WARNINGS: Final = ("accel_saturation", "gyro_saturation", "samples_missing", "samples_duplicated")
# Findings that are said again when their count has grown; other errors are repeated after a while.
GROWING: Final = ("accel_saturation", "gyro_saturation", "samples_missing", "samples_duplicated")
REMINDED_S: Final = 20.0
# An axis counts as stuck only after this number of rests: before, it may not have been rotated yet.
RESTS_OF_STUCK: Final = 3
# Shortest time between two messages with the same code, s.
AGAIN_S: Final = 2.0
# The unit shakes if it is not still for this time, s, without being rotated.
SHAKES_S: Final = 1.5
# Share of the samples of that time that must have arrived to say so.
ENOUGH_SHARE: Final = 0.8
# Largest change of the vertical within that time, deg, for motion that is no rotation.
SHAKEN_DEG: Final = 10.0
# Largest ratio of the mean of the angular rate to its rms for motion that is no rotation.
SHAKEN_SHARE: Final = 0.35
# Angular rate above which a rotation is too fast, deg/s: the smallest range of common gyroscopes.
FAST_DPS: Final = 250.0
# Largest range of common gyroscopes is 2000 deg/s; a hand does not rotate a unit faster than this, deg/s.
LARGEST_DPS: Final = 2200.0
# Time over which the fastest rotation is searched, s.
RECENT_S: Final = 0.5
# The ends of a rest that goes on are not final within this time, s.
BLOCK_S: Final = 0.1
# At the beginning a wrong unit cannot be told from a fast rotation, s.
FIRST_S: Final = 1.5
# The largest reading of the gyroscope in a rotation must be at least this share of the mean rate of the
# vertical, of rotations with at least this mean rate, deg/s. The errors of a sensor are a few per cent.
LEAST_SHARE: Final = 0.5
LEAST_MEAN_DPS: Final = 15.0
# Mean rate of the vertical between two rests above which a rotation is too fast, deg/s. It serves gyroscopes
# in raw counts, whose scale is not known yet: a smooth rotation reaches twice its mean rate.
FAST_MEAN_DPS: Final = 150.0


class Watch:
    """Remembers what was said, so that each fault is said when it begins or goes on, and not all the time."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._said_s: dict[str, float] = {}
        self._rests_seen = 0
        self._forgets_gap = False

    def forget_gaps(self) -> None:
        """A gap that was made on purpose, by undo or by an interruption, is not said."""
        self._forgets_gap = True

    def look(self, sight: Sight, recording: Recording) -> list[Event]:
        """What is new since the last look."""
        events = self._findings(sight)
        if sight.current is None and self._shakes(sight, recording):
            events += self._say(sight.now_s, "refused", "shaking", SHAKING)
        events += self._rotation(sight, recording)
        self._rests_seen = len(sight.rests)
        return events

    def _say(self, now_s: float, kind: Kind, code: str, text: str, again_s: float = AGAIN_S) -> list[Event]:
        if now_s - self._said_s.get(code, -np.inf) < again_s:
            return []
        self._said_s[code] = now_s
        return [Event(now_s, kind, code, text)]

    def _findings(self, sight: Sight) -> list[Event]:
        events = []
        for finding in sight.findings:
            if not _is_said(finding, sight):
                continue
            code, before = finding.code, self._counts.get(finding.code, 0)
            self._counts[code] = finding.count
            if code == "samples_missing" and self._forgets_gap:
                self._forgets_gap = False
                continue
            if finding.severity == "error" and code not in GROWING:
                again_s = REMINDED_S
            elif finding.count > before:
                again_s = AGAIN_S
            else:
                continue
            events += self._say(sight.now_s, "warning", code, _text(finding, before), again_s)
        return events

    def _shakes(self, sight: Sight, recording: Recording) -> bool:
        """Whether the unit has not been still for a while although it is not rotated."""
        time_s = recording.time_s - recording.time_s[0]
        since_s = sight.rests[-1].end_s if sight.rests else 0.0
        if sight.now_s - since_s < SHAKES_S:
            return False
        first = int(np.searchsorted(time_s, sight.now_s - SHAKES_S))
        force = np.asarray(recording.specific_force, dtype=np.float64)[first:]
        if len(force) < ENOUGH_SHARE * SHAKES_S * recording.rate_hz:
            return False
        third = max(len(force) // 3, 1)
        if angle_deg(force[:third].mean(axis=0), force[-third:].mean(axis=0)) > SHAKEN_DEG:
            return False
        if recording.angular_rate is None:
            return True
        rate = np.asarray(recording.angular_rate, dtype=np.float64)[first:] - _bias(sight, recording, time_s)
        rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
        return float(np.linalg.norm(rate.mean(axis=0))) < SHAKEN_SHARE * rms

    def _rotation(self, sight: Sight, recording: Recording) -> list[Event]:
        """Rotations that are too fast, and those that the gyroscope does not measure as they were."""
        time_s = recording.time_s - recording.time_s[0]
        has_rate = recording.angular_rate is not None and recording.gyro_unit != "lsb"
        if has_rate:
            fastest = _fastest_dps(recording, time_s, sight.now_s - RECENT_S, sight.now_s)
            rest = sight.current
            at_rest = 0.0
            if rest is not None and rest.duration_s > RECENT_S:
                at_rest = _fastest_dps(recording, time_s, rest.start_s + BLOCK_S, rest.end_s - BLOCK_S)
            if fastest > LARGEST_DPS or at_rest > FAST_DPS:
                text = _units_text(max(fastest, at_rest), "much")
                return self._say(sight.now_s, "warning", "gyro_units", text, REMINDED_S)
            if fastest > FAST_DPS and sight.now_s > FIRST_S and "gyro_units" not in self._said_s:
                return self._say(sight.now_s, "warning", "too_fast", _fast_text(fastest))
        if len(sight.rests) <= max(self._rests_seen, 1):
            return []
        before, after = sight.rests[-2:]
        # The vertical cannot rotate faster than the unit.
        mean = angle_deg(before.up, after.up) / max(after.start_s - before.end_s, 1e-3)
        if has_rate:
            fastest = _fastest_dps(recording, time_s, before.end_s, after.start_s)
            if mean > LEAST_MEAN_DPS and fastest < LEAST_SHARE * mean:
                return self._say(
                    sight.now_s, "warning", "gyro_units", _units_text(fastest, "little"), REMINDED_S
                )
        elif recording.gyro_unit == "lsb" and mean > FAST_MEAN_DPS:
            return self._say(sight.now_s, "warning", "too_fast", _fast_text(2.0 * mean))
        return []


SHAKING: Final = (
    "the unit is not still: it trembles in place; rest your hand or the unit on a table, and hold it still"
)


def _is_said(finding: Finding, sight: Sight) -> bool:
    if finding.code == "stuck_axis" and len(sight.rests) < RESTS_OF_STUCK:
        return False
    return finding.severity == "error" or finding.code in SAID_WARNINGS


def _text(finding: Finding, before: int) -> str:
    if finding.code == "samples_missing":
        return (
            f"{finding.count - before} samples are missing: check the cable, the baud rate and the load of "
            "the computer; "
            f"{finding.count} in all"
        )
    if finding.code in ("accel_saturation", "gyro_saturation"):
        return (
            f"{' and '.join(finding.columns)} saturated at {finding.value:.4g} {finding.unit}, the end of "
            "the range: rotate "
            "more slowly, or choose a larger range; drop the pose (u), or this rotation is excluded"
        )
    return f"{finding.message}: {finding.way_out}"


def _fast_text(rate_dps: float) -> str:
    return (
        f"rotated too fast, at about {rate_dps:.0f} deg/s: many gyroscopes saturate at 250 deg/s; take one "
        "to two "
        "seconds for 90 deg"
    )


def _units_text(rate_dps: float, how: str) -> str:
    unit = "_dps" if how == "much" else "_radps"
    return (
        f"the gyroscope reads at most {rate_dps:.3g} deg/s, which is too {how} for this motion: check the "
        "unit in the "
        f"names of its columns, such as gyro_x{unit}"
    )


def _fastest_dps(recording: Recording, time_s: FloatArray, start_s: float, end_s: float) -> float:
    """Largest angular rate in an interval, deg/s."""
    first, end = np.searchsorted(time_s, [start_s, end_s + 1e-9])
    recent = np.asarray(recording.angular_rate)[first:end]
    return float(np.degrees(np.sqrt((recent**2).sum(axis=1).max()))) if len(recent) else 0.0


def _bias(sight: Sight, recording: Recording, time_s: FloatArray) -> FloatArray:
    """Mean reading of the gyroscope at the last rest; zero without one."""
    if not sight.rests:
        return np.zeros(3)
    first, end = np.searchsorted(time_s, [sight.rests[-1].start_s, sight.rests[-1].end_s + 1e-9])
    mean: FloatArray = np.asarray(recording.angular_rate, dtype=np.float64)[first : max(end, first + 1)].mean(
        axis=0
    )
    return mean
