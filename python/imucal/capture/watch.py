"""Detection of faults while data arrive: findings of the checks, shaking, and rotations that are too fast."""

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

# Codes of the warnings that are already reported during recording, because the person can react to them. All
# other warnings are reported by the calibration, which uses the whole recording. Errors are always reported,
# except `stuck_axis` before `RESTS_OF_STUCK` rests.
SAID_WARNINGS: Final = ("accel_saturation", "gyro_saturation", "samples_missing", "samples_duplicated")
# Codes of the findings that are reported again when the number of affected samples has grown. All other
# errors that persist are reported again at intervals of `REMINDED_S`, s.
GROWING: Final = ("accel_saturation", "gyro_saturation", "samples_missing", "samples_duplicated")
REMINDED_S: Final = 20.0
# Minimum number of rests before an axis can be reported as stuck. With fewer rests, the unit may not have
# been rotated about this axis yet.
RESTS_OF_STUCK: Final = 3
# Shortest time between two messages with the same code, s.
AGAIN_S: Final = 2.0
# The unit counts as shaking if it has been neither at rest nor rotated for this time, s.
SHAKES_S: Final = 1.5
# Minimum share of the expected samples of the last `SHAKES_S` that must have arrived for the unit to count as
# shaking.
ENOUGH_SHARE: Final = 0.8
# If the direction of gravity in the body frame changes by more than this angle during `SHAKES_S`, deg, the
# motion counts as a rotation and not as shaking.
SHAKEN_DEG: Final = 10.0
# If the magnitude of the mean angular rate, divided by the rms of the rate, exceeds this number, the motion
# counts as a rotation and not as shaking.
SHAKEN_SHARE: Final = 0.35
# An axis is reported as clipped at rest if at least this share of its samples in the last `SHAKES_S` equal
# its smallest or its largest value.
CLIPPED_SHARE: Final = 0.3
# An axis is not reported as clipped if, of its samples between its smallest and its largest value, more than
# this share equal the previous sample. The step of its converter then exceeds the noise, so that samples are
# equal without clipping.
EQUAL_SHARE: Final = 0.1
# A rotation is too fast above this angular rate, deg/s. It is the smallest measurement range of common
# gyroscopes.
FAST_DPS: Final = 250.0
# Angular rate, deg/s, above which the stated unit of measurement of the gyroscope data must be wrong. The
# largest range of common gyroscopes is 2000 deg/s, and no person rotates a gyroscope faster by hand.
LARGEST_DPS: Final = 2200.0
# Length of the last part of the recording in which the fastest rotation is searched, s.
RECENT_S: Final = 0.5
# Time at each end of a rest, s, that is not evaluated, because the end of a rest in progress may still
# change.
BLOCK_S: Final = 0.1
# Time after the first sample, s, during which a rest may not have been detected yet, so that a wrong unit of
# measurement cannot be distinguished from a fast rotation.
FIRST_S: Final = 1.5
# Between two rests, the direction of gravity rotates in the body frame. The accelerometer gives the mean rate
# of this rotation, and the largest gyroscope reading must be at least this rate, except for sensor errors of
# a few per cent. If the largest reading is below this share of the mean rate, the gyroscope data are in
# another unit than stated.
LEAST_SHARE: Final = 0.5
# Rotations with a smaller mean rate, deg/s, are not used to test the unit of measurement of the gyroscope.
LEAST_MEAN_DPS: Final = 15.0
# A rotation is too fast if the direction of gravity rotates faster than this mean rate, deg/s. This limit is
# used for gyroscopes in raw counts, whose scale is not known yet. The peak rate of a smooth rotation is twice
# its mean rate, here 300 deg/s.
FAST_MEAN_DPS: Final = 150.0


