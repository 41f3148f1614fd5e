"""Notes on a search for missing effects, and descriptions of residuals that no effect explains."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

import imucal._core as _core
from imucal.calibration.figures import poor_figures
from imucal.effects.table import find
from imucal.estimation.result import CalibrationResult
from imucal.gap.question import Question
from imucal.gap.remainder import SessionStep
from imucal.gap.sizes import for_people, p_text
from imucal.recording.recording import Recording

__all__ = [
    "above_noise_of",
    "contradiction_of",
    "fault_of",
    "generic_of",
    "misfits",
    "not_confirmed_of",
    "of_analysis",
    "scatter_of",
    "session_in_words",
    "session_of",
]

# A given calibration is reported as outdated if its chi2 per degree of freedom exceeds that of a new fit
# without effects by more than this factor. The parameters of the unit have then changed since the
# calibration.
FAR_WORSE: Final = 2.0

# A change of temperature is considered as the cause of a bias change between sessions only if the mean
# temperatures differ by at least this number, K.
LEAST_CHANGE_K: Final = 1.0
# chi2 per degree of freedom above which residuals count as not explained by noise. The value 4 corresponds to
# residuals with an rms of twice the noise.
ABOVE_NOISE: Final = 4.0
# A temperature coefficient is implausible if it exceeds this multiple of its typical size.
MOST_TIMES_TYPICAL: Final = 5.0

# If the control recordings are judged poor, the difference between their mean temperature and that of the
# calibration recordings is reported if it exceeds this number, K.
WARMER_K: Final = 5.0

# Largest p-value of a significant effect. If the model contains a temperature lag, the temperature effect of
# the same bias stays in the model even with a larger p-value, and a note reports this.
NOT_SIGNIFICANT: Final = 0.01

# A generic hypothesis is a variation of a bias or scale that no effect of the catalogue describes. The
# parameter that varies is called its block. `BIASES` lists the blocks that are biases, each with its SI unit.
BIASES: Final = {"gyro_bias": "rad/s", "accel_bias": "m/s^2"}
# Phrases that describe how a bias or a scale varies. The keys are the names of the kernels (patterns) of
# generic hypotheses.
PATTERNS: Final = {
    "random_walk": "as a random walk in time",
    "gravity_direction": "with the direction of gravity",
    "attitude": "with the attitude, heading included",
    "temperature": "with temperature",
    "last_motion": "with the sign of the last motion",
    "rate": "with the angular rate",
    "force": "with the specific force",
    "between_sessions": "from one recording to the next",
    "time": "smoothly with time",
    "switching": "between two levels",
    "white": "independently in each rest and move",
}

# Faults of the data that the residuals of moves show. If effects were accepted, such a fault is reported as
# the pattern of the residuals that these effects do not explain.
FAULTS: Final = {
    "clock_irregular": "the samples were not taken at the times of their time stamps",
    "noise_grows_in_motion": "the noise of the gyroscope is larger inside moves than at rest",
}


def of_analysis(question: Question, analysis: _core.GapAnalysis) -> Iterator[str]:
    """Notes on rejected effects, requested effects that are not observable, and the given calibration."""
    yield from _refused(analysis)
    of_model = {score.name for score in analysis.effects}
    for score in analysis.effects:
        if score.p_value > NOT_SIGNIFICANT and f"{score.name}_lag" in of_model:
            yield (
                f"{score.name} is not significant ({p_text(score.p_value)}). It is part of the model because "
                "the time constant of the temperature lag depends on it"
            )
    search = analysis.search
    for name, evidence, gain, std in search.not_predictive:
        yield (
            f"{name} fits these recordings (log Bayes factor {evidence:.1f}) but does not improve the "
            "prediction of held-out rests and moves: log predictive density changes by "
            f"{gain:.1f} ± {std:.1f} nats"
        )
    for name, needs in search.not_observable:
        if question.candidates is not None or name in question.definitions:
            yield f"{name} was requested but is not observable in these recordings: it needs {needs}"
    if analysis.contradiction is not None:
        names, before, after = analysis.contradiction
        yield (
            f"{' and '.join(names)} was selected but rejected: chi2 per degree of freedom of "
            f"{'the control recordings' if question.control else 'held-out rests and moves'} changes from "
            f"{before:.4g} to {after:.4g}"
        )
    if search.is_hand_moved:
        is_coarse = any(
            finding.code == "noise_below_lsb" and any(name.startswith("accel") for name in finding.columns)
            for finding in analysis.before.outcome.findings
        )
        why = (
            "the accelerometer's noise is below a step of its converter, so rounding in moves is not white"
            if is_coarse
            else "the unit was translated during the moves"
        )
        yield f"{why}: the specific force inside them is not used"
    if analysis.after is not None and any(analysis.after.more_residuals):
        kinds = ("the specific force inside the moves", "the angles of the stand")
        used = [name for name, is_used in zip(kinds, analysis.after.more_residuals, strict=True) if is_used]
        yield (
            f"the fit with the effects also uses {' and '.join(used)}, because the other residuals hardly "
            "determine the effects; `imucal calibrate --effects` does not use them"
        )
    if analysis.chi2_of_given is not None:
        yield from _refit_alone(analysis.chi2_of_given, question)
    control = (analysis.after or analysis.before).control
    # If the biases changed between sessions, the sentence on this change also contains the change of the
    # temperature.
    if control is not None and control.verdict == "poor" and analysis.session is None:
        yield from _temperature_change(question)


def _temperature_change(question: Question) -> Iterator[str]:
    """Note on control recordings that are much warmer or colder than the calibration recordings."""
    means = [_mean_degc(recordings) for recordings in (question.recordings, question.control)]
    of_calibration, of_control = means
    if of_calibration is None or of_control is None or abs(of_control - of_calibration) <= WARMER_K:
        return
    change_k = of_control - of_calibration
    yield (
        f"the control recordings are {abs(change_k):.3g} K {'warmer' if change_k > 0 else 'colder'} than the "
        f"calibration recordings (mean temperatures {of_control:.3g} and {of_calibration:.3g} degC), which "
        "may be the cause of their large residuals: record at the same temperature, or calibrate over the "
        "whole range of temperatures"
    )


def _mean_degc(recordings: Sequence[Recording]) -> float | None:
    """Mean temperature of all samples, degC; None if a recording has no temperature."""
    columns = [recording.temperature_degc for recording in recordings]
    known = [column[np.isfinite(column)] for column in columns if column is not None]
    values = np.concatenate(known) if known and len(known) == len(columns) else np.array([])
    return float(values.mean()) if len(values) else None


def misfits(result: CalibrationResult) -> list[str]:
    """Reasons why a calibration is a poor fit to its recordings or to control recordings; may be empty."""
    sets = {"calibration set": result.calibration_set, "control set": result.control_set}
    return [
        reason
        for name, figures in sets.items()
        if figures is not None
        for reason in poor_figures(name, figures)
    ]


def _refused(analysis: _core.GapAnalysis) -> Iterator[str]:
    for name, error, chi2, chance, filtered in analysis.refused:
        if filtered is not None:
            yield f"{name} was selected but rejected: {_filtered(filtered)}"
        elif chance is not None:
            yield (
                f"{name} was selected but rejected: its parameters do not differ significantly from zero "
                f"beside the other effects ({p_text(chance)})"
            )
        elif chi2 is None:
            yield f"{name} was selected but cannot be fitted: {error}"
        else:
            yield (
                f"{name} was selected but rejected: chi2 per degree of freedom of unseen data changes "
                f"from {chi2[0]:.4g} to {chi2[1]:.4g}"
            )
    if analysis.not_the_earth is not None:
        size_radps, sigma_radps = analysis.not_the_earth
        known_radps = find("earth_rate").parameters[0].typical
        (size, unit), (sigma, _), (known, _) = (
            for_people(value, "rad/s") for value in (size_radps, sigma_radps, known_radps)
        )
        yield (
            f"earth_rate fits these recordings with {size:.4g} ± {sigma:.2g} {unit}, but the "
            f"Earth's rate is {known:.4g} {unit}: the cause is another effect, or the recordings do not "
            "determine the rate"
        )


def _refit_alone(chi2: Sequence[float], question: Question) -> Iterator[str]:
    """Note on a given calibration that fits much worse than a new fit without effects.

    chi2  chi2 per degree of freedom of the given calibration, of the fit without effects, and of the fit with
          effects
    """
    given, refitted, after = chi2
    if given > FAR_WORSE * max(refitted, 1.0):
        of = "these" if not question.control else "the control"
        yield (
            f"the given calibration does not fit {of} recordings: chi2 per degree of freedom {given:.4g}, "
            f"refitted without effects {refitted:.4g}, with effects {after:.4g}; only the last change is due "
            "to the effects, but the predicted error of the corrected signals includes both changes"
        )


def generic_of(found: _core.GenericFinding | None) -> dict[str, Any] | None:
    """The found variation of a bias or scale, described for users; None if the search has found none."""
    if found is None:
        return None
    # A gyroscope scale that varies, and an accelerometer bias that varies with the rate, have an effect only
    # within moves. For these two variations, `rests` contains the indices of the rests before the moves.
    inside = found.block == "gyro_scale" or (found.block, found.kernel) == ("accel_bias", "rate")
    rms, unit = found.rms, ""
    if found.block in BIASES:
        rms, name = for_people(found.rms, BIASES[found.block])
        unit = f" {name}"
    places = ("moves after the rests " if inside else "rests ") + ", ".join(map(str, found.rests))
    return {
        "block": found.block,
        "kernel": found.kernel,
        "log_bayes_factor": found.log_bayes_factor,
        "description": f"{found.block} on axis {'xyz'[found.axis]} varies {PATTERNS[found.kernel]}, "
        f"{rms:.2g}{unit} rms, most in the {places}",
    }


def session_of(found: _core.SessionStep | None) -> SessionStep | None:
    """The change of the biases between sessions with its likely cause; None if the library found none."""
    if found is None:
        return None
    x = found.accelerometer_mps2, found.gyroscope_radps
    force, rate = (None if change is None else (change[0], change[1], change[2]) for change in x)
    change_k = found.temperature_change_k
    if change_k is None:
        cause = "not_known"
    else:
        needed = _coefficients(force, rate, change_k) if abs(change_k) >= LEAST_CHANGE_K else []
        is_usual = needed and all(own.value < MOST_TIMES_TYPICAL * own.typical for own in needed)
        cause = "temperature" if is_usual else "switch_on"
    return SessionStep(force, rate, found.p_value, change_k, cause, *found.chi2)


def session_in_words(step: SessionStep) -> str:
    """A sentence on the change of the biases between two sessions."""
    moved = []
    if step.gyroscope_radps is not None:
        moved.append(f"gyroscope {_three(step.gyroscope_radps, 'rad/s')}")
    if step.accelerometer_mps2 is not None:
        moved.append(f"accelerometer {_three(step.accelerometer_mps2, 'm/s^2')}")
    words = f"biases moved between sessions by {' and '.join(moved)}"
    change_k = step.temperature_change_k
    if change_k is None:
        words += "; temperature, time or a switch-on may be the cause: record temp_degc in both sessions"
    elif abs(change_k) < LEAST_CHANGE_K:
        words += f"; the temperature changed by {change_k:.1f} K, so time or a switch-on explains it"
    else:
        words += (
            f"; the temperature changed by {change_k:.1f} K, which would be {_per_kelvin(step, change_k)}"
        )
    words += (
        f"; chi2 per degree of freedom of the control recordings is {step.chi2_per_dof:.4g}, and "
        f"{step.chi2_per_dof_own:.4g} after a fit of their biases"
    )
    if step.chi2_per_dof_own > ABOVE_NOISE:
        words += ", so the biases alone do not explain the control recordings"
    return words


def _three(values: Sequence[float], unit: str) -> str:
    shown = [for_people(value, unit) for value in values]
    return f"{', '.join(f'{value:.3g}' for value, _ in shown)} {shown[0][1]}"


class _Coefficient(NamedTuple):
    """The temperature coefficient that would explain a change of a bias, and its typical size, SI units."""

    effect: str
    unit: str
    value: float
    typical: float


def _coefficients(
    force: Sequence[float] | None, rate: Sequence[float] | None, change_k: float
) -> list[_Coefficient]:
    rows = (("gyro_bias_temperature", rate, "rad/s"), ("accel_bias_temperature", force, "m/s^2"))
    return [
        _Coefficient(name, unit, max(map(abs, change)) / abs(change_k), find(name).parameters[0].typical)
        for name, change, unit in rows
        if change is not None
    ]


def _per_kelvin(step: SessionStep, change_k: float) -> str:
    """Text on the temperature coefficients that would explain a bias change, and their typical sizes."""
    words = []
    for name, unit, size, usual in _coefficients(step.accelerometer_mps2, step.gyroscope_radps, change_k):
        (value, shown), (typical, _) = for_people(size, unit), for_people(usual, unit)
        is_usual = size < MOST_TIMES_TYPICAL * usual
        words.append(
            f"{value:.2g} {shown} per K of {name} (typical {typical:.2g}: "
            f"{'temperature explains it' if is_usual else 'time or a switch-on is more likely'})"
        )
    return " and ".join(words)


def scatter_of(found: tuple[str, float, float] | None) -> dict[str, Any] | None:
    """Description of residuals at rests that exceed the noise significantly; None if there are none."""
    if found is None:
        return None
    residual, factor, chance = found
    block = {"accel": "accel_bias", "gyro": "gyro_bias", "stand": "encoder"}[residual.split("_")[0]]
    if residual == "stand_and_sensors":
        return {
            "block": block,
            "kernel": "contradiction",
            "description": "effects of the sensors estimated with and without the stand's angles differ by "
            f"{factor:.2g} standard deviations ({p_text(chance)})",
        }
    return {
        "block": block,
        "kernel": "white",
        "description": f"{residual} scatters from rest to rest by {factor:.2g} times its noise "
        f"({p_text(chance)}) and is not correlated with time, gravity direction or motion",
    }


def not_confirmed_of(analysis: _core.GapAnalysis) -> dict[str, Any] | None:
    """Description of significant but rejected effects, with the reason; None if there are none."""
    scores = analysis.not_confirmed
    if not scores:
        return None
    names = " and ".join(score.name for score in scores)
    reason = next((_why(own) for own in analysis.refused if own[0] == scores[0].name), "")
    return {
        "block": "accel" if scores[0].name.startswith("accel") else "gyro",
        "kernel": "not_confirmed",
        "description": f"{names} fits these recordings best of all effects (log Bayes factor "
        f"{scores[0].log_bayes_factor:.0f} nats), but it does not describe the unit{reason}",
    }


def _filtered(found: Sequence[float]) -> str:
    """A text for a gyroscope whose readings are not only delayed but also filtered.

    Because of the filter, the readings depend on the second derivative of the rate. The text states the
    coefficient of this dependence.
    """
    tau_s, k_s2, sigma_s2 = found
    words = (
        f"the gyroscope is late by {1e3 * tau_s:.3g} ms on average, but it is not only delayed: the second "
        f"derivative of the rate has the coefficient {k_s2:.2g} ± {sigma_s2:.1g} s^2 besides the delay"
    )
    if k_s2 > 0.0:
        words += (
            f", like that of a low-pass filter with the time constant {1e3 * math.sqrt(2.0 * k_s2):.3g} ms"
        )
    return words


def _why(
    refused: tuple[str, str | None, Sequence[float] | None, float | None, Sequence[float] | None],
) -> str:
    """The reason why a selected effect was rejected."""
    _, error, chi2, chance, filtered = refused
    if filtered is not None:
        return f": {_filtered(filtered)}"
    if chance is not None:
        return f": its parameters do not differ significantly from zero (p {chance:.2g})"
    if chi2 is None:
        return f": a model with it cannot be fitted or evaluated: {error}"
    return (
        f": chi2 per degree of freedom of unseen data is {chi2[0]:.4g} without it and {chi2[1]:.4g} with it, "
        "so the cause has another form, or varies between the recordings"
    )


def above_noise_of(found: _core.Remainder, result: CalibrationResult) -> dict[str, Any]:
    """Description of residuals that exceed their noise without a known pattern."""
    control = () if result.control is None else result.control.residuals
    groups = control or result.residuals
    own = next((own for own in groups if own.kind == found.block), None)
    of = "control" if control else "calibration"
    words = "the residuals that exceed their noise" if own is None else own.text
    return {
        "block": found.block,
        "kernel": "above_noise",
        "description": f"{of} recordings: {words}; no known pattern matches these residuals",
    }


def fault_of(pattern: str | None) -> dict[str, Any] | None:
    """Description of residuals of moves that a fault of the data causes; None for other patterns."""
    if pattern not in FAULTS:
        return None
    description = f"residuals of moves exceed their noise, because {FAULTS[pattern]} [{pattern}]"
    return {"block": "moves", "kernel": pattern, "description": description}


def contradiction_of(reasons: Sequence[str]) -> dict[str, Any]:
    """Description of recordings that the model does not fit; `reasons` are the reasons of the poor fit."""
    return {"block": "recordings", "kernel": "contradiction", "description": "; ".join(reasons)}
