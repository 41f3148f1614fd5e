"""Joins the clocks of the unit and of the host, and interpolates motor angles to the instants of the samples.

Samples arrive with varying delays, but never early. Each sample is a point (unit time, host time of arrival).
Of all straight lines that lie below the points, the one with the smallest sum of distances to the points
gives the relation between the clocks. This line is an edge of the lower convex hull of the points. Samples
that were delayed at the start or while the computer was busy lie above the line and do not change it.
"""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.stand.journal import Logged
from imucal.stand.stream import TICKS_PER_S

__all__ = ["host_instants", "joined_angles"]

# Largest relative difference between the rates of the unit's clock and the host's clock that is accepted
# without a check. Quartz oscillators differ by less than 200 ppm.
MAX_SLOPE: Final = 500e-6
# A rate difference beyond `MAX_SLOPE` is accepted if both halves of the run confirm it: the rate difference
# in each half is also beyond `MAX_SLOPE`, and deviates from the rate difference over the whole run by at most
# this number. Such large rate differences occur if the clock of the unit is an RC oscillator, or if the unit
# sends no time and does not sample at its nominal rate.
AGREEING_SLOPE: Final = 2e-3
# Minimum duration of a run, s, for a rate difference beyond `MAX_SLOPE` to be accepted. In a shorter run the
# varying delays of the samples make the rate difference too uncertain.
SLOPE_OVER_S: Final = 20.0
# Maximum number of samples from which the rate difference is computed. If a run has more samples, they are
# divided into blocks, and only the least delayed sample of each block is used.
MOST_POINTS: Final = 20_000
# Longest interval between two reported positions, s, over which the angles of a moving stand are
# interpolated. At an acceleration of 500 deg/s^2 the interpolation error is 0.6 deg.
LONGEST_S: Final = 0.1
# The angles are also interpolated over an interval of up to `LONGER_S`, s, in which they change by at most
# `LITTLE_DEG`, deg. For a constant acceleration over the whole interval, the interpolation error is at most a
# quarter of this change.
LONGER_S: Final = 0.2
LITTLE_DEG: Final = 2.0
# If the stand is at rest at the last reported position, it is assumed to stay at rest for this time, s.
STAYS_S: Final = 0.35
# The stand counts as at rest if consecutive positions differ by less than this angle, deg.
AT_REST_DEG: Final = 0.05


def joined_angles(logged: Logged) -> FloatArray:
    """Motor angles at the instants of the samples, (N, 3), deg; NaN where the angles are not known.

    Angles are not known if the stand moved between two reports that are too far apart in time, after the last
    report of a moving stand, and later than `STAYS_S` after the last report of a stand at rest. Before the
    first report the stand is assumed to be at rest.
    """
    reported_s, angles = logged.positions[:, 0], logged.positions[:, 1:]
    order = np.argsort(reported_s, kind="stable")
    reported_s, angles = reported_s[order], angles[order]
    at_s = host_instants(logged)
    joined = np.column_stack([np.interp(at_s, reported_s, angle) for angle in angles.T])
    after = np.clip(np.searchsorted(reported_s, at_s), 1, max(len(reported_s) - 1, 1))
    if len(reported_s) > 1:
        passed_s = reported_s[after] - reported_s[after - 1]
        turned = np.abs(angles[after] - angles[after - 1]).max(axis=1)
        unknown = (passed_s > LONGER_S) & (turned > AT_REST_DEG) | (passed_s > LONGEST_S) & (
            turned > LITTLE_DEG
        )
        joined[unknown & (at_s >= reported_s[0])] = np.nan
        rests = np.abs(angles[-1] - angles[-2]).max() <= AT_REST_DEG
        joined[at_s > reported_s[-1] + (STAYS_S if rests else 0.0)] = np.nan
    return joined


def host_instants(logged: Logged) -> FloatArray:
    """Host time at which each sample was taken, (N,), s; late by the shortest transmission delay."""
    name = next((column for column in logged.columns if column in TICKS_PER_S), None)
    if name is None or len(logged.samples) < 2:
        return logged.host_s
    unit_s = logged.samples[:, logged.columns.index(name)] / TICKS_PER_S[name]
    unit_s = unit_s - unit_s[0]
    if not np.isfinite(unit_s).all() or unit_s[-1] <= 0:
        return logged.host_s
    late_s = logged.host_s - logged.host_s[0] - unit_s
    slope = _slope(unit_s, late_s)
    line = slope * unit_s
    instants: FloatArray = logged.host_s[0] + unit_s + line + np.min(late_s - line)
    return instants


def _slope(unit_s: FloatArray, late_s: FloatArray) -> float:
    """Relative difference of the clock rates: elapsed host time per elapsed unit time, minus one."""
    slope = _hull_slope(unit_s, late_s)
    if abs(slope) <= MAX_SLOPE:
        return slope
    middle = len(unit_s) // 2
    halves = [_hull_slope(unit_s[half], late_s[half]) for half in (slice(0, middle), slice(middle, None))]
    is_real = unit_s[-1] > SLOPE_OVER_S and all(abs(half - slope) <= AGREEING_SLOPE for half in halves)
    return (
        slope
        if is_real and min(map(abs, halves)) > MAX_SLOPE
        else float(np.clip(slope, -MAX_SLOPE, MAX_SLOPE))
    )


def _hull_slope(unit_s: FloatArray, late_s: FloatArray) -> float:
    """Rate difference of the clocks, computed from the least delayed samples.

    It is the slope of the lower convex hull of the points (unit time, delay) at the mean unit time.
    """
    hull: list[tuple[float, float]] = []
    if len(unit_s) > MOST_POINTS:
        # Only the least delayed sample of each block is kept, because the lower hull depends only on such
        # samples.
        size = len(unit_s) // MOST_POINTS + 1
        starts = np.arange(0, len(unit_s), size)
        lowest = np.array([start + int(np.argmin(late_s[start : start + size])) for start in starts])
        unit_s, late_s = unit_s[lowest], late_s[lowest]
    for point in zip(unit_s.tolist(), late_s.tolist(), strict=True):
        while len(hull) > 1 and _is_above(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    mean = float(np.mean(unit_s))
    for (start, low), (end, high) in itertools.pairwise(hull):
        if end >= mean and end > start:
            return (high - low) / (end - start)
    return 0.0


def _is_above(first: tuple[float, float], middle: tuple[float, float], last: tuple[float, float]) -> bool:
    """Whether the middle point lies on or above the line through the other two points."""
    return (middle[1] - first[1]) * (last[0] - first[0]) >= (last[1] - first[1]) * (middle[0] - first[0])
