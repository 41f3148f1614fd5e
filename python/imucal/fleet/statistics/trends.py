"""Removal of trends of single units, before properties that are common to units are estimated."""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements

__all__ = ["DAYS_PER_MONTH", "months_of", "without_trends"]

# Mean length of a month of the Gregorian calendar, days.
DAYS_PER_MONTH: Final = 30.436875
# A unit has a trend under two conditions. A fitted line reduces chi2 by at least EXPLAINED, and the remaining
# chi2 per degree of freedom is at most LEFT_PER_DOF. A shift on one of three or more dates cannot meet both
# conditions, because a line fitted to a shift that is large enough for the first condition leaves more chi2
# than the second condition allows.
EXPLAINED: Final = 25.0
LEFT_PER_DOF: Final = 4.0
FEWEST_DATES: Final = 3


def months_of(measurements: Measurements) -> FloatArray:
    """Time of each measurement since the earliest measurement, months; NaN if it has no date."""
    dates = measurements.dates
    known = ~np.isnat(dates)
    if not known.any():
        return np.full(len(dates), np.nan)
    seconds = (dates - dates[known].min()) / np.timedelta64(1, "s")
    return np.where(known, seconds, np.nan) / (86400.0 * DAYS_PER_MONTH)


def without_trends(
    numbers: np.ndarray, months: FloatArray, values: FloatArray, variances: FloatArray
) -> FloatArray:
    """Values of one column with trends removed; the first value of each unit is unchanged.

    numbers   index of the unit of each value
    """
    usable = np.isfinite(values) & np.isfinite(months) & (variances > 0)
    weight = np.where(usable, 1.0 / np.where(variances > 0, variances, 1.0), 0.0)
    size = int(numbers.max()) + 1 if len(numbers) else 0

    def mean(quantity: FloatArray) -> FloatArray:
        total = np.bincount(numbers, weight, size)
        summed = np.bincount(numbers, weight * quantity, size)
        found = np.divide(summed, total, out=np.zeros(size), where=total > 0)
        return np.asarray(found[numbers])

    t = np.where(usable, months, 0.0)
    y = np.where(usable, values, 0.0)
    t, y = t - mean(t), y - mean(y)
    t2, ty, y2 = (np.bincount(numbers, weight * product, size) for product in (t * t, t * y, y * y))
    slope = np.divide(ty, t2, out=np.zeros(size), where=t2 > 1e-12 * max(float(t2.max(initial=0.0)), 1e-300))
    explained = slope * ty
    count = np.bincount(numbers, usable, size)
    left = (y2 - explained) / np.maximum(count - 2, 1)
    has_trend = (count >= FEWEST_DATES) & (explained > EXPLAINED) & (left < LEFT_PER_DOF)
    first = np.full(size, np.inf)
    np.minimum.at(first, numbers[usable], months[usable])
    since = np.where(usable, months - first[numbers], 0.0)
    return np.asarray(values - np.where(has_trend, slope, 0.0)[numbers] * since)
