"""Groups of units whose temperature curves differ, for example because the sensors are of two lots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.statistics.scipy_part import scipy_part

__all__ = ["Cluster", "clusters_of"]

MOST_CLUSTERS: Final = 4
# Minimum number of units in a cluster. A partition that contains a smaller cluster is rejected.
FEWEST_UNITS: Final = 5
SEED: Final = 0


@dataclass(frozen=True)
class Cluster:
    """A group of units with similar coefficients of a temperature effect.

    effect    name of the effect
    serials   serial numbers of the units
    centre    mean of each coefficient, in SI units
    """

    effect: str
    serials: tuple[str, ...]
    centre: tuple[float, ...]


def clusters_of(effect: str, serials: tuple[str, ...], values: FloatArray) -> list[Cluster]:
    """Two to four clusters of the units by k-means; empty if one cluster describes the units better.

    values   (n, k) coefficients

    The number of clusters minimises the Bayesian information criterion of normally distributed clusters of
    equal widths. The criterion includes a term for the assignment of the units to clusters. If a single
    normally distributed group is split into halves, the fit term decreases, because the halves are narrower,
    but the assignment term increases by more. Such a group is therefore not split.
    """
    if len(values) < 2 * FEWEST_UNITS:
        return []
    width = np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    scaled = values / np.where(width > 0, width, 1.0)
    best_criterion, best_labels = _criterion(scaled, np.zeros(len(values), dtype=int)), None
    for count in range(2, MOST_CLUSTERS + 1):
        _, labels = scipy_part("cluster.vq").kmeans2(scaled, count, minit="++", rng=SEED, iter=50)
        sizes = np.bincount(labels, minlength=count)
        if sizes.min() >= FEWEST_UNITS and (criterion := _criterion(scaled, labels)) < best_criterion:
            best_criterion, best_labels = criterion, labels
    if best_labels is None:
        return []
    return [
        Cluster(
            effect,
            tuple(serial for serial, own in zip(serials, best_labels, strict=True) if own == label),
            tuple(values[best_labels == label].mean(axis=0).tolist()),
        )
        for label in np.unique(best_labels)
    ]


def _criterion(values: FloatArray, labels: np.ndarray) -> float:
    """Bayesian information criterion of clusters that have a common standard deviation in each column."""
    units, columns = values.shape
    numbers, own, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    centres = np.array([values[labels == number].mean(axis=0) for number in numbers])
    variances = ((values - centres[own]) ** 2).mean(axis=0)
    fit = units * float(np.log(np.maximum(variances, 1e-300)).sum())
    labelling = -2.0 * float((sizes * np.log(sizes / units)).sum())
    return float(fit + labelling + len(numbers) * (columns + 1) * np.log(units))
