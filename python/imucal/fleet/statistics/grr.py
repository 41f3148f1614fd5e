"""Repeatability and reproducibility of a measurement by analysis of variance: units x operators x repeats.

    y_ijk = mean + unit_i + operator_j + (unit x operator)_ij + repeat_ijk       all random

y_ijk is repeat k of the measurement of unit i by operator j. The estimates are those of the ANOVA method of
the AIAG manual Measurement Systems Analysis, 4th edition, chapter III B. Each calibration states its standard
deviations. A comparison of these with the repeatability shows whether they are correct.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements, TextArray
from imucal.fleet.statistics.scipy_part import scipy_part

__all__ = ["AnovaRow", "Component", "GaugeStudy", "GrrResult", "SigmaTest", "gauge_study", "grr"]

SCHEMA: Final = "imucal.fleet-grr/1"
# The interaction of unit and operator is pooled with the repeats if its p-value is above this threshold,
# which is Minitab's default.
POOLED_ABOVE: Final = 0.05
# Factor in the number of distinct categories: sqrt(2) as rounded by the AIAG manual.
NDC_FACTOR: Final = 1.41


@dataclass(frozen=True)
class AnovaRow:
    """A source of variation in the analysis of variance; `f` and `p_value` are None for repeats and total."""

    source: str
    dof: int
    sum_of_squares: float
    mean_square: float
    f: float | None = None
    p_value: float | None = None


@dataclass(frozen=True)
class Component:
    """A component of variance.

    std               square root of the variance
    contribution      share of the total variance
    study_variation   share of the total standard deviation
    low, high         95 % interval of the standard deviation; None if it is not known
    """

    source: str
    variance: float
    std: float
    contribution: float
    study_variation: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class SigmaTest:
    """Repeatability compared with the stated standard deviations.

    factor      ratio of the repeatability to the rms of the stated standard deviations; 1 if these are
                correct
    low, high   95 % interval of the factor
    p_value     two-sided p-value under the null hypothesis that the stated standard deviations are correct
    stated      rms of the stated standard deviations
    """

    factor: float
    low: float
    high: float
    p_value: float
    stated: float

    @property
    def is_honest(self) -> bool:
        """Whether the 95 % interval of `factor` contains 1."""
        return self.low <= 1.0 <= self.high


@dataclass(frozen=True)
class GaugeStudy:
    """The repeatability and reproducibility (gauge study) of one quantity.

    name, unit     name and unit of the quantity
    table          analysis of variance; the interaction has a row even if it is pooled
    pooled         whether the interaction is not significant and therefore pooled with the repeats
    components     repeatability, operator, interaction, reproducibility (operator and interaction together),
                   grr (repeatability and reproducibility together), unit, total
    ndc            number of distinct categories, truncated to an integer; at least 5 is usually required
    tolerance      six times the standard deviation `grr`, divided by the width of the limits; None without
                   limits
    sigma          test of the stated standard deviations by the repeatability; None if none are stated
    """

    name: str
    unit: str
    table: tuple[AnovaRow, ...]
    pooled: bool
    components: tuple[Component, ...]
    ndc: int | None
    tolerance: float | None = None
    sigma: SigmaTest | None = None

    def component(self, source: str) -> Component:
        """The component of variance with this `source`, such as "unit"."""
        return next(component for component in self.components if component.source == source)


@dataclass(frozen=True)
class GrrResult:
    """A gauge study of each parameter.

    by          "operator" or "station"; the reproducibility describes the differences between operators or
                stations
    units, operators, repeats   size of the balanced study
    left_out    number of measurements that the balanced study does not use
    studies     one per parameter
    """

    by: str
    units: int
    operators: int
    repeats: int
    left_out: int
    studies: tuple[GaugeStudy, ...]

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet grr --json`."""
        return {"schema": SCHEMA, **without_nan(self)}


