"""Detects outlying units by a robust Mahalanobis distance over all parameters and figures of merit.

    d_i^2 = (y_i - mean)^T (S + C_i)^-1 (y_i - mean)

d_i is the distance of unit i, and y_i are its parameters and figures of merit. S is the covariance of the
true values over the units, and C_i is the covariance of the measurement noise of unit i. Mean and S come from
the minimum covariance determinant (MCD) with a deterministic start (Hubert, Rousseeuw and Verdonck, Journal
of Computational and Graphical Statistics 21, 2012). The measurement noise is subtracted from S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.columns import columns_of
from imucal.fleet.statistics.robust_covariance import decisive, robust_location
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.shifts import Shift, common_shifts
from imucal.fleet.statistics.spread import MEDIAN_DEVIATION
from imucal.fleet.statistics.units_of_fleet import POOR, usable

__all__ = ["OutlierResult", "UnitDistance", "outliers"]

SCHEMA: Final = "imucal.fleet-outliers/1"
# False discovery rate: expected share of false alarms among the units that are reported as outlying.
FALSE_DISCOVERIES: Final = 0.002
# Maximum number of parameters that are listed for an outlying unit.
MOST_DECIDING: Final = 3
# Minimum number of units per column (parameter or figure of merit). A smaller fleet is refused.
UNITS_PER_COLUMN: Final = 2
# Number of units whose covariances are inverted at once. This number limits the memory.
CHUNK: Final = 4000


@dataclass(frozen=True)
class Deciding:
    """A parameter or figure of merit that contributes much to the distance of a unit from the fleet.

    value, expected   measured value minus the shifts of the station, and mean of the fleet; natural
                      logarithms for a figure of merit
    z                 deviation of `value` from `expected`, in standard deviations of a measured value
    removed           decrease of d^2 if this parameter is omitted
    """

    name: str
    unit: str
    value: float
    expected: float
    z: float
    removed: float


@dataclass(frozen=True)
class UnitDistance:
    """The distance of one unit from the mean of the fleet.

    distance   distance d, the square root of d^2
    p_value    p-value under the null hypothesis that the unit belongs to the fleet
    q_value    smallest false discovery rate at which the unit is reported
    is_odd     whether q_value is at most 0.2 %
    decides    the parameters with the largest `removed`, in descending order
    """

    serial: str
    station: str
    date: str
    batch: str
    distance: float
    p_value: float
    q_value: float
    is_odd: bool
    decides: tuple[Deciding, ...]


@dataclass(frozen=True)
class OutlierResult:
    """Distances of all units from the mean of the fleet.

    units     distances of the units, farthest first
    poor      number of calibrations omitted because they are poor
    columns   names of the parameters and figures of merit
    shifts    common shifts of stations, which were removed because they are not properties of units
    tail      degrees of freedom of the distribution of distances: infinite for normal units, small for wide
              tails
    """

    units: tuple[UnitDistance, ...]
    poor: int
    columns: tuple[str, ...]
    shifts: tuple[Shift, ...]
    tail: float

    @property
    def odd(self) -> tuple[UnitDistance, ...]:
        """The outlying units."""
        return tuple(unit for unit in self.units if unit.is_odd)

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet outliers --json`."""
        return {"schema": SCHEMA, **without_nan(self)}


