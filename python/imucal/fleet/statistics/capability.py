"""Process capability of a fleet for given limits, and the share of units with true values outside them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.indices import Indices, capability_indices
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.spread import ODD_WIDTH, Spread, spread_of
from imucal.fleet.statistics.units_of_fleet import first_of_each_unit
from imucal.limits.limit import COUNTS, FigureLimit, ParameterLimit
from imucal.limits.limits import Limits

__all__ = ["Capability", "CapabilityResult", "capability", "proposed_limits"]

SCHEMA: Final = "imucal.fleet-capability/1"
# Proposed limits are the mean plus and minus this number of standard deviations of a measured value, as in
# `imucal limits template`. A good unit violates the limits of at least one of the 21 base parameters with a
# probability of 0.13 %.
DEVIATIONS: Final = 4.0
# A proposed `max_std` is the quantile STD_QUANTILE of the standard deviations of a parameter over the units,
# multiplied by STD_MARGIN.
STD_QUANTILE: Final = 0.99
STD_MARGIN: Final = 2.0
# Prefix of the names of figures of merit in a store, for each set of recordings from which they are computed.
PREFIX: Final = {"calibration_set": "", "control_set": "control_"}


@dataclass(frozen=True)
class Capability:
    """The capability of a parameter or a figure of merit for its limits.

    name, unit          name and unit of the parameter or figure of merit
    low, high           limits; None for a side without a limit
    units               number of units with a value
    indices             Cp, Cpk, Pp and Ppk of the measured values; None if there are no limits
    spread              spread of the true values; None for figures of merit, which have no standard deviation
    out_measured        share of the units whose measured value is outside the limits
    out_true            share of the units whose true value is outside the limits, computed from `spread`;
                        None for figures of merit
    out_low, out_high   95 % interval of `out_true`, computed from the interval of the spread
    proposed_low, proposed_high   proposed limits: mean -+ 4 standard deviations of a measured value
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    units: int
    indices: Indices | None
    spread: Spread | None
    out_measured: float | None
    out_true: float | None
    out_low: float | None
    out_high: float | None
    proposed_low: float
    proposed_high: float


@dataclass(frozen=True)
class CapabilityResult:
    """Capability of all parameters, and of the figures of merit that have a limit.

    units     number of units; the first calibration of each unit is used
    poor      number of units omitted because their calibration is poor
    rows      one row for each limit of a parameter or figure of merit, and one for each parameter without
              limits
    """

    units: int
    poor: int
    rows: tuple[Capability, ...]

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet capability --json`."""
        return {"schema": SCHEMA, **without_nan(self)}


def capability(measurements: Measurements, limits: Limits | None = None) -> CapabilityResult:
    """Capability of the first calibration of each unit.

    Without limits, the result contains only the spread and the proposed limits.

    Raises InputError for fewer than three units.
    """
    first, poor = first_of_each_unit(measurements)
    rows = []
    for column, (name, unit) in enumerate(zip(first.names, first.units, strict=True)):
        values, sigmas = first.values_si[:, column], first.sigmas_si[:, column]
        known = np.isfinite(values) & np.isfinite(sigmas)
        if known.sum() < 3:
            continue
        ranges = _ranges(limits, name, unit) or [(None, None)]
        spread = spread_of(values[known], sigmas[known])
        rows += [
            _capability(name, unit, low, high, values[known], sigmas[known], spread) for low, high in ranges
        ]
    for limit in () if limits is None else limits.figures:
        figure = first.figures.get(f"{PREFIX.get(limit.of, 'other_')}{limit.figure}")
        if figure is not None and np.isfinite(figure).sum() >= 3:
            rows.append(_of_figure(limit, figure[np.isfinite(figure)]))
    if not rows:
        raise InputError(
            f"no parameter has a value and a standard deviation for at least three of {len(first)} units"
        )
    return CapabilityResult(len(first), poor, tuple(rows))


def proposed_limits(result: CapabilityResult, measurements: Measurements) -> Limits:
    """A limits file with the proposed ranges, and with maximum standard deviations."""
    first, _ = first_of_each_unit(measurements)
    parameters = {}
    for row in result.rows:
        if row.spread is None or not row.proposed_low < row.proposed_high:
            continue
        sigmas = first.sigmas_si[:, first.names.index(row.name)]
        most = STD_MARGIN * float(np.nanquantile(sigmas, STD_QUANTILE))
        parameters[row.name] = ParameterLimit(
            row.name,
            row.unit,
            _rounded(row.proposed_low, row.spread.total),
            _rounded(row.proposed_high, row.spread.total),
            _rounded(most, most) or None,
        )
    return Limits(
        tuple(parameters.values()),
        description=f"mean +- {DEVIATIONS:g} sigma of a measured value, over {result.units} units",
    )


def _ranges(limits: Limits | None, name: str, unit: str) -> list[tuple[float | None, float | None]]:
    """The minimum and maximum (None if absent) of every limit that applies to a parameter."""
    found = [] if limits is None else [limit for limit in limits.parameters if limit.covers(name)]
    for limit in found:
        if limit.unit != unit:
            raise InputError(f"the limit of {limit.name} is in {limit.unit}, but {name} is in {unit}")
    return [(limit.low, limit.high) for limit in found if limit.low is not None]


def _capability(
    name: str,
    unit: str,
    low: float | None,
    high: float | None,
    values: FloatArray,
    sigmas: FloatArray,
    spread: Spread,
) -> Capability:
    half = DEVIATIONS * float(np.hypot(spread.spread, np.median(sigmas)))
    row = Capability(
        name,
        unit,
        low,
        high,
        len(values),
        None,
        spread,
        None,
        None,
        None,
        None,
        spread.mean - half,
        spread.mean + half,
    )
    if low is None and high is None:
        return row
    return replace(
        row,
        indices=capability_indices(values, low, high),
        out_measured=_outside(values, low, high),
        out_true=_tails(spread, spread.spread, low, high),
        out_low=_tails(spread, spread.low, low, high),
        out_high=_tails(spread, spread.high, low, high),
    )


def _of_figure(limit: FigureLimit, values: FloatArray) -> Capability:
    low, high = (limit.limit, None) if limit.figure in COUNTS else (None, limit.limit)
    mean, half = float(values.mean()), DEVIATIONS * float(values.std(ddof=1))
    return Capability(
        f"{limit.of} {limit.figure}",
        "",
        low,
        high,
        len(values),
        capability_indices(values, low, high) if half > 0 else None,
        None,
        _outside(values, low, high),
        None,
        None,
        None,
        mean - half,
        mean + half,
    )


def _outside(values: FloatArray, low: float | None, high: float | None) -> float:
    below = values < (-np.inf if low is None else low)
    return float((below | (values > (np.inf if high is None else high))).mean())


def _tails(spread: Spread, std: float, low: float | None, high: float | None) -> float:
    """Share of true values outside the limits, from the distributions of normal units and of outliers.

    std   standard deviation of the true values of normal units
    """
    norm = scipy_part("stats").norm

    def outside(width: float) -> float:
        scale = max(width, np.finfo(float).tiny)
        below = 0.0 if low is None else float(norm.cdf(low, spread.mean, scale))
        return below + (0.0 if high is None else float(norm.sf(high, spread.mean, scale)))

    return (1.0 - spread.odd) * outside(std) + spread.odd * outside(ODD_WIDTH * std)


def _rounded(number: float, scale: float) -> float:
    """`number` rounded to the decimal place of the third significant digit of `scale`."""
    return round(number, 2 - int(np.floor(np.log10(scale)))) if scale > 0 else number