def gauge_study(
    values: ArrayLike,
    *,
    sigmas: ArrayLike | None = None,
    tolerance: float | None = None,
    name: str = "",
    unit: str = "",
    pooled_above: float = POOLED_ABOVE,
) -> GaugeStudy:
    """The gauge study of measured values, an array with the axes (units, operators, repeats).

    sigmas        stated standard deviations of the values
    tolerance     width of the limits
    pooled_above  p-value of the interaction above which the interaction is pooled with the repeats

    Raises InputError for fewer than two units, operators or repeats, and for values that are not finite.
    """
    y = np.asarray(values, dtype=np.float64)
    if y.ndim != 3 or min(y.shape) < 2:
        raise InputError(
            f"values have the shape {y.shape}: two or more units, operators and repeats are needed"
        )
    if not np.isfinite(y).all():
        raise InputError("a value is not finite: a gauge study needs all values")
    stats = scipy_part("stats")
    units, operators, repeats = y.shape
    mean, of_unit, of_operator, of_cell = y.mean(), y.mean((1, 2)), y.mean((0, 2)), y.mean(2)
    within = float(((y - of_cell[:, :, None]) ** 2).sum())
    squares = {
        "units": operators * repeats * float(((of_unit - mean) ** 2).sum()),
        "operators": units * repeats * float(((of_operator - mean) ** 2).sum()),
        "interaction": repeats
        * float(((of_cell - of_unit[:, None] - of_operator[None, :] + mean) ** 2).sum()),
        "repeats": within,
        "total": float(((y - mean) ** 2).sum()),
    }
    dof = {
        "units": units - 1,
        "operators": operators - 1,
        "interaction": (units - 1) * (operators - 1),
        "repeats": units * operators * (repeats - 1),
        "total": y.size - 1,
    }
    squared = {source: squares[source] / dof[source] for source in dof}
    interaction = _tested(stats, squared, dof, "interaction", "repeats")
    pooled = interaction[1] is None or interaction[1] > pooled_above
    error_dof, error = dof["repeats"], squared["repeats"]
    if pooled:
        error_dof += dof["interaction"]
        error = (squares["interaction"] + within) / error_dof
    # The denominator of the F tests is the pooled error if the interaction is pooled with the repeats, and
    # the interaction otherwise.
    against = {"error": error, **squared} if pooled else {"error": squared["interaction"], **squared}
    against_dof = {"error": error_dof if pooled else dof["interaction"], **dof}
    tests = {
        "units": _tested(stats, against, against_dof, "units", "error"),
        "operators": _tested(stats, against, against_dof, "operators", "error"),
        "interaction": interaction,
    }
    table = tuple(
        AnovaRow(source, dof[source], squares[source], squared[source], *tests.get(source, (None, None)))
        for source in dof
    )
    base = error if pooled else squared["interaction"]
    of_interaction = 0.0 if pooled else max(squared["interaction"] - error, 0.0) / repeats
    variances = {
        "repeatability": error,
        "operator": max(squared["operators"] - base, 0.0) / (units * repeats),
        "interaction": of_interaction,
        "unit": max(squared["units"] - base, 0.0) / (operators * repeats),
    }
    components = _components(stats, variances, error_dof)
    of_grr, of_units = (
        next(each.std for each in components if each.source == source) for source in ("grr", "unit")
    )
    return GaugeStudy(
        name,
        unit,
        table,
        pooled,
        components,
        int(NDC_FACTOR * of_units / of_grr) if of_grr > 0 else None,
        None if tolerance is None else 6.0 * of_grr / tolerance,
        None if sigmas is None else _sigma_test(stats, y - of_cell[:, :, None], np.asarray(sigmas)),
    )


def grr(
    measurements: Measurements, *, by: str = "operator", tolerances: Mapping[str, float] | None = None
) -> GrrResult:
    """Gauge studies of all parameters, from units that each operator (or station) has measured repeatedly.

    by           "operator" or "station"
    tolerances   width of the limits, by parameter

    Only units that every operator has measured at least twice are used. If the numbers of repeats differ, the
    first n repeats are used, where n is the smallest number. Raises InputError if no balanced study remains.
    """
    factors = {"operator": measurements.operators, "station": measurements.stations}
    if by not in factors:
        raise InputError(f"by is {by!r}: give operator or station")
    rows = _balanced(measurements.serials, factors[by], by)
    units, operators, repeats = rows.shape
    studies = []
    for column, (name, unit) in enumerate(zip(measurements.names, measurements.units, strict=True)):
        values, sigmas = measurements.values_si[rows, column], measurements.sigmas_si[rows, column]
        if np.isfinite(values).all():
            known = bool(np.isfinite(sigmas).all() and (sigmas > 0).all())
            studies.append(
                gauge_study(
                    values,
                    sigmas=sigmas if known else None,
                    tolerance=(tolerances or {}).get(name),
                    name=name,
                    unit=unit,
                )
            )
    left_out = len(measurements) - rows.size
    return GrrResult(by, units, operators, repeats, left_out, tuple(studies))


