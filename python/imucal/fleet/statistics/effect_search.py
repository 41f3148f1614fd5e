"""Search for effects over all units together, which detects effects too small for a single unit.

    theta_i = mean + deviation_i + e_i      e_i ~ N(0, C_i), the covariance of the fit of unit i

theta_i are the parameters of the effect that were estimated for unit i, and mean + deviation_i are their true
values. The statistic is 2 ln(L / L_0). L is the likelihood of a model in which the effect has a mean and a
spread over the units. L_0 is the likelihood of a model without the effect. In a large fleet, standard
deviations that are slightly too small would make every effect significant. The stated variances are therefore
multiplied by a factor, estimated from all effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.effects.table import catalogue, find
from imucal.errors import InputError
from imucal.fleet.statistics.clusters import Cluster, clusters_of
from imucal.fleet.statistics.fitted_effects import Fitted
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.spread import spread_of

__all__ = ["EffectEvidence", "FleetGap", "MeanParameter", "effect_search", "searchable"]

SCHEMA: Final = "imucal.fleet-gap/1"
# Probability that any effect is reported as significant if there is no effect.
FALSE_ALARM: Final = 0.001
# A significant effect is a rival of the best effect if their statistics 2 ln(L / L_0) differ by less than
# this number.
RIVAL_WITHIN: Final = 10.0
# Maximum number of effects that are accepted one after the other.
MOST_ROUNDS: Final = 3
# Minimum number of units whose recordings determine an effect. An effect of fewer units is not tested.
FEWEST_UNITS: Final = 5
# Type of a function that fits effects to all units and returns {serial: {effect: fit}}. The effects of the
# first argument are fitted one at a time. In each of these fits, the effects of the second argument are
# estimated, too.
FitAll = Callable[[Sequence[str], Sequence[str]], Mapping[str, Mapping[str, Fitted]]]


@dataclass(frozen=True)
class MeanParameter:
    """The distribution of one parameter of an effect over the units.

    mean, mean_std   mean over the units, and its standard deviation
    spread           standard deviation over the units, after subtraction of the noise of their fits
    low, high        95 % interval of the spread
    noise            standard deviation of the parameter in the fit of one unit, rms over the units
    """

    name: str
    unit: str
    mean: float
    mean_std: float
    spread: float
    low: float
    high: float
    noise: float


@dataclass(frozen=True)
class EffectEvidence:
    """The evidence for one effect over all units.

    units            number of units whose recordings determine the effect
    alone            number of units whose own data are sufficient to make the effect significant
    statistic        2 ln(likelihood ratio). It has two degrees of freedom (`dof`) per parameter: its mean and
                     its spread
    p_value          p-value corrected for the number of effects
    is_significant   whether p_value is below 0.1 %
    rivals           effects that explain the data of the units about equally well
    beside           effects that were estimated together with this effect
    """

    name: str
    sensor: str
    units: int
    alone: int
    statistic: float
    dof: int
    p_value: float
    is_significant: bool
    parameters: tuple[MeanParameter, ...]
    rivals: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class FleetGap:
    """Result of the search for effects over the units of a fleet.

    units      number of units whose recordings were searched
    unread     number of units in which no effect could be fitted
    inflation  factor by which the stated variances are multiplied, estimated from the chi2 of all effects; 1
               if the stated variances are right
    effects    significant effects, in the order in which they were accepted
    ranking    all effects, the most significant first, as ranked before any effect was accepted
    clusters   for each temperature effect, groups of units whose coefficients differ; none if all units form
               one group
    """

    units: int
    unread: int
    inflation: float
    effects: tuple[EffectEvidence, ...]
    ranking: tuple[EffectEvidence, ...]
    clusters: tuple[Cluster, ...]

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet gap --json`."""
        return {"schema": SCHEMA, **without_nan(self)}


def searchable(names: Sequence[str] | None = None) -> tuple[str, ...]:
    """The effects to search; without names, all effects of the catalogue that act on a sensor.

    Raises InputError for an unknown name.
    """
    if names:
        return tuple(find(name).name for name in names)
    return tuple(effect.name for effect in catalogue() if effect.sensor != "encoder")


def effect_search(fit_all: FitAll, effects: Sequence[str]) -> FleetGap:
    """Accept up to three effects one after the other, each by its significance over all units together.

    fit_all   function that fits effects to the recordings of all units, see `FitAll`
    """
    fits = fit_all(effects, ())
    fitted = [serial for serial, of_unit in fits.items() if of_unit]
    if len(fitted) < FEWEST_UNITS:
        raise InputError(
            f"{len(fitted)} of {len(fits)} units determine an effect: a search over units needs "
            f"{FEWEST_UNITS}"
        )
    inflation, ranking = _ranked(fits, effects, len(effects))
    accepted: list[EffectEvidence] = []
    current = ranking
    while current and current[0].is_significant and len(accepted) < MOST_ROUNDS:
        best = current[0]
        rivals = tuple(
            other.name
            for other in current[1:]
            if other.is_significant and best.statistic - other.statistic < RIVAL_WITHIN
        )
        accepted.append(replace(best, rivals=rivals))
        open_effects = [row.name for row in current[1:] if row.is_significant and row.name not in rivals]
        if not open_effects:
            break
        beside = tuple(each.name for each in accepted)
        _, current = _ranked(fit_all(open_effects, beside), open_effects, len(effects), inflation, beside)
    return FleetGap(
        len(fits),
        len(fits) - len(fitted),
        inflation,
        tuple(accepted),
        ranking,
        _thermal(fits, effects),
    )


