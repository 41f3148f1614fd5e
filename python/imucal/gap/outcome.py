"""From what a search has found to the verdict and all that is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import Figures
from imucal.effects.definition import UserEffect
from imucal.effects.effect import Effect
from imucal.effects.table import find
from imucal.estimation.evaluate import evaluate
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.gap.predicted_error import predicted_error
from imucal.gap.result import Gap
from imucal.gap.trial import Trial, chi2_of, require_figures
from imucal.gap.verdict import judge, misfits
from imucal.gap.where import disagreement

__all__ = ["data_fault", "outcome"]

# A given calibration whose chi2 exceeds that of a fit without effects by more is that of another state.
FAR_WORSE: Final = 2.0
FIGURES: Final = ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")


def data_fault(findings: Sequence[Finding]) -> Gap:
    """The verdict on recordings whose faults come before any fit."""
    codes = list(dict.fromkeys(finding.code for finding in findings))
    effects = tuple({"name": code, "sensor": None, "parameters": ()} for code in codes)
    return Gap("data_fault", effects=effects, findings=tuple(findings), notes=_said_of(findings))


def outcome(
    trial: Trial,
    found: _core.Search,
    path: Sequence[str],
    before: CalibrationResult,
    after: CalibrationResult,
    calibration: Calibration | None,
    notes: Sequence[str],
) -> Gap:
    """The verdict on what was found, and what `before` and `after`, without and with `path`, say of it."""
    from imucal.gap.next_motion import next_motion

    verdict = judge(trial, found, path, before, after)
    effects = data_fault(verdict.faults).effects
    if verdict.has_names:
        scores = {score.name: score for score in found.path}
        effects = tuple(_named(after, name, scores[name], trial.user_effects) for name in path)
    else:
        after = before
    is_unknown, is_ambiguous = verdict.word == "unknown", verdict.word == "ambiguous"
    said = [fault for fault in verdict.faults if fault not in after.findings]
    of_control = () if after.control is None else after.control.findings
    findings = (*after.findings, *said, *of_control)
    generic, reasons = _generic(found.generic), misfits(after)
    if is_unknown and generic is None:
        generic = _scatter(found.scattering_rests) or _not_confirmed(verdict.not_confirmed)
        if generic is None and reasons:
            generic, reasons = _contradiction(reasons), []
    gap, more = _closed(trial, before, after, calibration)
    if found.in_motion_left_out:
        more.insert(0, found.in_motion_left_out)
    return Gap(
        verdict.word,
        effects=effects,
        ambiguous_with=tuple(dict.fromkeys(rival for of in verdict.rivals.values() for rival in of))
        if is_ambiguous
        else (),
        resembles=tuple(s.name for s in found.ranking[:3] if s.log_bayes_factor > 0) if is_unknown else (),
        generic=generic,
        not_observable=tuple({"name": name, "needs": needs} for name, needs in found.not_observable),
        smallest_visible={
            name: {"value": size, "unit": unit or _unit(name, trial.user_effects)}
            for name, size, unit in found.smallest_visible
        },
        next_motion=next_motion(trial, verdict.rivals, after) if is_ambiguous else None,
        gap=gap,
        where=disagreement(before, after, trial.unit_data, found.in_motion_left_out is None),
        corrected_error=_corrected_error(trial, calibration, before, after),
        traces={
            name: {"times_noise": dict(times_noise), "taken_up": taken_up}
            for name, times_noise, taken_up in found.traces
        },
        calibration_set={
            "before": _figures(before.calibration_set),
            "after": _figures(after.calibration_set),
        },
        control_set=None
        if trial.judges is None
        else {"before": _figures(before.control_set), "after": _figures(after.control_set)},
        held_out=_held_out(before, after),
        fits={"before": before, "after": after},
        calibration=after.calibration,
        ranking=tuple(_score(score) for score in found.ranking),
        findings=findings,
        notes=(
            *reasons,
            *notes,
            *verdict.notes,
            *more,
            *_said_of(findings),
        ),
        user_effects=tuple(trial.user_effects.values()),
    )


def _said_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    return tuple(finding.line for finding in findings)


def _closed(
    trial: Trial, before: CalibrationResult, after: CalibrationResult, calibration: Calibration | None
) -> tuple[dict[str, Any], list[str]]:
    """How much of the gap is closed, of a given calibration if there is one, and what a refit alone did."""
    metric, value, left, floor = trial.metric(before, after)
    refitted: float | None = None
    notes: list[str] = []
    if calibration is not None:
        given = [_chi2(trial, of) for of in (calibration, before.calibration, after.calibration)]
        notes = _refit_alone(given, trial)
        if trial.judges is not None:
            value, refitted = given[0], value
    gap = {
        "metric": metric,
        "before": value,
        "refitted": refitted,
        "after": left,
        "floor": floor,
        "closed": (value - left) / (value - floor) if value > floor else 0.0,
    }
    return gap, notes


def _chi2(trial: Trial, calibration: Calibration) -> float:
    """chi2 per degree of freedom on the control recordings, or on the recordings if there are none."""
    judges = trial.unit_data if trial.judges is None else trial.judges
    judged = evaluate(calibration, list(judges), min_rest_s=trial.min_rest_s)
    require_figures(judged)
    return chi2_of(judged.figures)


def _refit_alone(chi2: Sequence[float], trial: Trial) -> list[str]:
    """What a fit without effects changes of a calibration that was given, if that is much.

    chi2  of the given calibration, of that of these recordings without effects, and with what joined
    """
    given, refitted, after = chi2
    if given <= FAR_WORSE * max(refitted, 1.0):
        return []
    of = "these" if trial.judges is None else "the control"
    return [
        f"the given calibration does not fit {of} recordings: chi2 per degree of freedom {given:.4g}, "
        f"refitted without effects {refitted:.4g}, with what was found {after:.4g}: only the second step is "
        "the effects', and the predicted error of corrected signals has both"
    ]


def _corrected_error(
    trial: Trial, calibration: Calibration | None, before: CalibrationResult, after: CalibrationResult
) -> dict[str, dict[str, float]] | None:
    """Predicted on the control recordings if there are any; None if nothing joined."""
    if after is before:
        return None
    trial.stage("predicting the error of corrected signals")
    judges = trial.unit_data if trial.judges is None else trial.judges
    return predicted_error(calibration or before.calibration, after, judges)


def _held_out(before: CalibrationResult, after: CalibrationResult) -> dict[str, Any] | None:
    if before.held_out is None or after.held_out is None:
        return None
    names = ("gravity_direction_rms_deg", "gravity_norm_rms_mps2")
    figures = [
        {name: getattr(held_out, name) for name in names} for held_out in (before.held_out, after.held_out)
    ]
    return {"folds": before.held_out.folds, "before": figures[0], "after": figures[1]}


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
    if residual == "stand_and_sensors":
        return {
            "block": block,
            "kernel": "contradiction",
            "description": "with the stand's angles the sensors' effects differ by "
            f"{factor:.2g} standard deviations (p {chance:.1g}) from what the sensors say alone",
        }
    return {
        "block": block,
        "kernel": "white",
        "description": f"{residual} scatters from rest to rest by {factor:.2g} times its noise "
        f"(p {chance:.1g}), without a pattern in time, direction or motion",
    }


def _not_confirmed(scores: Sequence[_core.EffectScore]) -> dict[str, Any] | None:
    if not scores:
        return None
    names = " and ".join(score.name for score in scores)
    return {
        "block": "accel" if scores[0].name.startswith("accel") else "gyro",
        "kernel": "not_confirmed",
        "description": f"{names} fits these recordings by {scores[0].log_bayes_factor:.0f} nats and does not "
        "predict what no fit has seen: record more rests and moves",
    }


def _contradiction(misfits: Sequence[str]) -> dict[str, Any]:
    return {"block": "recordings", "kernel": "contradiction", "description": "; ".join(misfits)}


def _figures(figures: Figures | None) -> dict[str, Any]:
    return {name: getattr(figures, name, None) for name in FIGURES}


def _unit(name: str, own: Mapping[str, UserEffect]) -> str:
    return own[name].parameters[0].unit if name in own else find(name).parameters[0].unit
