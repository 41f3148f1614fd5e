"""Robust mean and covariance of the true values of units, without measurement noise."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.spread import MEDIAN_DEVIATION

__all__ = ["decisive", "robust_location"]

# Maximum number of units from which mean and covariance are computed. From a larger fleet, a random sample of
# this size is taken.
MOST_UNITS: Final = 4000
# d^2 is the squared Mahalanobis distance of a unit. The first iterations use the share HALF of the units,
# those with the smallest d^2. The last iterations use all units whose d^2 is below the quantile KEPT of the
# distribution of d^2.
HALF: Final = 0.5
KEPT: Final = 0.975
# Number of iterations with the share HALF. The same number of iterations with the quantile KEPT follows.
STEPS: Final = 8


def decisive(units: int) -> np.ndarray:
    """Indices of the units from which mean and covariance are computed: all units, or a random sample."""
    return np.sort(np.random.default_rng(0).permutation(units)[:MOST_UNITS])


def robust_location(values: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the true values of units.

    values   (n, c), scaled to comparable widths
    noise    (n, c, c) covariances of the measurement noise

    The iteration starts from medians, median absolute deviations and rank correlations. The first steps use
    the half of the units with the smallest distances. The last steps use all units within the 97.5 % point of
    the distribution of the distances.
    """
    stats: Any = scipy_part("stats")
    columns = values.shape[1]
    mean_noise = noise.mean(axis=0)
    centre = np.median(values, axis=0)
    width = np.median(np.abs(values - centre), axis=0) / MEDIAN_DEVIATION
    ranks = stats.rankdata(values, axis=0)
    # This formula converts the correlation of ranks to the Pearson correlation of normally distributed
    # values.
    correlation = np.atleast_2d(2.0 * np.sin(np.pi / 6.0 * np.corrcoef(ranks, rowvar=False)))
    spread = _positive(correlation * width[:, None] * width[None, :] - mean_noise)
    for share in (*[HALF] * STEPS, *[KEPT] * STEPS):
        residuals = values - centre
        total = spread + noise
        distances = np.einsum("ni,ni->n", residuals, np.linalg.solve(total, residuals[:, :, None])[:, :, 0])
        if share == HALF:
            kept = distances <= np.quantile(distances, HALF)
        else:
            scale = np.median(distances) / stats.chi2.ppf(0.5, columns)
            kept = distances <= max(scale, 1.0) * stats.chi2.ppf(KEPT, columns)
        # The selected units lie inside an ellipsoid, so their covariance is smaller than that of all units.
        # For normally distributed values, multiplication by this factor corrects the difference.
        inside = share / stats.chi2.cdf(stats.chi2.ppf(share, columns), columns + 2)
        centre = values[kept].mean(axis=0)
        measured = inside * np.cov(values[kept], rowvar=False).reshape(columns, columns)
        spread = _positive(measured - noise[kept].mean(axis=0))
    return centre, spread


def _positive(matrix: FloatArray) -> FloatArray:
    """The symmetric matrix with all eigenvalues raised to at least a small positive number."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    floor = 1e-6 * max(float(values.max()), 1e-12)
    return np.asarray((vectors * np.maximum(values, floor)) @ vectors.T)
