"""Process capability indices with confidence intervals.

    Cp = (high - low) / (6 s)      Cpk = min(high - mean, mean - low) / (3 s)

Here low and high are the limits, and s is the standard deviation of the values. The confidence interval of Cp
follows from the chi-square distribution, that of Cpk from Bissell's normal approximation (NIST/SEMATECH
e-Handbook of Statistical Methods, section 6.1.6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from imucal.errors import InputError
from imucal.fleet.statistics.scipy_part import scipy_part

__all__ = ["Index", "Indices", "capability_indices", "moving_range_std"]

# Mean range of two standard normal values (d2 of control charts): 2 / sqrt(pi).
MEAN_RANGE_OF_TWO: Final = 2.0 / math.sqrt(math.pi)
# The estimate of a standard deviation with k degrees of freedom has the relative variance 1 / (2 k). The
# estimate from the mean moving range of n values has the relative variance 0.826 / (n - 1) (Cryer and Ryan,
# Journal of Quality Technology 22, 1990), so it has (n - 1) / (2 x 0.826) effective degrees of freedom. The
# constant is the factor of (n - 1).
MOVING_RANGE_DOF: Final = 1.0 / (2.0 * 0.826)
# Minimum number of values for an index.
FEWEST_VALUES: Final = 2


@dataclass(frozen=True)
class Index:
    """A capability index, with the ends `low` and `high` of its confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Indices:
    """Capability indices. With a single limit, `cp` and `pp` are None.

    mean       mean of the values
    within     standard deviation estimated from the mean moving range |y_(k+1) - y_k|
    overall    standard deviation of all values
    cp, cpk    indices from `within`: capability of the process without changes over time
    pp, ppk    indices from `overall`: actual performance of the process
    """

    mean: float
    within: float
    overall: float
    cp: Index | None
    cpk: Index
    pp: Index | None
    ppk: Index


def moving_range_std(values: ArrayLike) -> float:
    """Standard deviation of values in order of time, from their mean moving range."""
    y = np.asarray(values, dtype=np.float64)
    if len(y) < FEWEST_VALUES:
        raise InputError(f"{len(y)} value has no moving range: two are needed")
    return float(np.abs(np.diff(y)).mean()) / MEAN_RANGE_OF_TWO


def capability_indices(
    values: ArrayLike, low: float | None, high: float | None, *, confidence: float = 0.95
) -> Indices:
    """Capability indices for one or two limits. The values are in order of time.

    Raises InputError without a limit, and for values without a spread.
    """
    y = np.asarray(values, dtype=np.float64)
    within = moving_range_std(y)
    mean, overall = float(y.mean()), float(y.std(ddof=1))
    if not overall > 0:
        raise InputError(f"all {len(y)} values are the same: they have no capability index")
    within = within or overall
    of_within = (mean, within, low, high, len(y), MOVING_RANGE_DOF * (len(y) - 1), confidence)
    of_overall = (mean, overall, low, high, len(y), len(y) - 1.0, confidence)
    return Indices(mean, within, overall, cp(*of_within), cpk(*of_within), cp(*of_overall), cpk(*of_overall))


def cp(
    mean: float,
    std: float,
    low: float | None,
    high: float | None,
    count: int,
    dof: float,
    confidence: float = 0.95,
) -> Index | None:
    """Cp of `count` values whose standard deviation has `dof` degrees of freedom; None for a single limit."""
    if low is None or high is None:
        return None
    chi2: Any = scipy_part("stats").chi2
    value = (high - low) / (6.0 * std)
    tail = 0.5 * (1.0 - confidence)
    return Index(
        value,
        value * math.sqrt(float(chi2.ppf(tail, dof)) / dof),
        value * math.sqrt(float(chi2.ppf(1.0 - tail, dof)) / dof),
    )


def cpk(
    mean: float,
    std: float,
    low: float | None,
    high: float | None,
    count: int,
    dof: float,
    confidence: float = 0.95,
) -> Index:
    """Cpk of `count` values whose standard deviation has `dof` degrees of freedom."""
    distances = [high - mean if high is not None else math.inf, mean - low if low is not None else math.inf]
    value = min(distances) / (3.0 * std)
    if math.isinf(value):
        raise InputError("there is no limit: a capability index needs one")
    quantile = float(scipy_part("stats").norm.ppf(0.5 + 0.5 * confidence))
    half = quantile * math.sqrt(1.0 / (9.0 * count) + value**2 / (2.0 * dof))
    return Index(value, value - half, value + half)
