"""Ageing of parameters: mean slope over time of all units, and of units by batch, station and temperature."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.columns import FEWEST, Columns
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.slopes import Slopes

__all__ = ["Ageing", "ageing_of"]

# False discovery rate: expected share of false alarms among the reported groups.
FALSE_DISCOVERIES: Final = 0.01
# Quantity whose terciles divide the units into three groups, in addition to the groups by batch and station.
TEMPERATURE: Final = "temperature_degc"


@dataclass(frozen=True)
class Ageing:
    """The mean slope of a parameter over a group of units.

    name, unit      name and unit of the parameter
    by              criterion of the group: "batch", "station" or "temperature"; "all" for all units
    group           name of the batch or station, or temperature range, degC, of a tercile (a third of the
                    units); empty for all units
    units           number of units
    slope, std      mean slope over the units, per month, and its standard deviation
    spread          standard deviation of the slope over the units, without measurement noise
    p_value         p-value. For all units, the null hypothesis is that the mean slope is zero. For a group,
                    it is that the mean slope of the group equals that of all other units
    q_value         p-value corrected for the number of parameters and groups
    is_significant  whether q_value is at most 1 %
    """

    name: str
    unit: str
    by: str
    group: str
    units: int
    slope: float
    std: float
    spread: float
    p_value: float
    q_value: float
    is_significant: bool


def ageing_of(dated: Measurements, columns: Columns, slopes: Slopes) -> tuple[Ageing, ...]:
    """Mean slope of each parameter over all units, and over each group with at least `FEWEST` units."""
    stats: Any = scipy_part("stats")
    groups = [("all", "", np.ones(len(slopes.first), dtype=bool)), *_groups(dated, slopes)]
    rows = []
    for column, (name, unit) in enumerate(zip(columns.names, columns.units, strict=True)):
        slope, std = slopes.slopes[:, column], slopes.stds[:, column]
        known = np.isfinite(slope) & np.isfinite(std)
        for by, group, members in groups:
            own, others = known & members, known & ~members
            if own.sum() < FEWEST or (by != "all" and others.sum() < FEWEST):
                continue
            mean, mean_std, spread = _mean_of(slope[own], std[own])
            difference, variance, dof = mean, mean_std**2, int(own.sum()) - 1
            if by != "all":
                other, other_std, _ = _mean_of(slope[others], std[others])
                difference, variance = mean - other, variance + other_std**2
                dof = min(dof, int(others.sum()) - 1)
            p_value = (
                float(2.0 * stats.t.sf(abs(difference) / np.sqrt(variance), dof)) if variance > 0 else 1.0
            )
            rows.append((name, unit, by, group, int(own.sum()), mean, mean_std, spread, p_value))
    if not rows:
        return ()
    q_values = stats.false_discovery_control([row[-1] for row in rows])
    aged = [
        Ageing(*row, float(q), bool(q <= FALSE_DISCOVERIES)) for row, q in zip(rows, q_values, strict=True)
    ]
    return tuple(sorted(aged, key=lambda row: row.p_value))


def _groups(dated: Measurements, slopes: Slopes) -> list[tuple[str, str, np.ndarray]]:
    """The groups of units to compare: units of one batch, units at one station, and temperature terciles.

    The terciles divide the units into three groups of about equal size by the mean temperature of their
    calibrations.
    """
    groups = []
    for by, labels in (("batch", dated.batches), ("station", dated.stations)):
        own = labels[slopes.first]
        groups += [(by, str(label), own == label) for label in np.unique(own) if label]
    if TEMPERATURE in dated.figures:
        of_row = dated.figures[TEMPERATURE]
        mean = np.array([_mean(of_row[rows]) for rows in slopes.rows])
        known = mean[np.isfinite(mean)]
        if len(known) >= 3 * FEWEST and known.max() > known.min():
            edges = np.quantile(known, (0.0, 1 / 3, 2 / 3, 1.0))
            for low, high in itertools.pairwise(edges.tolist()):
                members = (mean >= low) & ((mean <= high) if high == edges[-1] else (mean < high))
                groups.append(("temperature", f"{low:.1f} to {high:.1f} degC", members))
    return groups


def _mean_of(slopes: FloatArray, stds: FloatArray) -> tuple[float, float, float]:
    """Mean slope over units, its standard deviation, and the spread of the slopes without measurement noise.

    The spread is the moment estimate of DerSimonian and Laird (Controlled Clinical Trials 7, 1986). A unit
    has the weight 1 / (spread^2 + noise^2). If only a third of the units drifts, this mean is a third of
    their slope. A robust mean is not used, because it would be the zero slope of the majority.
    """
    weight = 1.0 / stds**2
    total = weight.sum()
    residual = slopes - (weight * slopes).sum() / total
    excess = float((weight * residual**2).sum()) - (len(slopes) - 1)
    variance = max(excess / float(total - (weight**2).sum() / total), 0.0)
    weight = 1.0 / (stds**2 + variance)
    mean = float((weight * slopes).sum() / weight.sum())
    # The standard deviation of the mean is computed from the observed scatter of the slopes. It is therefore
    # valid even if the estimates of noise and spread are wrong.
    std = np.sqrt(float((weight**2 * (slopes - mean) ** 2).sum())) / float(weight.sum())
    return mean, float(std), float(np.sqrt(variance))


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
