"""Finding the missing effect: where simulation and measurement disagree, what explains it, and what is left.

    gap = imucal.find_gap(run, control=control)
    gap.verdict, gap.effects, gap.calibration, gap.next_motion

The recordings are calibrated with the 21 parameters alone; every effect of the catalogue, and every effect of
one's own, is scored by its evidence (docs/model.md (23)); the best one joins, all is fitted again, until
nothing is left. Recordings that no fit has seen decide whether an effect may stay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.calibrate import Options, calibrate, fields_for_library
from imucal.calibration import Calibration
from imucal.calibration_result import CalibrationResult
from imucal.disturbances import disturbances
from imucal.document import plain, without_nan
from imucal.effects import Effect, UserEffect, catalogue, find
from imucal.errors import FitError, InputError, NotEnoughMotionError
from imucal.evaluate import MIN_REST_S
from imucal.finding import Finding
from imucal.gap_rules import faults_without_effect, mount_slips
from imucal.recording import STANDARD_GRAVITY_MPS2, Recording

if TYPE_CHECKING:
    from imucal import _core

__all__ = ["Gap", "find_gap"]

SCHEMA: Final = "imucal.gap/1"
FOLDS: Final = 3
FIGURES: Final = ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")
# Figures of two fits that differ by less than this share are the same.
SAME: Final = 0.005
# By so many standard deviations a known number is met, and is determined.
SURE: Final = 3.0


@dataclass(frozen=True, eq=False)
class Gap:
    """What the search has found.

    verdict            nothing_missing, named, ambiguous, stochastic, unknown or data_fault
    effects            what joined the model, or the faults: name, sensor, parameters (name, value, std,
                       unit), log_bayes_factor, statistic, dof, p_value
    ambiguous_with     rivals of the pick
    resembles          what an unknown effect looks a little like
    generic            block, kernel and description of what varies without a name, or None
    not_observable     name and needs of the effects that these recordings cannot show
    smallest_visible   by effect, the smallest rms size of a parameter that would have been seen, and its unit
    next_motion        description and program of the motion that would decide, or None
    gap                metric, before, after, floor, closed, on recordings that no fit has seen
    calibration_set, control_set   figures before and after
    calibration        the improved calibration, or the plain one if nothing was found; None for a data fault
    ranking            all candidates against the plain model, best first
    notes              what a careful reader should know
    """

    verdict: str
    effects: tuple[Mapping[str, Any], ...] = ()
    ambiguous_with: tuple[str, ...] = ()
    resembles: tuple[str, ...] = ()
    generic: Mapping[str, Any] | None = None
    not_observable: tuple[Mapping[str, str], ...] = ()
    smallest_visible: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    next_motion: Mapping[str, Any] | None = None
    gap: Mapping[str, Any] | None = None
    calibration_set: Mapping[str, Any] | None = None
    control_set: Mapping[str, Any] | None = None
    calibration: Calibration | None = None
    ranking: tuple[Mapping[str, Any], ...] = ()
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """What notebooks show."""
        from imucal.report.notebook import of_gap

        return of_gap(self)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal gap --json`."""
        names = (
            "verdict",
            "effects",
            "ambiguous_with",
            "resembles",
            "generic",
            "not_observable",
            "smallest_visible",
            "next_motion",
            "gap",
            "calibration_set",
            "control_set",
            "ranking",
            "notes",
        )
        document = {"schema": SCHEMA, **{name: without_nan(getattr(self, name)) for name in names}}
        document["findings"] = without_nan([finding.to_dict() for finding in self.findings])
        return dict(plain(document))

    def explain(self, name: str) -> list[str]:
        """What an effect is, and what these recordings show or could have shown of it.

        Raises InputError for a name that is not in the catalogue.
        """
        from imucal.gap_text import explanation

        return list(explanation(self, name))

    def summary(self) -> str:
        """The finding in sentences."""
        from imucal.gap_text import sentences

        return "\n".join(sentences(self))


