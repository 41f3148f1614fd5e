"""One look at a recording that grows: its rests, whether the unit is still now, and findings.

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

# Shortest rest to see while recording, s. It is shorter than that of a calibration, so that a pose that is
# left too early, and a pose that has just begun, are seen.
LIVE_REST_S: Final = 0.3
# The unit is still now if a rest ends at most this time before the last sample, s: the ends of rests are
# found with a resolution of 0.05 s, and one block is trimmed.
NOW_S: Final = 0.2
# Window of the display of steadiness, s; that of the detection of rests.
WINDOW_S: Final = 0.5


@dataclass(frozen=True, eq=False)
class Held:
    """A rest: times of its first and last sample, s, and the unit vector up in the body, (3,)."""

    start_s: float
    end_s: float
    up: FloatArray

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s


@dataclass(frozen=True, eq=False)
class Sight:
    """The recording until now.

    now_s       time of the last sample since the start, s
    rests       the rests in order of time
    current     the rest that goes on now, which is the last of `rests`, or None
    findings    findings of the checks
    steadiness  0 (moving) to 1 (as steady as at the best rests)
    """

    now_s: float
    rests: Sequence[Held]
    current: Held | None
    findings: Sequence[Finding]
    steadiness: float


def look(recording: Recording, gravity_mps2: float) -> Sight:
    """Find the rests of a recording, and check it."""
    seen = _core.inspect(recording, gravity_mps2, LIVE_REST_S, grows=True)
    time_s = recording.time_s - recording.time_s[0]
    now_s = float(time_s[-1])
    force = _force(recording)
    rests = []
    for start_s, end_s, _ in seen.rests:
        first, end = np.searchsorted(recording.time_s, [start_s, end_s + 1e-9])
        up = force[first : max(end, first + 1)].mean(axis=0)
        size = float(np.linalg.norm(up))
        # Without gravity there is no direction; the checks say so.
        if size > 0 and np.isfinite(size):
            rests.append(Held(start_s - recording.time_s[0], end_s - recording.time_s[0], up / size))
    current = rests[-1] if rests and rests[-1].end_s >= now_s - NOW_S else None
    steadiness = _steadiness(recording, time_s, seen)
    return Sight(now_s, rests, current, (*recording.findings, *seen.findings), steadiness)


def _force(recording: Recording) -> FloatArray:
    """Specific force with zero at its centre, (N, 3): unsigned counts are centred at half of their range."""
    force = np.asarray(recording.specific_force, dtype=np.float64)
    if recording.accel_unit == "lsb" and len(force) and np.nanmin(force) >= 0:
        bits = int(np.ceil(np.log2(np.nanmax(force) + 1.0)))
        force = force - 2.0 ** (bits - 1)
    return force


def _steadiness(recording: Recording, time_s: FloatArray, seen: _core.Inspection) -> float:
    """Ratio of the standard deviation that a rest may have to that of the last window, at most 1."""
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