def _ranked(
    fits: Mapping[str, Mapping[str, Fitted]],
    effects: Iterable[str],
    tests: int,
    inflation: float | None = None,
    beside: tuple[str, ...] = (),
) -> tuple[float, tuple[EffectEvidence, ...]]:
    """The factor by which the stated variances are multiplied, and the evidence for each effect.

    Effects that are determined by the recordings of too few units are omitted.

    tests       number of effects for which the p-values are corrected
    inflation   the factor; None to estimate it
    """
    of_effect = {}
    for name in effects:
        own = [of_unit[name] for of_unit in fits.values() if name in of_unit]
        sizes = [len(fitted.values) for fitted in own]
        # The recordings of different units may determine different numbers of the effect's parameters. Only
        # units with the most frequent number are used.
        size = max(set(sizes), key=sizes.count) if sizes else 0
        own = [fitted for fitted in own if len(fitted.values) == size]
        if len(own) >= FEWEST_UNITS:
            of_effect[name] = np.array([f.values for f in own]), np.array([f.covariance for f in own])
    totals = {name: _squares(*arrays) for name, arrays in of_effect.items()}
    if inflation is None:
        per_dof = [float(np.median(totals[n])) / _median(of_effect[n][0].shape[1]) for n in totals]
        inflation = max(float(np.median(per_dof)), 1.0) if len(per_dof) > 2 else 1.0
    evidence = [
        _evidence(name, *arrays, totals[name], tests, inflation, beside) for name, arrays in of_effect.items()
    ]
    return inflation, tuple(sorted(evidence, key=lambda row: -row.statistic))


def _evidence(
    name: str,
    values: FloatArray,
    covariances: FloatArray,
    squares: FloatArray,
    tests: int,
    inflation: float,
    beside: tuple[str, ...],
) -> EffectEvidence:
    stats: Any = scipy_part("stats")
    units, dof = values.shape
    sigmas = np.sqrt(inflation * np.einsum("nii->ni", covariances))
    effect = find(name)
    parameters = []
    for column, parameter in enumerate(effect.parameters[:dof]):
        own = spread_of(values[:, column], sigmas[:, column])
        parameters.append(
            MeanParameter(
                parameter.name,
                parameter.unit,
                own.mean,
                own.mean_std,
                own.spread,
                own.low,
                own.high,
                own.noise,
            )
        )
    noise = inflation * covariances
    total = noise + np.diag([parameter.spread**2 for parameter in parameters])
    weights = np.linalg.inv(total)
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("nij,nj->i", weights, values))
    statistic = float(
        _squares(values, noise).sum()
        + np.linalg.slogdet(noise)[1].sum()
        - _squares(values - mean, total).sum()
        - np.linalg.slogdet(total)[1].sum()
    )
    # Each parameter has two degrees of freedom: its mean and its variance between units. The chi-square
    # distribution with these degrees of freedom would be exact if the estimate of the variance could also be
    # negative. The estimate here cannot be negative, so the test is slightly conservative.
    p_value = min(tests * float(stats.chi2.sf(statistic, 2 * dof)), 1.0)
    single = stats.chi2.sf(squares / inflation, dof) * units * tests
    return EffectEvidence(
        name,
        effect.sensor,
        units,
        int((single < FALSE_ALARM).sum()),
        statistic,
        2 * dof,
        p_value,
        p_value < FALSE_ALARM,
        tuple(parameters),
        (),
        beside,
    )


def _squares(values: FloatArray, covariances: FloatArray) -> FloatArray:
    solved = np.linalg.solve(covariances, values[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ni,ni->n", values, solved))


def _median(dof: int) -> float:
    return float(scipy_part("stats").chi2.ppf(0.5, dof))


def _thermal(fits: Mapping[str, Mapping[str, Fitted]], effects: Sequence[str]) -> tuple[Cluster, ...]:
    """Clusters of units with different coefficients, for each temperature effect."""
    found: list[Cluster] = []
    for name in effects:
        if "temperature" not in find(name).needs:
            continue
        own = {serial: of_unit[name] for serial, of_unit in fits.items() if name in of_unit}
        sizes = {len(fitted.values) for fitted in own.values()}
        if len(sizes) == 1:
            values = np.array([fitted.values for fitted in own.values()])
            found += clusters_of(name, tuple(own), values)
    return tuple(found)