class Watch:
    """Reports each fault when it begins and at intervals while it continues, but not at each evaluation."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._said_s: dict[str, float] = {}
        self._rests_seen = 0
        self._forgets_gap = False
        # The message about an axis that was clipped at rest. A clipped axis has no noise, so the estimated
        # noise is too small, and rests in other poses look like shaking. This message is then repeated
        # instead of a message about shaking.
        self._clipped: str | None = None

    def forget_gaps(self) -> None:
        """Do not report the next gap in the samples, which an undo or an interruption has caused."""
        self._forgets_gap = True
        self._clipped = None

    def look(self, sight: Sight, recording: Recording) -> list[Event]:
        """Messages about faults that are new since the last evaluation."""
        events = self._findings(sight)
        is_shaking = sight.current is None and self._shakes(sight, recording)
        clipped = _clipped_at_rest(sight, recording) or (self._clipped if is_shaking else None)
        if clipped is not None:
            self._clipped = clipped
            events += self._say(sight.now_s, "warning", "accel_saturation", clipped, REMINDED_S)
        elif is_shaking:
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
        """Whether the unit has not been at rest for `SHAKES_S` although it is not rotated."""
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
        """Messages about rotations that are too fast, or that the gyroscope does not measure correctly."""
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
        # The mean rotation rate of the gravity direction is a lower bound of the peak rotation rate.
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
    "the unit is not at rest: it shakes without rotating; rest your hand or the unit on a table, and hold it "
    "still"
)


def _clipped_at_rest(sight: Sight, recording: Recording) -> str | None:
    """The message about an axis on which gravity exceeds the range, or None.

    The saturation check of the compiled library does not report such an axis, because it assumes a range
    above 1.3 g.
    """
    time_s = recording.time_s - recording.time_s[0]
    first = int(np.searchsorted(time_s, sight.now_s - SHAKES_S))
    force = np.asarray(recording.specific_force, dtype=np.float64)
    for axis, values in zip("xyz", force.T, strict=True):
        ends = (values.min(), values.max())
        at_end = max(ends, key=lambda end: int((values[first:] == end).sum()))
        if (values[first:] == at_end).mean() < CLIPPED_SHARE:
            continue
        inner = values[(values != ends[0]) & (values != ends[1])]
        if len(inner) > 1 and (np.diff(inner) == 0).mean() <= EQUAL_SHARE:
            unit = "counts" if recording.accel_unit == "lsb" else "m/s^2"
            return (
                f"accel_{axis} is clipped at {at_end:.4g} {unit} while gravity acts on it: the range of the "
                "accelerometer is too small, or its unit is wrong; choose a range of 2 g or more"
            )
    return None


def _is_said(finding: Finding, sight: Sight) -> bool:
    if finding.code == "stuck_axis" and len(sight.rests) < RESTS_OF_STUCK:
        return False
    return finding.severity == "error" or finding.code in SAID_WARNINGS


def _text(finding: Finding, before: int) -> str:
    if finding.code == "samples_missing":
        return (
            f"{finding.count - before} samples are missing: check the cable, the baud rate and the load of "
            f"the computer; {finding.count} in all"
        )
    if finding.code in ("accel_saturation", "gyro_saturation"):
        return (
            f"{' and '.join(finding.columns)} saturated at {finding.value:.4g} {finding.unit}, the end of "
            "the range: rotate "
            "more slowly, or choose a larger range; drop the pose (u), otherwise this rotation is not used"
        )
    return f"{finding.message}: {finding.way_out}"


def _fast_text(rate_dps: float) -> str:
    return (
        f"rotated too fast, at about {rate_dps:.0f} deg/s: many gyroscopes saturate at 250 deg/s; take one "
        "to two seconds for 90 deg"
    )


def _units_text(rate_dps: float, how: str) -> str:
    unit = "_dps" if how == "much" else "_radps"
    return (
        f"the gyroscope reads at most {rate_dps:.3g} deg/s, which is too {how} for this motion: check the "
        f"unit in the names of its columns, such as gyro_x{unit}"
    )


def _fastest_dps(recording: Recording, time_s: FloatArray, start_s: float, end_s: float) -> float:
    """Largest angular rate in an interval, deg/s."""
    first, end = np.searchsorted(time_s, [start_s, end_s + 1e-9])
    recent = np.asarray(recording.angular_rate)[first:end]
    return float(np.degrees(np.sqrt((recent**2).sum(axis=1).max()))) if len(recent) else 0.0


def _bias(sight: Sight, recording: Recording, time_s: FloatArray) -> FloatArray:
    """Mean reading of the gyroscope at the last rest; zero if there is no rest."""
    if not sight.rests:
        return np.zeros(3)
    first, end = np.searchsorted(time_s, [sight.rests[-1].start_s, sight.rests[-1].end_s + 1e-9])
    mean: FloatArray = np.asarray(recording.angular_rate, dtype=np.float64)[first : max(end, first + 1)].mean(
        axis=0
    )
    return mean
