"""Estimates the slope of each parameter of each unit over time, and tests whether it is zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.columns import Columns, unit_numbers
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.trends import months_of

__all__ = ["Slopes", "slopes_of"]

# Number of rows whose covariances are inverted at once, which limits the memory.
CHUNK: Final = 4000


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes per month of the c columns (parameters) of u units with two or more dates.

    rows          row indices of each unit, in order of time
    first         (u,) first row of each unit
    slopes, stds  (u, c), NaN for a column with fewer than two dates
    chi2, dof     (u,) chi2 and its degrees of freedom in the joint test that all slopes of a unit are zero.
                  chi2 is None without covariances of the calibrations, and NaN for a unit whose covariances
                  cannot be inverted
    parameter_p   (u, c) p-value of slope or step, corrected for the number of columns and of steps
    p_values      (u,) combined p-value of the joint test and of the tests of the single columns
    """

    rows: tuple[np.ndarray, ...]
    first: np.ndarray
    slopes: FloatArray
    stds: FloatArray
    chi2: FloatArray | None
    dof: np.ndarray
    parameter_p: FloatArray
    p_values: FloatArray


def slopes_of(dated: Measurements, columns: Columns, values: FloatArray) -> Slopes:
    """Slopes of units with two or more dates. `values` are the columns after station shifts are removed."""
    stats: Any = scipy_part("stats")
    # A parameter without a positive variance, such as a parameter that is not estimated, has no slope.
    values = np.where(columns.variances > 0, values, np.nan)
    rows = _rows_of_units(dated)
    first = np.array([own[0] for own in rows], dtype=np.intp)
    size = (len(rows), len(columns.names))
    slopes, stds, steps = np.full(size, np.nan), np.full(size, np.nan), np.zeros(size)
    counts = np.ones(size)
    months = months_of(dated)
    for unit, own in enumerate(rows):
        y, variance = values[own], columns.variances[own]
        weight = np.where(np.isfinite(y), 1.0 / np.where(variance > 0, variance, 1.0), 0.0)
        y = np.where(np.isfinite(y), y, 0.0)
        t = (months[own] - months[own[0]])[:, None]
        total = weight.sum(0)
        with np.errstate(divide="ignore", invalid="ignore"):
            centred = t - (weight * t).sum(0) / total
            information = (weight * centred**2).sum(0)
            enough = (information > 0) & ((weight > 0).sum(0) >= 2)
            slopes[unit] = np.where(enough, (weight * centred * y).sum(0) / information, np.nan)
            stds[unit] = np.where(enough, 1.0 / np.sqrt(information), np.nan)
            for at in range(1, len(own)):
                before, after = weight[:at].sum(0), weight[at:].sum(0)
                step = (weight[at:] * y[at:]).sum(0) / after - (weight[:at] * y[:at]).sum(0) / before
                steps[unit] = np.fmax(steps[unit], step**2 / (1.0 / before + 1.0 / after))
        counts[unit] = len(own) - 1
    z2 = (slopes / stds) ** 2
    known = np.isfinite(z2)
    # With two dates, a slope and a step are equivalent. With more dates, one slope and several steps are
    # tested, and the most significant one is taken. The p-value is corrected for the number of these tests.
    tests = np.where(counts > 1, counts + 1, 1.0) * known.sum(1)[:, None]
    largest = np.where(counts > 1, np.fmax(z2, steps), z2)
    parameter_p = np.where(known, np.minimum(stats.chi2.sf(largest, 1) * tests, 1.0), np.nan)
    dof = known.sum(1)
    single_p = np.fmin.reduce(parameter_p, axis=1) if len(rows) else np.zeros(0)
    if dated.covariances is None or not rows:
        # Without covariances there is no joint test of all parameters, because the slopes of the parameters
        # of one unit are correlated, and the distribution of the sum of their squares is then unknown.
        return Slopes(tuple(rows), first, slopes, stds, None, dof, parameter_p, single_p)
    chi2 = _joint(dated, columns, values, rows, months)
    joint_p = np.where(np.isfinite(chi2), stats.chi2.sf(chi2, dof), 1.0)
    p_values = np.minimum(2.0 * np.minimum(joint_p, single_p), 1.0)
    return Slopes(tuple(rows), first, slopes, stds, chi2, dof, parameter_p, p_values)


