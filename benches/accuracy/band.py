"""Bands of what a perfect estimator gives by chance.

A figure outside the band of 99 % of perfect estimators is printed bold. In a table of m figures m/100 of
those are expected, so a gate asks for the band that holds all figures of a table together with 99.9 %
(Bonferroni): of perfect estimators nearly all meet all gates.
"""

import numpy as np
from scipy.stats import binom, norm

BESIDE = 0.01
BESIDE_GATE = 0.001


def binomial(runs: int, share: float, beside: float) -> tuple[float, float]:
    """Shares of `runs` in which something of this probability happens, but for `beside` of all cases."""
    low, high = binom.interval(1.0 - beside, runs, share)
    return float(low) / runs, float(high) / runs


def one_sided(beside: float) -> float:
    """So many standard deviations are exceeded in `beside` of all cases."""
    return float(norm.isf(beside))


def two_sided(beside: float) -> float:
    """So many standard deviations either way are exceeded in `beside` of all cases."""
    return float(norm.isf(beside / 2.0))


def root_mean_square_error(runs: int) -> float:
    """Standard deviation of the root mean square of so many normal errors, as a share of it.

    It is that of a perfect estimator: one wild run must not widen the margin that it is judged with.
    """
    return 1.0 / float(np.sqrt(2.0 * runs))