def find_gap(
    recordings: Recording | Sequence[Recording],
    *,
    control: Recording | Sequence[Recording] | None = None,
    calibration: Calibration | None = None,
    candidates: Sequence[str] | None = None,
    user_effects: Sequence[UserEffect] = (),
    gravity_mps2: float | None = None,
    min_rest_s: float = MIN_REST_S,
    exclude_saturated: bool = False,
) -> Gap:
    """Find where the recordings disagree with the model, name the effect that is missing, and add it.

    control       recordings that only judge; without them moves are held out, in three folds
    calibration   the calibration that is judged; without it one is made of the recordings
    candidates    names of the catalogue to look for; all of them if not given
    user_effects  effects of one's own to look for

    Raises as `calibrate`, but for faults of the data: those are a verdict.
    """
    gravity = (
        gravity_mps2
        if gravity_mps2 is not None
        else (STANDARD_GRAVITY_MPS2 if calibration is None else calibration.gravity_mps2)
    )
    unit_data = [recordings] if isinstance(recordings, Recording) else list(recordings)
    judges = None if control is None else ([control] if isinstance(control, Recording) else list(control))
    named = {effect.name: effect for effect in user_effects}
    trial = _Trial(unit_data, judges, gravity, min_rest_s, exclude_saturated, named)
    try:
        before = trial.fit(())
    except InputError as error:
        if not error.findings:
            raise
        return _data_fault(error.findings)
    wanted = [find(name).name for name in candidates] if candidates is not None else None
    found = trial.search(before, wanted)
    refused = _no_earth_rate(trial, found)
    if refused is not None:
        others = wanted if wanted is not None else [effect.name for effect in catalogue()]
        found = trial.search(before, [name for name in others if name != "earth_rate"])
    path, after, notes = trial.accepted(before, [score.name for score in found.path])
    notes += [] if refused is None else [refused]
    notes += [
        f"{name} fits these recordings (log Bayes factor {evidence:.1f}) and does not predict rests and "
        f"moves that are held out: {gain:.1f} +- {std:.1f} nats"
        for name, evidence, gain, std in found.not_predictive
    ]
    return _result(trial, found, path, before, after, calibration, notes)


class _Trial:
    """The recordings, and how models of them are judged."""

    def __init__(
        self,
        unit_data: Sequence[Recording],
        judges: Sequence[Recording] | None,
        gravity_mps2: float,
        min_rest_s: float,
        exclude_saturated: bool,
        user_effects: Mapping[str, UserEffect],
    ) -> None:
        self.unit_data, self.judges, self.user_effects = unit_data, judges, user_effects
        self.gravity_mps2, self.min_rest_s = gravity_mps2, min_rest_s
        self.exclude_saturated = exclude_saturated
        self._fits: dict[tuple[str, ...], CalibrationResult] = {}

    def fit(self, names: Sequence[str]) -> CalibrationResult:
        """The calibration with these effects, judged on the control recordings or on held-out moves."""
        key = tuple(names)
        if key not in self._fits:
            self._fits[key] = self._fit(key)
        return self._fits[key]

    def _fit(self, names: tuple[str, ...]) -> CalibrationResult:
        return calibrate(
            list(self.unit_data),
            control=None if self.judges is None else list(self.judges),
            gravity_mps2=self.gravity_mps2,
            min_rest_s=self.min_rest_s,
            exclude_saturated=self.exclude_saturated,
            effects=[self.user_effects.get(name, name) for name in names],
            folds=FOLDS if self.judges is None else None,
        )

    def search(self, before: CalibrationResult, wanted: Sequence[str] | None) -> _core.Search:
        from imucal import _core

        names = wanted if wanted is not None else [effect.name for effect in catalogue()]
        options = Options(self.gravity_mps2, "symmetric", self.min_rest_s, self.exclude_saturated, None, None)
        fields = fields_for_library(before.calibration, self.unit_data, tuple(self.user_effects.values()))
        return _core.search_gap(self.unit_data, options, [(name, False) for name in names], fields)

    def metric(self, result: CalibrationResult) -> tuple[str, float, float]:
        """Name, value and floor of the figure on what no fit has seen."""
        if result.control_set is not None:
            return "chi2_per_dof", float(result.control_set["chi2_per_dof"]), 1.0
        held_out = result.held_out or {}
        # Noise alone leaves the standard deviation of both components.
        sigma = [m["direction_sigma_deg"] for m in result.moves if m["direction_sigma_deg"] is not None]
        floor = float(np.sqrt(2.0 * np.mean(np.square(sigma)))) if sigma else 0.0
        return "held_out_gravity_direction_rms_deg", float(held_out["gravity_direction_rms_deg"]), floor

    def accepted(
        self, before: CalibrationResult, path: Sequence[str]
    ) -> tuple[list[str], CalibrationResult, list[str]]:
        """The effects that do not make the unseen recordings worse, with the fit that has them."""
        notes: list[str] = []
        names: list[str] = []
        best = before
        for name in path:
            try:
                trial = self.fit([*names, name])
            except (FitError, NotEnoughMotionError) as error:
                notes.append(f"{name} was found and cannot be fitted: {error}")
                continue
            metric, value, _ = self.metric(trial)
            if value > self.metric(best)[1] * (1 + SAME):
                notes.append(
                    f"{name} was found and left out: {metric} of what no fit has seen goes from "
                    f"{self.metric(best)[1]:.4g} to {value:.4g}"
                )
                continue
            names.append(name)
            best = trial
        if len(names) < len(path):
            # What does not help alone may help together.
            try:
                whole = self.fit(path)
            except (FitError, NotEnoughMotionError):
                return names, best, notes
            if self.metric(whole)[1] < self.metric(best)[1]:
                return list(path), whole, []
        return names, best, notes