def _balanced(serials: TextArray, operators: TextArray, by: str) -> Any:
    """Row indices of the balanced study, as an array with the axes (units, operators, repeats)."""
    cells: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(serials.tolist(), operators.tolist(), strict=True)):
        if key[1]:
            cells.setdefault(key, []).append(row)
    repeated = [key for key, rows in cells.items() if len(rows) >= 2]
    names = sorted({operator for _, operator in repeated})
    complete = [
        serial
        for serial in sorted({serial for serial, _ in repeated})
        if all(len(cells.get((serial, name), ())) >= 2 for name in names)
    ]
    if len(names) < 2 or len(complete) < 2:
        raise InputError(
            f"a gauge study needs two or more units that two or more {by}s have each measured twice or more: "
            f"{len(complete)} units are complete for {len(names)} {by}s: select the measurements of the "
            f"study{' by role' if names else f', and name each {by} in the manifest'}"
        )
    repeats = min(len(cells[serial, name]) for serial in complete for name in names)
    return np.array([[cells[serial, name][:repeats] for name in names] for serial in complete])


def _tested(
    stats: Any, squares: dict[str, float], dof: dict[str, int], source: str, against: str
) -> tuple[float | None, float | None]:
    """F, the ratio of the mean squares of `source` and `against`, and its p-value; None if F is infinite."""
    if squares[against] <= 0:
        return None, None
    f = squares[source] / squares[against]
    return f, float(stats.f.sf(f, dof[source], dof[against]))


def _components(stats: Any, variances: dict[str, float], error_dof: int) -> tuple[Component, ...]:
    reproducibility = variances["operator"] + variances["interaction"]
    all_of_them = {
        "repeatability": variances["repeatability"],
        "operator": variances["operator"],
        "interaction": variances["interaction"],
        "reproducibility": reproducibility,
        "grr": variances["repeatability"] + reproducibility,
        "unit": variances["unit"],
        "total": variances["repeatability"] + reproducibility + variances["unit"],
    }
    total = all_of_them["total"]

    def component(source: str, variance: float) -> Component:
        limits: tuple[float | None, float | None] = (None, None)
        if source == "repeatability":
            squares = variance * error_dof
            limits = (
                math.sqrt(squares / float(stats.chi2.ppf(0.975, error_dof))),
                math.sqrt(squares / float(stats.chi2.ppf(0.025, error_dof))),
            )
        share = variance / total if total > 0 else 0.0
        return Component(source, variance, math.sqrt(variance), share, math.sqrt(share), *limits)

    return tuple(component(source, variance) for source, variance in all_of_them.items())


def _sigma_test(stats: Any, residuals: FloatArray, sigmas: FloatArray) -> SigmaTest:
    """Chi-square test of the stated standard deviations.

    The residuals are the repeats of one unit by one operator, relative to the mean of these repeats.
    """
    units, operators, repeats = residuals.shape
    dof = units * operators * (repeats - 1)
    # The stated variances differ little between the repeats of one unit by one operator (a cell), so the mean
    # variance of each cell is used.
    chi2 = float((residuals**2 / (sigmas**2).mean(2, keepdims=True)).sum())
    tail = float(stats.chi2.cdf(chi2, dof))
    return SigmaTest(
        math.sqrt(chi2 / dof),
        math.sqrt(chi2 / float(stats.chi2.ppf(0.975, dof))),
        math.sqrt(chi2 / float(stats.chi2.ppf(0.025, dof))),
        2.0 * min(tail, float(stats.chi2.sf(chi2, dof))),
        math.sqrt(float((sigmas**2).mean())),
    )
