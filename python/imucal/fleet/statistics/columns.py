"""Parameters and figures of measurements as columns of one matrix, and how well a unit repeats in each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements, TextArray
from imucal.fleet.statistics.spread import spread_of
from imucal.fleet.statistics.trends import months_of, without_trends

__all__ = ["Columns", "columns_of", "repeatability", "unit_numbers"]

# Figures whose logarithm is a column. They are positive and spread by factors.
LOG_FIGURES: Final = tuple(
    f"{of}{name}"
    for of in ("", "control_")
    for name in ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")
)
# Fewest units that have a column, and fewest pairs of measurements from which the repeatability is estimated.
FEWEST: Final = 10


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of n measurements.

    names, units   the parameters, then the figures, whose unit is that of the logarithm, "ln"
    values         (n, c), NaN where there is none
    variances      (n, c) of the measuring noise: the stated one, and what repetitions show beyond it
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    variances: FloatArray


def columns_of(measurements: Measurements, *, figures: bool = True) -> Columns:
    """The columns of measurements in order of time; columns that few units have are left out."""
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
    """Standard deviation of repeated measurements of a unit beyond the stated one; 0 with few repetitions.

    From the differences of consecutive measurements, so a steady drift that all units share does not count;
    trends of single units are taken off by the caller.
    """
    known = np.isfinite(values)
    order = np.argsort(numbers[known], kind="stable")
    unit, y, sigma = numbers[known][order], values[known][order], sigmas[known][order]
    same = unit[1:] == unit[:-1]
    if same.sum() < FEWEST:
        return 0.0
    pairs = spread_of((y[1:] - y[:-1])[same], np.hypot(sigma[1:], sigma[:-1])[same])
    # Within its interval it is not distinguishable from zero.
    return pairs.spread / np.sqrt(2.0) if pairs.low > 0 else 0.0


def unit_numbers(serials: TextArray) -> np.ndarray:
    """A number for each serial number, by row."""
    return np.unique(serials, return_inverse=True)[1].reshape(-1)