def _no_earth_rate(trial: _Trial, found: _core.Search) -> str | None:
    """Why what was named earth_rate is not it: the rate of the Earth is known; None if it may be.

    Its direction is free, for the heading is not known and every latitude is possible.
    """
    path = [score.name for score in found.path]
    if "earth_rate" not in path:
        return None
    try:
        calibration = trial.fit(path).calibration
    except (FitError, NotEnoughMotionError) as error:
        return f"earth_rate was found and cannot be fitted: {error}"
    own = [k for k, name in enumerate(calibration.covariance_names) if name.startswith("earth_rate_")]
    values = next(values for values in calibration.effects if values.name == "earth_rate").values
    size, known = float(np.linalg.norm(values)), find("earth_rate").parameters[0].typical
    direction = np.asarray(values) / size
    sigma = float(np.sqrt(direction @ np.asarray(calibration.covariance)[np.ix_(own, own)] @ direction))
    if abs(size - known) <= SURE * sigma and sigma <= known / SURE:
        return None
    return (
        f"earth_rate fits these recordings with {size:.3g} +- {sigma:.1g} rad/s, and the Earth turns with "
        f"{known:.4g}: something else is there, or they do not determine it"
    )


def _data_fault(findings: Sequence[Finding]) -> Gap:
    codes = list(dict.fromkeys(finding.code for finding in findings))
    effects = tuple({"name": code, "sensor": None, "parameters": ()} for code in codes)
    return Gap("data_fault", effects=effects, findings=tuple(findings), notes=tuple(str(f) for f in findings))


def _result(
    trial: _Trial,
    found: _core.Search,
    path: Sequence[str],
    before: CalibrationResult,
    after: CalibrationResult,
    calibration: Calibration | None,
    notes: Sequence[str],
) -> Gap:
    from imucal.next_motion import next_motion

    scores = {score.name: score for score in found.path}
    # Faults of the data explain a disagreement before any effect does.
    rules = {row.name for row in disturbances() if row.kind == "fault"}
    faults = [finding for finding in before.findings if finding.code in rules]
    slips = list(mount_slips(before, trial.unit_data))
    rivals = tuple(
        dict.fromkeys(rival for name in path for rival in scores[name].rivals if rival not in path)
    )
    effects: tuple[Mapping[str, Any], ...] = tuple(
        _named(after, name, scores[name], trial.user_effects) for name in path
    )
    # Samples at a rail or twice disturb noise and moves by themselves.
    spoilt = {fault.code for fault in faults} - {"clock_irregular", "samples_missing"}
    if not slips and not path and found.generic is None and not spoilt:
        faults += faults_without_effect(before, trial.unit_data)
    if any(fault.code == "clock_irregular" for fault in faults):
        # With such a clock long steps say nothing of lost samples.
        faults = [fault for fault in faults if fault.code != "samples_missing"]
    if slips:
        verdict, effects = "data_fault", _data_fault([*slips, *faults]).effects
    elif found.generic is not None:
        verdict = "stochastic" if found.generic.kernel == "random_walk" else "unknown"
    elif path and found.scattering_rests is None:
        verdict = "ambiguous" if rivals else "named"
    elif faults and not path:
        verdict, effects = "data_fault", _data_fault(faults).effects
    elif found.scattering_rests is not None:
        verdict = "unknown"
    else:
        verdict = "nothing_missing"
    if verdict not in ("named", "ambiguous"):
        after = before
    said = [f for f in (*slips, *faults) if f not in after.findings] if verdict == "data_fault" else []
    metric, value, floor = trial.metric(before)
    if calibration is not None and trial.judges is not None:
        from imucal.evaluate import evaluate

        value = float(evaluate(calibration, list(trial.judges)).figures["chi2_per_dof"])
    left = trial.metric(after)[1]
    closed = (value - left) / (value - floor) if value > floor else 0.0
    more = [found.in_motion_left_out] if found.in_motion_left_out else []
    return Gap(
        verdict,
        effects=effects if verdict in ("named", "ambiguous", "data_fault") else (),
        ambiguous_with=rivals if verdict == "ambiguous" else (),
        resembles=tuple(s.name for s in found.ranking[:3] if s.log_bayes_factor > 0)
        if verdict == "unknown"
        else (),
        generic=_generic(found.generic)
        or (_scatter(found.scattering_rests) if verdict == "unknown" else None),
        not_observable=tuple({"name": name, "needs": needs} for name, needs in found.not_observable),
        smallest_visible={
            name: {"value": size, "unit": unit or _unit(name, trial.user_effects)}
            for name, size, unit in found.smallest_visible
        },
        next_motion=next_motion(path, rivals) if verdict == "ambiguous" else None,
        gap={"metric": metric, "before": value, "after": left, "floor": floor, "closed": closed},
        calibration_set={
            "before": _figures(before.calibration_set),
            "after": _figures(after.calibration_set),
        },
        control_set=None
        if trial.judges is None
        else {"before": _figures(before.control_set), "after": _figures(after.control_set)},
        calibration=after.calibration,
        ranking=tuple(_score(score) for score in found.ranking),
        findings=(*after.findings, *said),
        notes=(*notes, *more, *map(str, said)),
    )


