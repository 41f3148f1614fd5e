"""Parameters and figures of merit as columns of a matrix, and the repeatability of each column."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements, TextArray
from imucal.fleet.statistics.spread import spread_of
from imucal.fleet.statistics.trends import months_of, without_trends

__all__ = ["Columns", "columns_of", "repeatability", "unit_numbers"]

# Figures of merit whose logarithms are used as columns. These figures are positive, and units differ in them
# by factors. The logarithm converts factors to differences.
LOG_FIGURES: Final = tuple(
    f"{of}{name}"
    for of in ("", "control_")
    for name in ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")
)
# A parameter or figure of merit becomes a column if at least this number of units have a value of it. The
# repeatability is estimated if there are at least this number of pairs of measurements of the same unit.
FEWEST: Final = 10


@dataclass(frozen=True, eq=False)
class Columns:
    """Parameters and figures of merit of n measurements as the c columns of a matrix.

    names, units   (c,) names and units of the parameters, then of the figures of merit, whose unit is "ln"
                   (logarithm)
    values         (n, c), NaN for a missing value
    variances      (n, c) variances of the measurement noise: the stated variance, plus an excess variance,
                   which is estimated from repeated calibrations
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    variances: FloatArray


def columns_of(measurements: Measurements, *, figures: bool = True) -> Columns:
    """Convert measurements, which must be sorted by date, to columns.

    Columns with too few values and columns whose values are all equal are omitted.
    """
    names, units = list(measurements.names), list(measurements.units)
    values, sigmas = [measurements.values_si], [measurements.sigmas_si]
    for name in LOG_FIGURES if figures else ():
        figure = measurements.figures.get(name)
        if figure is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                logarithm = np.log(figure)
            logarithm[~np.isfinite(logarithm)] = np.nan
            values.append(logarithm[:, None])
            sigmas.append(np.zeros((len(measurements), 1)))
            names.append(name)
            units.append("ln")
    y, sigma = np.hstack(values), np.hstack(sigmas)
    y = np.where(np.isfinite(sigma), y, np.nan)
    numbers = unit_numbers(measurements.serials)
    kept = [
        column
        for column in range(y.shape[1])
        if np.count_nonzero(np.bincount(numbers[np.isfinite(y[:, column])])) >= FEWEST
        and np.nanmax(y[:, column]) > np.nanmin(y[:, column])
    ]
    y, sigma = y[:, kept], np.where(np.isfinite(sigma), sigma, 0.0)[:, kept]
    months = months_of(measurements)
    extra = np.array(
        [
            repeatability(numbers, without_trends(numbers, months, y[:, k], sigma[:, k] ** 2), sigma[:, k])
            for k in range(len(kept))
        ]
    )
    return Columns(
        tuple(names[k] for k in kept),
        tuple(units[k] for k in kept),
        y,
        sigma**2 + extra.reshape(1, -1) ** 2,
    )


def repeatability(numbers: np.ndarray, values: FloatArray, sigmas: FloatArray) -> float:
    """Excess standard deviation of repeated measurements: scatter beyond their stated standard deviations.

    It is the square root of (variance of the repeats - stated variance). `numbers` is the index of the unit
    of each value.

    The result is 0 if there are few repeats, or if the excess is not significant. It is computed from the
    scatter of the differences of consecutive measurements about their mean, so a steady drift common to all
    units has no effect. The caller removes trends of single units.
    """
    known = np.isfinite(values)
    order = np.argsort(numbers[known], kind="stable")
    unit, y, sigma = numbers[known][order], values[known][order], sigmas[known][order]
    same = unit[1:] == unit[:-1]
    if same.sum() < FEWEST:
        return 0.0
    pairs = spread_of((y[1:] - y[:-1])[same], np.hypot(sigma[1:], sigma[:-1])[same])
    # If the interval of the spread contains zero, repeats do not scatter significantly more than their stated
    # standard deviations.
    return pairs.spread / np.sqrt(2.0) if pairs.low > 0 else 0.0


def unit_numbers(serials: TextArray) -> np.ndarray:
    """An index of the unit for each row; rows with the same serial number have the same index."""
    return np.unique(serials, return_inverse=True)[1].reshape(-1)
