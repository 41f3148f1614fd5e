"""One evaluation of a growing recording: its rests, whether the unit is at rest now, and findings.

Rests and findings are those of the compiled library, as in `imucal inspect` and `imucal calibrate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.finding import Finding
from imucal.recording.recording import Recording

__all__ = ["Held", "Sight", "look"]

# Minimum duration of a rest during recording, s. It is shorter than for a calibration, so that poses that
# were left too early or have just begun are detected.
LIVE_REST_S: Final = 0.3
# The unit counts as currently at rest if a rest ends at most this time before the last sample, s. The time
# allows for two details of rest detection: ends of rests have a resolution of 0.05 s, and a block of 0.05 s
# is removed from the end of each rest.
NOW_S: Final = 0.2
# Duration of the last part of the recording, from which the displayed steadiness of the unit is computed, s.
# The windows of rest detection have the same duration.
WINDOW_S: Final = 0.5


@dataclass(frozen=True, eq=False)
class Held:
    """A rest: times of its first and last sample, s, and the up direction in the body frame, (3,)."""

    start_s: float
    end_s: float
    up: FloatArray

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s


@dataclass(frozen=True, eq=False)
class Sight:
    """The state of the recording at its last sample.

    now_s       time of the last sample since the start, s
    rests       the rests in order of time
    current     the rest in progress, which is the last of `rests`, or None
    findings    findings of the checks
    steadiness  0 (moving) to 1 (steady enough to count as a rest)
    """

    now_s: float
    rests: Sequence[Held]
    current: Held | None
    findings: Sequence[Finding]
    steadiness: float


def look(recording: Recording, gravity_mps2: float) -> Sight:
    """Detect the rests of a recording, and check its data."""
    seen = _core.inspect(recording, gravity_mps2, LIVE_REST_S, grows=True)
    time_s = recording.time_s - recording.time_s[0]
    now_s = float(time_s[-1])
    force = _force(recording)
    rests = []
    for start_s, end_s, _ in seen.rests:
        first, end = np.searchsorted(recording.time_s, [start_s, end_s + 1e-9])
        up = force[first : max(end, first + 1)].mean(axis=0)
        size = float(np.linalg.norm(up))
        # A rest without gravity has no up direction and is skipped. The checks of the data report this fault.
        if size > 0 and np.isfinite(size):
            rests.append(Held(start_s - recording.time_s[0], end_s - recording.time_s[0], up / size))
    current = rests[-1] if rests and rests[-1].end_s >= now_s - NOW_S else None
    steadiness = _steadiness(recording, time_s, seen)
    return Sight(now_s, rests, current, (*recording.findings, *seen.findings), steadiness)


def _force(recording: Recording) -> FloatArray:
    """The specific force of a recording in its raw unit, (N, 3), as float64.

    Unsigned counts are shifted by half of their range, so that zero force is at zero.
    """
    force = np.asarray(recording.specific_force, dtype=np.float64)
    if recording.accel_unit == "lsb" and len(force) and np.nanmin(force) >= 0:
        bits = int(np.ceil(np.log2(np.nanmax(force) + 1.0)))
        force = force - 2.0 ** (bits - 1)
    return force


def _steadiness(recording: Recording, time_s: FloatArray, seen: _core.Inspection) -> float:
    """Square root of (threshold of the rest detection / statistic of the last window); at most 1.

    The statistic is the mean over the axes of (standard deviation in the window / noise at rest)^2.
    """
    if seen.threshold is None:
        return 0.0
    first = int(np.searchsorted(time_s, time_s[-1] - WINDOW_S))
    columns = [c for c in (recording.angular_rate, recording.specific_force) if c is not None]
    floor = np.array(seen.threshold["noise_floor"], dtype=np.float64)
    floor = floor[np.isfinite(floor)]
    spread = np.concatenate([np.asarray(c[first:], dtype=np.float64).std(axis=0) for c in columns])
    if len(spread) != len(floor) or not (floor > 0).all():
        return 0.0
    statistic = float(np.mean((spread / floor) ** 2))
    return float(min(1.0, np.sqrt(seen.threshold["factor"] / max(statistic, 1e-12))))
