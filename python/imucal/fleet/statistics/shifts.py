"""Shifts common to all units of a station, on all days or on one day. They are errors of the station.

Each measurement is predicted from the other measurements of its unit and from the median of its batch. The
residuals of a station, and of a station on one day, are then tested for a common location by Tukey's
biweight. The majority of the units determines this location, so outlying units have no effect. Trends of
single units are removed first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements, TextArray
from imucal.fleet.statistics.columns import FEWEST, Columns, unit_numbers
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.spread import MEDIAN_DEVIATION, spread_of
from imucal.fleet.statistics.trends import months_of, without_trends

__all__ = ["Shift", "Shifts", "common_shifts", "days_of"]

# Probability that any shift is reported if there is no shift, over all stations, days and columns (parameters
# and figures of merit).
FALSE_ALARM: Final = 0.001
# Tukey's biweight gives no weight to residuals that are more than this number of standard deviations from the
# location of the group (a station, or a station on one day). With this number, the biweight estimate of
# normally distributed values has the efficiency 95 %: its variance is that of the mean, divided by 0.95
# (Maronna et al., Robust Statistics, 2006).
BIWEIGHT: Final = 4.685
EFFICIENCY: Final = 0.95
BIWEIGHT_STEPS: Final = 15
# The iteration for a location ends when the location changes by less than this multiple of its standard
# deviation.
BIWEIGHT_SETTLED: Final = 1e-6
TINY: Final = np.finfo(float).tiny
# At least this share of the units of a group must have a nonzero weight in the biweight estimate, because a
# shift must be common to most units.
COMMON: Final = 0.6
# Minimum number of measurements of a station, or of a station on one day, for a test of their shift.
FEWEST_OF_DAY: Final = 5
# Maximum number of shifts of one column that are searched one after the other.
MOST_SHIFTS: Final = 200


@dataclass(frozen=True)
class Shift:
    """A shift common to the units of a station.

    station, day   the day is empty if the station is shifted on all days
    name, unit     name and unit of the parameter or figure of merit
    units          number of measurements
    shift, std     shift and its standard deviation in `unit`; for a figure of merit, of its natural logarithm
    z              shift divided by its standard deviation
    p_value        p-value corrected for the number of stations, days and columns
    """

    station: str
    day: str
    name: str
    unit: str
    units: int
    shift: float
    std: float
    z: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Shifts:
    """The common shifts.

    found   the significant shifts
    added   (n, c) for n measurements and c columns: the sum of the shifts that each value contains
    """

    found: tuple[Shift, ...]
    added: FloatArray


def common_shifts(measurements: Measurements, columns: Columns) -> Shifts:
    """Find the significant shifts, sorted by |z|. Each shift is removed before the next one is searched."""
    stats: Any = scipy_part("stats")
    numbers = unit_numbers(measurements.serials)
    partitions = _partitions(measurements.stations, days_of(measurements))
    months = months_of(measurements)
    added = np.zeros_like(columns.values)
    tests = max(sum(len(partition.names) for partition in partitions) * len(columns.names), 1)
    threshold = float(stats.norm.isf(0.5 * FALSE_ALARM / tests))
    found: list[tuple[str, str, int, Shift]] = []
    for column in range(len(columns.names)) if partitions else ():
        values, variances = columns.values[:, column], columns.variances[:, column]
        own = _Column(values, variances, numbers, measurements.batches, months)
        for _ in range(MOST_SHIFTS):
            residual, std = own.residuals(added[:, column])
            best = max((partition.largest(residual, std) for partition in partitions), key=lambda g: abs(g.z))
            if abs(best.z) < threshold:
                break
            added[best.rows, column] += best.shift
            p_value = min(2.0 * float(stats.norm.sf(abs(best.z))) * tests, 1.0)
            name, unit = columns.names[column], columns.units[column]
            shift = Shift(
                *best.name, name, unit, best.units, best.shift, best.shift / best.z, best.z, p_value
            )
            found.append((*best.name, column, shift))
    return Shifts(tuple(sorted(_merged(found), key=lambda shift: -abs(shift.z))), added)


def days_of(measurements: Measurements) -> TextArray:
    """The day of each measurement, UTC; an empty text for a measurement without a date."""
    days = np.datetime_as_string(measurements.dates, unit="D")
    return np.where(np.isnat(measurements.dates), "", days)


@dataclass(frozen=True, eq=False)
class _Group:
    """The group with the most significant shift: a station on all days, or a station on one day."""

    name: tuple[str, str]
    rows: np.ndarray
    units: int
    shift: float
    z: float


class _Partition:
    """A partition of rows into disjoint groups.

    names   station and day of each group; the day is empty if the group is a station on all days
    labels  index of the group of each row; -1 for a row without a group
    """

    def __init__(self, names: list[tuple[str, str]], labels: np.ndarray) -> None:
        self.names, self._labels = names, labels

    def largest(self, residual: FloatArray, std: FloatArray) -> _Group:
        """The group whose common shift, divided by its standard deviation, has the largest magnitude."""
        labels, size = self._labels, len(self.names)
        known = np.isfinite(residual) & (labels >= 0)
        own, y, precision = labels[known], residual[known], 1.0 / std[known] ** 2
        count = np.bincount(own, minlength=size)
        # The weight of a unit is the inverse variance of its residual. A unit that was measured often has a
        # precise prediction and could dominate its group. Therefore all weights are limited to the fifth
        # largest weight in the group.
        order = np.lexsort((-precision, own))
        start = np.cumsum(count) - count
        fifth = np.minimum(start + np.clip(count - 1, 0, FEWEST_OF_DAY - 1), max(len(y) - 1, 0))
        weight = np.minimum(precision, precision[order][fifth][own]) if len(y) else precision
        order = np.lexsort((y, own))
        middle = np.minimum(start + (count - 1) // 2, max(len(y) - 1, 0))
        location = np.where(count > 0, y[order][middle], 0.0) if len(y) else np.zeros(size)
        inside = np.ones(len(y), dtype=bool)
        for _ in range(BIWEIGHT_STEPS):
            z2 = (y - location[own]) ** 2 * precision / BIWEIGHT**2
            inside = z2 < 1.0
            robust = np.where(inside, (1.0 - z2) ** 2, 0.0) * weight
            total = np.bincount(own, robust, size)
            mean = np.bincount(own, robust * y, size)
            before = location
            location = np.divide(mean, total, out=np.zeros(size), where=total > 0)
            if (np.abs(location - before) <= BIWEIGHT_SETTLED / np.sqrt(np.maximum(total, TINY))).all():
                break
        information = EFFICIENCY * np.bincount(own, weight * inside, size)
        common = np.bincount(own, inside, size) >= COMMON * count
        z = np.where(common & (count >= FEWEST_OF_DAY), location * np.sqrt(information), 0.0)
        best = int(np.argmax(np.abs(z)))
        rows = np.flatnonzero(labels == best)
        return _Group(self.names[best], rows, int(count[best]), float(location[best]), float(z[best]))


def _partitions(stations: TextArray, days: TextArray) -> list[_Partition]:
    """Partitions of the measurements into groups: by station, and by station and day."""
    found = []
    names = np.unique(stations)
    if len(names) > 1:
        labels = np.unique(stations, return_inverse=True)[1].reshape(-1)
        found.append(_Partition([(str(name), "") for name in names], np.where(stations == "", -1, labels)))
    both = np.char.add(np.char.add(stations, "\n"), days)
    pairs, labels = np.unique(both, return_inverse=True)
    if len(pairs) > 1:
        split = [str(pair).split("\n") for pair in pairs]
        labels = np.where(days == "", -1, labels.reshape(-1))
        found.append(_Partition([(station, day) for station, day in split], labels))
    return found


class _Column:
    """The values of one parameter or figure of merit.

    Each value is predicted from other values of its unit and from the median of its batch.
    """

    def __init__(
        self,
        values: FloatArray,
        variances: FloatArray,
        numbers: np.ndarray,
        batches: TextArray,
        months: FloatArray,
    ) -> None:
        self._values, self._variances, self._numbers, self._months = values, variances, numbers, months
        self._known = np.isfinite(values)
        self._batch = np.unique(batches, return_inverse=True)[1].reshape(-1)

    def residuals(self, added: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, which are values without the shifts `added` minus predictions, and their std deviations.

        Residuals of missing values are NaN.
        """
        known, numbers, variances = self._known, self._numbers, self._variances
        y = without_trends(numbers, self._months, self._values - added, variances)
        mean = self._means(y)
        _, first = np.unique(np.where(known, numbers, -1), return_index=True)
        first = first[known[first]]
        spread = spread_of((y - mean)[first], np.sqrt(variances[first]), interval=False).spread
        spread = max(spread, 1e-6 * float(np.nanstd(y)), np.finfo(float).tiny)
        # Measurements without a known variance have no weight in the prediction.
        weight = np.where(known & (variances > 0), 1.0 / np.where(variances > 0, variances, 1.0), 0.0)
        count = int(numbers.max()) + 1
        sum_weight = np.bincount(numbers, weight, count)[numbers] - weight
        weighted = np.where(known, weight * (y - mean), 0.0)
        sum_weighted = np.bincount(numbers, weighted, count)[numbers] - weighted
        information = np.maximum(sum_weight, 0.0) + 1.0 / spread**2
        residual = np.where(known, y - mean - sum_weighted / information, np.nan)
        std = np.sqrt(variances + 1.0 / information)
        # If the residuals scatter more than their standard deviations predict, for example because the fleet
        # has a distribution with wide tails, these standard deviations are increased.
        scale = float(np.nanmedian(np.abs(residual / std))) / MEDIAN_DEVIATION
        return residual, std * max(scale, 1.0)

    def _means(self, y: FloatArray) -> FloatArray:
        """For each value, the median of its batch; the median of all values if the batch is small."""
        means = np.full(len(y), float(np.nanmedian(y)))
        for batch in range(int(self._batch.max()) + 1):
            rows = (self._batch == batch) & self._known
            if rows.sum() >= FEWEST:
                means[self._batch == batch] = float(np.median(y[rows]))
        return means


def _merged(found: list[tuple[str, str, int, Shift]]) -> list[Shift]:
    """One shift per station, day and column: the sum of shifts that were removed in several steps."""
    merged: dict[tuple[str, str, int], Shift] = {}
    for station, day, column, shift in found:
        key = (station, day, column)
        before = merged.get(key)
        if before is None:
            merged[key] = shift
        else:
            both = before.shift + shift.shift
            merged[key] = Shift(
                station, day, shift.name, shift.unit, shift.units, both, before.std, before.z, before.p_value
            )
    return list(merged.values())