def _named(
    result: CalibrationResult, name: str, score: _core.EffectScore, own: Mapping[str, UserEffect]
) -> dict[str, Any]:
    effect: Effect | UserEffect = own[name] if name in own else find(name)
    parameters = [
        {"name": p.name.removeprefix(f"{name}_"), "value": p.value, "std": p.std, "unit": p.unit}
        for p in result.parameters[21:]
        if p.name.startswith(f"{name}_")
    ]
    return {"sensor": effect.sensor, "parameters": parameters, **_score(score)}


def _score(score: _core.EffectScore) -> dict[str, Any]:
    return {
        "name": score.name,
        "log_bayes_factor": score.log_bayes_factor,
        "statistic": score.statistic,
        "dof": score.dof,
        "p_value": score.p_value,
    }


def _generic(found: _core.GenericFinding | None) -> dict[str, Any] | None:
    if found is None:
        return None
    pattern = {
        "random_walk": "as a random walk in time",
        "gravity_direction": "with the direction of gravity",
        "attitude": "with the attitude, heading included",
        "temperature": "with temperature",
        "last_motion": "with the sign of the last motion",
        "rate": "with the rate of turn",
        "force": "with the specific force",
    }[found.kernel]
    # A scale, and what the motion adds to the force, show in the moves that these rests begin.
    inside = found.block == "gyro_scale" or (found.block, found.kernel) == ("accel_bias", "rate")
    unit = {"gyro_bias": " rad/s", "accel_bias": " m/s^2"}.get(found.block, "")
    places = ("moves after the rests " if inside else "rests ") + ", ".join(map(str, found.rests))
    return {
        "block": found.block,
        "kernel": found.kernel,
        "log_bayes_factor": found.log_bayes_factor,
        "description": f"{found.block} on axis {'xyz'[found.axis]} varies {pattern}, "
        f"{found.rms:.2g}{unit} rms, most in the {places}",
    }


def _scatter(found: tuple[str, float, float] | None) -> dict[str, Any] | None:
    if found is None:
        return None
    residual, factor, chance = found
    block = {"accel": "accel_bias", "gyro": "gyro_bias", "stand": "encoder"}[residual.split("_")[0]]
    return {
        "block": block,
        "kernel": "white",
        "description": f"{residual} scatters from rest to rest by {factor:.2g} times its noise "
        f"(p {chance:.1g}), without a pattern in time, direction or motion",
    }


def _figures(figures: Mapping[str, Any] | None) -> dict[str, Any]:
    return {name: None if figures is None else figures[name] for name in FIGURES}


def _unit(name: str, own: Mapping[str, UserEffect]) -> str:
    return own[name].parameters[0].unit if name in own else find(name).parameters[0].unit