def _rows_of_units(dated: Measurements) -> list[np.ndarray]:
    """Rows of each unit with two or more dates; `dated` is in order of time."""
    numbers = unit_numbers(dated.serials)
    order = np.argsort(numbers, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1)
    return [part for part in parts if len(part) > 1 and dated.dates[part[-1]] > dated.dates[part[0]]]


def _joint(
    dated: Measurements,
    columns: Columns,
    values: FloatArray,
    rows: list[np.ndarray],
    months: FloatArray,
) -> FloatArray:
    """chi2 of the slopes of each unit by generalised least squares with the covariances of its calibrations.

    information = sum t^2 W - (sum t W) (sum W)^-1 (sum t W)

    The sums are over the calibrations of the unit. t is the time of a calibration, and W the inverse of the
    covariance of this calibration.
    """
    picked = np.array([dated.names.index(name) for name in columns.names], dtype=np.intp)
    chi2 = np.full(len(rows), np.nan)
    start = 0
    while start < len(rows):
        end, count = start, 0
        while end < len(rows) and (count == 0 or count + len(rows[end]) <= CHUNK):
            count += len(rows[end])
            end += 1
        flat = np.concatenate(rows[start:end])
        weights = _inverse(dated, columns, values, flat, picked)
        y = np.where(np.isfinite(values[flat]), values[flat], 0.0)
        offsets = np.concatenate([[0], np.cumsum([len(own) for own in rows[start:end]])[:-1]])
        # Times are relative to the mean of each unit, so that the sums are well conditioned.
        lengths = np.array([len(own) for own in rows[start:end]])
        t = months[flat] - np.repeat(np.add.reduceat(months[flat], offsets) / lengths, lengths)
        # Values are relative to the first value of each unit, which does not change the slope.
        y = y - np.repeat(y[offsets], lengths, axis=0)
        wy = np.einsum("nij,nj->ni", weights, y)
        a0, a1, a2 = (
            np.add.reduceat(power[:, None, None] * weights, offsets) for power in (np.ones_like(t), t, t**2)
        )
        b0, b1 = np.add.reduceat(wy, offsets), np.add.reduceat(t[:, None] * wy, offsets)
        ridge = 1e-300 * np.eye(len(picked))
        try:
            both = np.linalg.solve(a0 + ridge, np.concatenate([a1, b0[:, :, None]], axis=2))
            information = a2 - a1 @ both[:, :, :-1]
            right = b1 - np.einsum("nij,nj->ni", a1, both[:, :, -1])
            chi2[start:end] = np.einsum(
                "ni,ni->n", right, np.linalg.solve(information + ridge, right[:, :, None])[:, :, 0]
            )
        except np.linalg.LinAlgError:
            # The covariances of these units cannot be inverted, so only their single parameters are tested.
            pass
        start = end
    return np.where(chi2 >= 0, chi2, np.nan)


def _inverse(
    dated: Measurements, columns: Columns, values: FloatArray, rows: np.ndarray, picked: np.ndarray
) -> FloatArray:
    """Invert the covariances of calibrations, with the variances of `columns` on their diagonals.

    These variances include the excess variance of repeated calibrations. In the inverse, the rows and columns
    of missing values are 0.
    """
    assert dated.covariances is not None
    covariances = dated.covariances[rows[:, None, None], picked[:, None], picked[None, :]].copy()
    stated = np.einsum("nii->ni", covariances)
    missing = ~np.isfinite(values[rows]) | ~np.isfinite(stated)
    covariances[missing[:, :, None] | missing[:, None, :]] = 0.0
    diagonal = np.arange(len(picked))
    covariances[:, diagonal, diagonal] = np.where(missing, 1.0, columns.variances[rows])
    # Covariances are scaled to correlations, because parameters have different magnitudes.
    scale = 1.0 / np.sqrt(covariances[:, diagonal, diagonal])
    correlations = covariances * scale[:, :, None] * scale[:, None, :]
    weights = np.linalg.inv(correlations) * scale[:, :, None] * scale[:, None, :]
    weights[missing[:, :, None] | missing[:, None, :]] = 0.0
    return np.asarray(weights)
