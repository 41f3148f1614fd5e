"""Shifts that all units of a station, or of a station on one day, have in common: they are the station's.

Each measurement is predicted from the other measurements of its unit and from the mean of its batch. The
residuals of a station, and of a station on one day, are then tested for a common mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements, TextArray
from imucal.fleet.statistics.columns import FEWEST, Columns, unit_numbers
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.spread import spread_of

__all__ = ["Shift", "Shifts", "common_shifts", "days_of"]

# Probability, over all stations, days and columns together, of a shift where there is none.
FALSE_ALARM: Final = 0.001
# Residuals beyond this number of standard deviations count as if they were there, so that a few odd units do
# not move a station.
CLIPPED_AT: Final = 2.5
# Fewest units of a station on a day that are judged.
FEWEST_OF_DAY: Final = 5
# Largest number of shifts that are searched one after the other.
MOST_SHIFTS: Final = 200


@dataclass(frozen=True)
class Shift:
    """A shift that the units of a station have in common.

    station, day   the day is empty if the station is shifted on all days
    name, unit     of the parameter or figure
    units          number of measurements
    shift, std     in the unit; for a figure, of its natural logarithm
    z              over the standard deviation
    p_value        corrected for the number of stations, days and columns
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
    """Common shifts, and what they add to each value, (n, c)."""

    found: tuple[Shift, ...]
    added: FloatArray


def common_shifts(measurements: Measurements, columns: Columns) -> Shifts:
    """The significant shifts, the largest first; each is taken off before the next is searched."""
    stats: Any = scipy_part("stats")
    numbers = unit_numbers(measurements.serials)
    days = days_of(measurements)
    groups = _groups(measurements.stations, days)
    added = np.zeros_like(columns.values)
    tests = max(len(groups) * len(columns.names), 1)
    threshold = float(stats.norm.isf(0.5 * FALSE_ALARM / tests))
    found: list[tuple[str, str, int, Shift]] = []
    for column in range(len(columns.names)):
        own = _Column(columns.values[:, column], columns.variances[:, column], numbers, measurements.batches)
        for _ in range(MOST_SHIFTS):
            residual, std = own.residuals(added[:, column])
            scores = [_score(residual[rows], std[rows]) for _, _, rows in groups]
            if not scores or max(map(abs, scores)) < threshold:
                break
            best = int(np.argmax(np.abs(scores)))
            station, day, rows = groups[best]
            shift, shift_std = _location(residual[rows], std[rows])
            if abs(shift) < 0.1 * shift_std:
                break
            added[rows, column] += shift
            p_value = min(2.0 * float(stats.norm.sf(abs(scores[best]))) * tests, 1.0)
            count = int(np.isfinite(residual[rows]).sum())
            name, unit = columns.names[column], columns.units[column]
            found.append(
                (
                    station,
                    day,
                    column,
                    Shift(station, day, name, unit, count, shift, shift_std, scores[best], p_value),
                )
            )
    return Shifts(tuple(sorted(_merged(found), key=lambda shift: -abs(shift.z))), added)


def days_of(measurements: Measurements) -> TextArray:
    """The day of each measurement, UTC; empty without a date."""
    days = np.datetime_as_string(measurements.dates, unit="D")
    return np.where(np.isnat(measurements.dates), "", days)


def _groups(stations: TextArray, days: TextArray) -> list[tuple[str, str, np.ndarray]]:
    """Rows of each station if there are several, and of each station on each day if it has several."""
    groups: list[tuple[str, str, np.ndarray]] = []
    of_station = {station: np.flatnonzero(stations == station) for station in np.unique(stations)}
    several = len(of_station) > 1
    for station, rows in of_station.items():
        if several and station and len(rows) >= FEWEST:
            groups.append((str(station), "", rows))
        of_day, inverse = np.unique(days[rows], return_inverse=True)
        if several or len(of_day) > 1:
            order = np.argsort(inverse, kind="stable")
            parts = np.split(rows[order], np.flatnonzero(np.diff(inverse[order])) + 1)
            groups += [
                (str(station), str(day), part)
                for day, part in zip(of_day, parts, strict=True)
                if day and len(part) >= FEWEST_OF_DAY
            ]
    return groups


class _Column:
    """One column, and the prediction of each of its values from the others."""

    def __init__(
        self, values: FloatArray, variances: FloatArray, numbers: np.ndarray, batches: TextArray
    ) -> None:
        self._values, self._variances, self._numbers = values, variances, numbers
        self._known = np.isfinite(values)
        self._batch = np.unique(batches, return_inverse=True)[1].reshape(-1)

    def residuals(self, added: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value minus its prediction, and the standard deviation of this; NaN where there is no value."""
        y = self._values - added
        known, numbers, variances = self._known, self._numbers, self._variances
        mean = self._means(y)
        _, first = np.unique(np.where(known, numbers, -1), return_index=True)
        first = first[known[first]]
        spread = spread_of((y - mean)[first], np.sqrt(variances[first]), interval=False).spread
        spread = max(spread, 1e-6 * float(np.nanstd(y)), np.finfo(float).tiny)
        # Without a known repeatability the other measurements of a unit predict nothing.
        weight = np.where(known & (variances > 0), 1.0 / np.where(variances > 0, variances, 1.0), 0.0)
        count = int(numbers.max()) + 1
        sum_weight = np.bincount(numbers, weight, count)[numbers] - weight
        weighted = np.where(known, weight * (y - mean), 0.0)
        sum_weighted = np.bincount(numbers, weighted, count)[numbers] - weighted
        information = np.maximum(sum_weight, 0.0) + 1.0 / spread**2
        residual = np.where(known, y - mean - sum_weighted / information, np.nan)
        return residual, np.sqrt(variances + 1.0 / information)

    def _means(self, y: FloatArray) -> FloatArray:
        """The median of the batch of each value, or of all values for a small batch."""
        means = np.full(len(y), float(np.nanmedian(y)))
        for batch in range(int(self._batch.max()) + 1):
            rows = (self._batch == batch) & self._known
            if rows.sum() >= FEWEST:
                means[self._batch == batch] = float(np.median(y[rows]))
        return means


def _score(residual: FloatArray, std: FloatArray) -> float:
    """Clipped standardised residuals, summed, over the standard deviation of the sum."""
    z = (residual / std)[np.isfinite(residual)]
    if len(z) < FEWEST_OF_DAY:
        return 0.0
    return float(np.clip(z, -CLIPPED_AT, CLIPPED_AT).sum() / np.sqrt(len(z)))


def _location(residual: FloatArray, std: FloatArray) -> tuple[float, float]:
    """Robust weighted mean of residuals, and its standard deviation."""
    known = np.isfinite(residual)
    y, weight = residual[known], 1.0 / std[known] ** 2
    location = float(np.median(y))
    for _ in range(20):
        z = np.abs(y - location) / std[known]
        robust = weight * np.minimum(1.0, CLIPPED_AT / np.maximum(z, CLIPPED_AT))
        location = float((robust * y).sum() / robust.sum())
    return location, float(1.0 / np.sqrt(robust.sum()))


def _merged(found: list[tuple[str, str, int, Shift]]) -> list[Shift]:
    """One shift for each station, day and column; the search may have taken it off in several steps."""
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
