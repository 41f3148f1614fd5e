"""From what a search has found to the verdict and all that is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from imucal.calibration import Calibration
from imucal.calibration_result import CalibrationResult
from imucal.disturbances import disturbances
from imucal.effects import Effect, UserEffect, find
from imucal.evaluate import evaluate, poor_figures
from imucal.finding import Finding
from imucal.gap_error import predicted_error
from imucal.gap_result import Gap
from imucal.gap_rules import faults_without_effect, mount_slips
from imucal.gap_trial import Trial, require_figures
from imucal.gap_where import disagreement

if TYPE_CHECKING:
    from imucal import _core

__all__ = ["data_fault", "outcome"]

# Evidence that no chance explains, nats.
SURELY: Final = 8.0
# An effect that leaves more of a control recording's chi2 has not explained it.
CLEARLY_LESS: Final = 0.9
# A given calibration whose chi2 exceeds that of a fit without effects by more is that of another state.
FAR_WORSE: Final = 2.0
FIGURES: Final = ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")


def data_fault(findings: Sequence[Finding]) -> Gap:
    """The verdict on recordings whose faults come before any fit."""
    codes = list(dict.fromkeys(finding.code for finding in findings))
    effects = tuple({"name": code, "sensor": None, "parameters": ()} for code in codes)
    return Gap("data_fault", effects=effects, findings=tuple(findings), notes=tuple(str(f) for f in findings))


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
    # What fits so well is no chance, and not what the unseen recordings have either.
    not_confirmed = [score for score in found.path if score.log_bayes_factor > SURELY and not path]
    if any(fault.code == "clock_irregular" for fault in faults):
        # With such a clock long steps say nothing of lost samples.
        faults = [fault for fault in faults if fault.code != "samples_missing"]
    disturbing = [fault for fault in faults if fault.code in spoilt]
    if slips or (found.generic is not None and disturbing):
        # What no effect explains where samples are spoilt, they may.
        verdict, effects = "data_fault", data_fault([*slips, *faults]).effects
    elif found.generic is not None:
        verdict = "stochastic" if found.generic.kernel == "random_walk" else "unknown"
    elif path and found.scattering_rests is None:
        verdict = "ambiguous" if rivals else "named"
    elif faults and not path:
        verdict, effects = "data_fault", data_fault(faults).effects
    elif found.scattering_rests is not None or not_confirmed:
        verdict = "unknown"
    else:
        verdict = "nothing_missing"
    if verdict in ("named", "ambiguous") and _misfits(after, "control set"):
        # A control recording that fits no better with it does not confirm it.
        values = [trial.unseen_chi2(result) for result in (before, after)]
        if values[1] > CLEARLY_LESS * values[0]:
            verdict = "unknown"
            notes = [
                *notes,
                f"{' and '.join(path)} was found and left out: chi2 per degree of freedom of the control "
                f"recordings goes from {values[0]:.4g} to {values[1]:.4g}",
            ]
    if verdict not in ("named", "ambiguous"):
        after = before
    misfits = [*_misfits(after, "calibration set"), *_misfits(after, "control set")]
    if verdict == "nothing_missing" and misfits:
        verdict = "unknown"
    said = [f for f in (*slips, *faults) if f not in after.findings] if verdict == "data_fault" else []
    metric, value, left, floor = trial.metric(before, after)
    more = [found.in_motion_left_out] if found.in_motion_left_out else []
    refitted = None
    if calibration is not None:
        given = [_chi2(trial, of) for of in (calibration, before.calibration, after.calibration)]
        more += _refit_alone(given, trial)
        if trial.judges is not None:
            value, refitted = given[0], value
    closed = (value - left) / (value - floor) if value > floor else 0.0
    of_control = () if after.control is None else after.control.findings
    generic = _generic(found.generic)
    if verdict == "unknown" and generic is None:
        generic = _scatter(found.scattering_rests) or _not_confirmed(not_confirmed)
        if generic is None and misfits:
            generic, misfits = _contradiction(misfits), []
    return Gap(
        verdict,
        effects=effects if verdict in ("named", "ambiguous", "data_fault") else (),
        ambiguous_with=rivals if verdict == "ambiguous" else (),
        resembles=tuple(s.name for s in found.ranking[:3] if s.log_bayes_factor > 0)
        if verdict == "unknown"
        else (),
        generic=generic,
        not_observable=tuple({"name": name, "needs": needs} for name, needs in found.not_observable),
        smallest_visible={
            name: {"value": size, "unit": unit or _unit(name, trial.user_effects)}
            for name, size, unit in found.smallest_visible
        },
        next_motion=next_motion(trial, _rivals(path, scores), after) if verdict == "ambiguous" else None,
        gap={
            "metric": metric,
            "before": value,
            "refitted": refitted,
            "after": left,
            "floor": floor,
            "closed": closed,
        },
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
        findings=(*after.findings, *said, *of_control),
        notes=(*misfits, *notes, *more, *map(str, said), *(f"{f.severity}: {f}" for f in of_control)),
        user_effects=tuple(trial.user_effects.values()),
    )


def _misfits(result: CalibrationResult, name: str) -> list[str]:
    """Why this calibration does not describe the recordings of a set; empty if it does."""
    figures = result.control_set if name == "control set" else result.calibration_set
    return [] if figures is None else poor_figures(name, figures)


def _chi2(trial: Trial, calibration: Calibration) -> float:
    """chi2 per degree of freedom on the control recordings, or on the recordings if there are none."""
    judges = trial.unit_data if trial.judges is None else trial.judges
    judged = evaluate(calibration, list(judges), min_rest_s=trial.min_rest_s)
    require_figures(judged)
    return float(judged.figures["chi2_per_dof"])


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


def _rivals(path: Sequence[str], scores: Mapping[str, _core.EffectScore]) -> dict[str, list[str]]:
    """Of each effect that joined, the names that explain as much."""
    return {name: [rival for rival in scores[name].rivals if rival not in path] for name in path}


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
    figures = [{name: result.held_out[name] for name in names} for result in (before, after)]  # type: ignore[index]
    return {"folds": before.held_out["folds"], "before": figures[0], "after": figures[1]}


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


def _figures(figures: Mapping[str, Any] | None) -> dict[str, Any]:
    return {name: None if figures is None else figures[name] for name in FIGURES}


def _unit(name: str, own: Mapping[str, UserEffect]) -> str:
    return own[name].parameters[0].unit if name in own else find(name).parameters[0].unit