def outliers(measurements: Measurements) -> OutlierResult:
    """Distance of the first calibration of each unit from the mean of the fleet.

    Raises InputError for fewer than ten units, or fewer than twice as many units as parameters and figures of
    merit.
    """
    # The covariances are large and are not copied here. They are taken from `measurements` later, for a part
    # of the units at a time.
    kept, poor = usable(replace(measurements, covariances=None))
    all_columns = columns_of(kept)
    shifts = common_shifts(kept, all_columns)
    own, rows = _first_rows(kept)
    values = all_columns.values[rows] - shifts.added[rows]
    # Columns in which more than 10 % of the units have no value are omitted, because a unit without a value
    # cannot be tested.
    common = np.isfinite(values).mean(axis=0) > 0.9
    names = tuple(name for name, is_common in zip(all_columns.names, common, strict=True) if is_common)
    complete = np.isfinite(values[:, common]).all(axis=1)
    # A small fleet may have no column in `names`, because columns with fewer than ten values are omitted. The
    # number of columns is therefore taken to be at least the number of parameters.
    needed = max(UNITS_PER_COLUMN * max(len(names), len(kept.names)), 10)
    if complete.sum() < needed:
        raise InputError(
            f"{int(complete.sum())} units have values of all parameters and figures of merit: the search "
            f"for outliers needs at least {needed} units, and at least two per parameter or figure of merit"
        )
    own, rows, values = own.where(complete), rows[complete], values[complete][:, common]
    variances = all_columns.variances[rows][:, common]
    places = np.flatnonzero(measurements.verdicts != POOR)[rows]
    # Values are scaled by a robust width, because parameters have different magnitudes.
    centre = np.median(values, axis=0)
    width = np.median(np.abs(values - centre), axis=0) / MEDIAN_DEVIATION
    width = np.where(width > 0, width, np.maximum(values.std(axis=0), np.finfo(float).tiny))
    scaled = (values - centre) / width

    def noise(picked: np.ndarray) -> FloatArray:
        found = _noise(measurements, names, variances[picked], places[picked])
        return np.asarray(found / (width[:, None] * width[None, :]))

    part = decisive(len(own))
    mean, spread = robust_location(scaled[part], noise(part))
    chunks = np.array_split(np.arange(len(own)), -(-len(own) // CHUNK))
    parts = [_distances(scaled[chunk] - mean, noise(chunk), spread) for chunk in chunks]
    distances, removed, marginal = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    p_values, tail = _p_values(distances, removed, marginal**2)
    q_values = scipy_part("stats").false_discovery_control(p_values)
    expected = centre + width * mean
    decides = np.argsort(-removed, axis=1, kind="stable")[:, :MOST_DECIDING]
    deciding = zip(
        decides.tolist(),
        *(np.take_along_axis(of, decides, axis=1).tolist() for of in (values, marginal, removed)),
        strict=True,
    )
    units_of = [all_columns.units[all_columns.names.index(name)] for name in names]
    dates = np.where(np.isnat(own.dates), "", np.datetime_as_string(own.dates))
    described = zip(
        *(each.tolist() for each in (own.serials, own.stations, dates, own.batches)),
        *(each.tolist() for each in (np.sqrt(distances), p_values, q_values, q_values <= FALSE_DISCOVERIES)),
        (
            tuple(
                Deciding(names[column], units_of[column], value, float(expected[column]), z, fall)
                for column, value, z, fall in zip(*of_unit, strict=True)
            )
            for of_unit in deciding
        ),
        strict=True,
    )
    all_units = [UnitDistance(*fields) for fields in described]
    units = [all_units[unit] for unit in np.argsort(-distances, kind="stable").tolist()]
    return OutlierResult(tuple(units), poor, names, shifts.found, tail)


def _first_rows(kept: Measurements) -> tuple[Measurements, np.ndarray]:
    """The first measurement of each unit, and the indices of these measurements in `kept`."""
    order = np.argsort(kept.dates, kind="stable")
    _, first = np.unique(kept.serials[order], return_index=True)
    rows = order[np.sort(first)]
    return kept.where(rows), rows


def _noise(
    measurements: Measurements, names: Sequence[str], variances: FloatArray, picked: np.ndarray
) -> FloatArray:
    """Covariances of the noise of the picked measurements, (n, c, c).

    The matrices are diagonal if the measurements have no covariances.
    """
    size = len(names)
    noise = np.zeros((len(picked), size, size))
    if measurements.covariances is not None:
        inside = np.array([k for k, name in enumerate(names) if name in measurements.names], dtype=np.intp)
        columns = np.array([measurements.names.index(names[k]) for k in inside], dtype=np.intp)
        block = measurements.covariances[picked[:, None, None], columns[:, None], columns[None, :]]
        noise[:, inside[:, None], inside[None, :]] = np.where(np.isfinite(block), block, 0.0)
    diagonal = np.arange(size)
    noise[:, diagonal, diagonal] = variances
    return noise


def _distances(
    residuals: FloatArray, noise: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns d^2 of each unit, and two arrays with a value for each column of each unit.

    The first array contains the decrease of d^2 if the column is omitted. The second contains the residual of
    the column, divided by its standard deviation. `residuals` are y_i - mean, `noise` is C_i, and `spread` is
    S of the module's docstring.
    """
    total = spread + noise
    inverse = np.linalg.inv(total)
    weighted = np.einsum("nij,nj->ni", inverse, residuals)
    removed = weighted**2 / np.einsum("nii->ni", inverse)
    marginal = residuals / np.sqrt(np.einsum("nii->ni", total))
    return np.einsum("ni,ni->n", residuals, weighted), removed, marginal


def _p_values(squared: FloatArray, removed: FloatArray, marginal: FloatArray) -> tuple[FloatArray, float]:
    """p-values of d^2, and the degrees of freedom of the tail of its distribution.

    removed    squared deviation in each column, given the values in all other columns
    marginal   squared deviation in each column, without using other columns

    The first test compares d^2 / c, for c columns, with an F distribution that is scaled to the median of the
    units. The denominator degrees of freedom of this distribution are chosen such that the ratio of its upper
    5 % point to its median is the observed ratio. A fleet with wide tails therefore has few false alarms. For
    a normally distributed fleet, these degrees of freedom are infinite, and the distribution is chi-square.

    The second test detects a deviation in a single column. Among many columns, such a deviation contributes
    little to d^2. The test uses the largest squared deviation of a unit in any column, and an F distribution
    with the same denominator degrees of freedom as in the first test.

    If more than 5 % of the units of a small fleet are outliers, the outliers themselves widen the tail of the
    fitted F distribution. A third test therefore compares the marginal deviations of a unit with the marginal
    deviations of all units in all columns. Only a small part of these deviations belongs to outlying units,
    so the outliers hardly widen the tail of this distribution. All p-values are corrected for the number of
    tests.
    """
    columns = marginal.shape[1]
    largest = np.maximum(removed, marginal).max(axis=1)
    tail, scale = _tail_of(squared, columns)
    joint, single = _exceeded(squared, columns, tail, scale), _exceeded(largest, 1, tail, scale)
    smallest = np.minimum(joint, 2.0 * columns * single)
    if not np.isfinite(tail):
        return np.minimum(2.0 * smallest, 1.0), tail
    pooled = marginal.ravel()
    alone = _exceeded(marginal.max(axis=1), 1, *_tail_of(pooled, 1, widened=(1.0 + _scatter(pooled)) / 2.0))
    return np.minimum(3.0 * np.minimum(smallest, columns * alone), 1.0), tail


def _tail_of(squared: FloatArray, dof: int, widened: float = 1.0) -> tuple[float, float]:
    """Denominator degrees of freedom and scale of the F distribution that fits the squared distances.

    If the degrees of freedom are infinite, the distribution is chi-square.

    widened   factor by which the ratio of the upper 5 % point to the median is multiplied before the fit
    """
    stats: Any = scipy_part("stats")
    median, upper = np.quantile(squared, (0.5, 0.95))
    ratio = widened * upper / median if median > 0 else 1.0
    if ratio <= _ratio(stats.chi2(dof)) * _scatter(squared):
        return float("inf"), max(float(median / stats.chi2.ppf(0.5, dof)), 1.0)
    tail = next((each for each in TAILS if ratio <= _ratio(stats.f(dof, each))), TAILS[-1])
    return tail, float(median / (dof * stats.f.ppf(0.5, dof, tail)))


def _scatter(squared: FloatArray) -> float:
    """1 + the relative sampling error of (upper 5 % point) / median, for this number of values."""
    return 1.0 + 2.0 / float(np.sqrt(len(squared)))


def _exceeded(squared: FloatArray, dof: int, tail: float, scale: float) -> FloatArray:
    """Probability of exceeding each squared distance, from the F distribution that `_tail_of` has fitted."""
    stats: Any = scipy_part("stats")
    scaled = squared / scale
    found = stats.f.sf(scaled / dof, dof, tail) if np.isfinite(tail) else stats.chi2.sf(scaled, dof)
    return np.asarray(found)


def _ratio(distribution: Any) -> float:
    """The ratio of the upper 5 % point of a distribution to its median."""
    return float(distribution.ppf(0.95) / distribution.ppf(0.5))


# Trial values of the denominator degrees of freedom of the F distribution that is fitted to the squared
# distances, from nearly normal tails to wide tails.
TAILS: Final = (500.0, 200.0, 100.0, 50.0, 30.0, 20.0, 15.0, 10.0, 7.0, 5.0, 4.0, 3.0, 2.0)
