"""Spread of the true values of units without measurement noise, by restricted maximum likelihood.

    y_i = theta_i + e_i      theta_i ~ N(mean, spread^2),  e_i ~ N(0, sigma_i^2) with known sigma_i

y_i is the measured value of unit i, theta_i its true value, and e_i the measurement noise. The likelihood is
restricted, that is, integrated over the unknown mean. The plain likelihood underestimates the spread of few
units, as does a standard deviation with the divisor n.

A share of the units may be outliers, which belong to a second, ten times wider distribution with the same
mean. The share is estimated together with mean and spread, so that a few outliers do not widen the spread.
The share has a prior with the weight of NORMAL_UNITS additional units that are no outliers. Without the
prior, two nearly equal values among few units would be the normal units, with a spread near zero, and all
other units would be outliers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.fleet.statistics.scipy_part import scipy_part

__all__ = ["MEDIAN_DEVIATION", "Spread", "spread_of"]

# Standard deviation of the distribution of outliers, as a multiple of the standard deviation of normal units.
# With this multiple, a unit beyond about 4 standard deviations is more probably an outlier than a normal
# unit.
ODD_WIDTH: Final = 10.0
# Weight of the prior that units are normal (no outliers): the prior counts like this number of normal units.
NORMAL_UNITS: Final = 20
# Maximum number of iterations of the fit.
MOST_STEPS: Final = 200
# Relative change of the variance at which the iteration ends.
SETTLED: Final = 1e-9
# Minimum number of units from which a spread is estimated.
FEWEST_UNITS: Final = 3


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation of a parameter over units, without measurement noise.

    units        number of units with a value
    mean         mean over the units; mean_std is its standard deviation
    spread       standard deviation of the true values of the units
    low, high    95 % interval of the spread, by the likelihood ratio
    odd          estimated share of outliers
    noise        rms of the standard deviations of the measurements
    """

    units: int
    mean: float
    mean_std: float
    spread: float
    low: float
    high: float
    odd: float
    noise: float

    @property
    def total(self) -> float:
        """Standard deviation of a measured value, from spread and measurement noise together."""
        return math.hypot(self.spread, self.noise)


def spread_of(values: ArrayLike, sigmas: ArrayLike, *, interval: bool = True) -> Spread:
    """The spread of units with these measured values and standard deviations; NaN values are omitted.

    interval   whether to compute the interval, which takes as long as all other results; otherwise it is 0 to
               infinity

    Raises InputError for fewer than three values, and for a standard deviation that is negative or not known.
    """
    y, sigma = np.asarray(values, dtype=np.float64), np.asarray(sigmas, dtype=np.float64)
    known = np.isfinite(y)
    y, sigma = y[known], sigma[known]
    if len(y) < FEWEST_UNITS:
        raise InputError(f"{len(y)} units have a value: their spread needs {FEWEST_UNITS}")
    if not (np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise InputError(
            "a standard deviation is negative or not known: the spread needs all standard deviations"
        )
    # Values are divided by their robust width, so that the tolerances below are relative to this width.
    centre = float(np.median(y))
    width = float(np.median(np.abs(y - centre))) / MEDIAN_DEVIATION or float(y.std()) or 1.0
    y, noise = (y - centre) / width, (sigma / width) ** 2
    mean, variance, share, core = _fit(y, noise)
    low, high = _interval(y, noise, core, variance) if interval else (0.0, math.inf)
    total = variance + noise
    weights = np.divide(core, total, out=np.zeros_like(core), where=total > 0)
    mean_std = math.sqrt(1.0 / weights.sum()) if weights.sum() > 0 else 0.0
    return Spread(
        len(y),
        centre + width * mean,
        width * mean_std,
        width * math.sqrt(variance),
        width * math.sqrt(low),
        width * math.sqrt(high),
        share,
        width * math.sqrt(float(noise.mean())),
    )


# Median of |x| of a standard normal x.
MEDIAN_DEVIATION: Final = 0.6744897501960817


def _fit(y: FloatArray, noise: FloatArray) -> tuple[float, float, float, FloatArray]:
    """Mean, variance of the units, share of outliers, and probability that each unit is no outlier.

    Each iteration computes these probabilities, and then one step of Fisher scoring for mean and variance.
    """
    mean, variance, share = 0.0, max(1.0 - float(np.median(noise)), 0.0), 0.01
    core = np.ones_like(y)
    for _ in range(MOST_STEPS):
        total = np.maximum(variance + noise, TINY)
        wide = total + (ODD_WIDTH**2 - 1.0) * (variance + float(noise.mean()))
        normal = (1.0 - share) * np.exp(-0.5 * (y - mean) ** 2 / total) / np.sqrt(total)
        odd = share * np.exp(-0.5 * (y - mean) ** 2 / wide) / np.sqrt(wide)
        sum_of_both = normal + odd
        core = np.divide(normal, sum_of_both, out=np.zeros_like(y), where=sum_of_both > 0)
        share = float((1.0 - core).sum()) / (len(y) + NORMAL_UNITS)
        weights = core / total
        mean = float((weights * y).sum() / weights.sum())
        # `of_mean` is the part of the score that the restricted likelihood adds, because the mean is
        # estimated from the same values.
        of_mean = float((weights / total).sum() / weights.sum())
        score = float((core * ((y - mean) ** 2 - total) / total**2).sum()) + of_mean
        # The Fisher information of the variance is `squares - of_mean**2`. It can become zero or negative if
        # fewer than two units are normal, so half of `squares` is used as its lower bound.
        squares = float((core / total**2).sum())
        information = max(squares - of_mean**2, 0.5 * squares)
        before, variance = variance, max(variance + score / information, 0.0)
        if abs(variance - before) <= SETTLED * max(variance, 1.0):
            break
    return mean, variance, share, core


# Lower bound of the variance of a measured value, relative to the robust variance of all values. It prevents
# a division by zero if values without noise are equal in all units.
TINY: Final = 1e-24


def _interval(y: FloatArray, noise: FloatArray, core: FloatArray, variance: float) -> tuple[float, float]:
    """95 % interval of the variance of the true values, by the ratio of the restricted likelihoods.

    core, variance   results of `_fit`
    """
    optimize: Any = scipy_part("optimize")
    quarter = 0.5 * float(scipy_part("stats").chi2.ppf(0.95, 1))

    def log_likelihood(candidate: float) -> float:
        total = np.maximum(candidate + noise, TINY)
        weights = core / total
        mean = (weights * y).sum() / weights.sum()
        squares = core * (np.log(total) + (y - mean) ** 2 / total)
        return -0.5 * float(squares.sum() + np.log(weights.sum()))

    best = log_likelihood(variance)

    def excess(candidate: float) -> float:
        return best - log_likelihood(candidate) - quarter

    low = 0.0
    if variance > 0 and excess(0.0) > 0:
        low = float(optimize.brentq(excess, 0.0, variance, xtol=1e-6 * variance))
    end = 2.0 * variance + float(noise.mean()) + TINY
    while excess(end) < 0:
        end *= 2.0
    return low, float(optimize.brentq(excess, variance, end, xtol=1e-6 * end))
