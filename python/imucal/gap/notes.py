"""Sentences on what a search has found: notes, and descriptions of what has no name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import imucal._core as _core
from imucal.calibration.figures import poor_figures
from imucal.effects.table import find
from imucal.estimation.result import CalibrationResult
from imucal.gap.question import Question

__all__ = [
    "contradiction_of",
    "generic_of",
    "misfits",
    "not_confirmed_of",
    "of_analysis",
    "scatter_of",
]

# A given calibration whose chi2 is larger than that of a fit without effects by more than this factor is one
# of another state of the unit.
FAR_WORSE: Final = 2.0

# How the bias or the scale varies, by the kernel of the generic hypothesis.
PATTERNS: Final = {
    "random_walk": "as a random walk in time",
    "gravity_direction": "with the direction of gravity",
    "attitude": "with the attitude, heading included",
    "temperature": "with temperature",
    "last_motion": "with the sign of the last motion",
    "rate": "with the angular rate",
    "force": "with the specific force",
}


def of_analysis(question: Question, analysis: _core.GapAnalysis) -> Iterator[str]:
    """Notes on effects that did not join or cannot be shown, and on a given calibration."""
    yield from _refused(analysis)
    search = analysis.search
    for name, evidence, gain, std in search.not_predictive:
        yield (
            f"{name} fits these recordings (log Bayes factor {evidence:.1f}) and does not predict rests and "
            f"moves that are held out: {gain:.1f} +- {std:.1f} nats"
        )
    for name, needs in search.not_observable:
        if question.candidates is not None or name in question.definitions:
            yield f"{name} was requested and these recordings cannot show it: it needs {needs}"
    if analysis.contradiction is not None:
        names, before, after = analysis.contradiction
        yield (
            f"{' and '.join(names)} was found and left out: chi2 per degree of freedom of the control "
            f"recordings goes from {before:.4g} to {after:.4g}"
        )
    if search.is_hand_moved:
        yield "the unit was translated during the moves: the specific force inside them is not used"
    if analysis.chi2_of_given is not None:
        yield from _refit_alone(analysis.chi2_of_given, question)


def misfits(result: CalibrationResult) -> list[str]:
    """Why a calibration does not describe its recordings, or the control recordings; empty if it does."""
    sets = {"calibration set": result.calibration_set, "control set": result.control_set}
    return [
        reason
        for name, figures in sets.items()
        if figures is not None
        for reason in poor_figures(name, figures)
    ]


def _refused(analysis: _core.GapAnalysis) -> Iterator[str]:
    for name, error, chi2 in analysis.refused:
        if chi2 is None:
            yield f"{name} was found and cannot be fitted: {error}"
        else:
            yield (
                f"{name} was found and left out: chi2 per degree of freedom of what no fit has seen goes "
                f"from {chi2[0]:.4g} to {chi2[1]:.4g}"
            )
    if analysis.not_the_earth is not None:
        size_radps, sigma_radps = analysis.not_the_earth
        known = find("earth_rate").parameters[0].typical
        yield (
            f"earth_rate fits these recordings with {size_radps:.3g} +- {sigma_radps:.1g} rad/s, and the "
            f"Earth turns with {known:.4g}: something else is there, or they do not determine it"
        )


def _refit_alone(chi2: Sequence[float], question: Question) -> Iterator[str]:
    """What a fit without effects changes of a given calibration, if that is much.

    chi2  of the given calibration, of the fit without effects, and of that with what joined
    """
    given, refitted, after = chi2
    if given > FAR_WORSE * max(refitted, 1.0):
        of = "these" if not question.control else "the control"
        yield (
            f"the given calibration does not fit {of} recordings: chi2 per degree of freedom {given:.4g}, "
            f"refitted without effects {refitted:.4g}, with what was found {after:.4g}: only the second step "
            "is the effects', and the predicted error of corrected signals has both"
        )


def generic_of(found: _core.GenericFinding | None) -> dict[str, Any] | None:
    """The generic hypothesis that was found, with its description."""
    if found is None:
        return None
    # A scale, and what the motion adds to the force, show in the moves that these rests begin.
    inside = found.block == "gyro_scale" or (found.block, found.kernel) == ("accel_bias", "rate")
    unit = {"gyro_bias": " rad/s", "accel_bias": " m/s^2"}.get(found.block, "")
    places = ("moves after the rests " if inside else "rests ") + ", ".join(map(str, found.rests))
    return {
        "block": found.block,
        "kernel": found.kernel,
        "log_bayes_factor": found.log_bayes_factor,
        "description": f"{found.block} on axis {'xyz'[found.axis]} varies {PATTERNS[found.kernel]}, "
        f"{found.rms:.2g}{unit} rms, most in the {places}",
    }


def scatter_of(found: tuple[str, float, float] | None) -> dict[str, Any] | None:
    """Residuals at the rests that exceed noise, with their description."""
    if found is None:
        return None
    residual, factor, chance = found
    block = {"accel": "accel_bias", "gyro": "gyro_bias", "stand": "encoder"}[residual.split("_")[0]]
    if residual == "stand_and_sensors":
        return {
            "block": block,
            "kernel": "contradiction",
            "description": "with the stand's angles the sensors' effects differ by "
            f"{factor:.2g} standard deviations (p {chance:.1g}) from those of the sensors alone",
        }
    return {
        "block": block,
        "kernel": "white",
        "description": f"{residual} scatters from rest to rest by {factor:.2g} times its noise "
        f"(p {chance:.1g}), without a pattern in time, direction or motion",
    }


def not_confirmed_of(scores: Sequence[_core.EffectScore]) -> dict[str, Any] | None:
    """Effects that fit too well for chance and do not predict unseen data, with their description."""
    if not scores:
        return None
    names = " and ".join(score.name for score in scores)
    return {
        "block": "accel" if scores[0].name.startswith("accel") else "gyro",
        "kernel": "not_confirmed",
        "description": f"{names} fits these recordings by {scores[0].log_bayes_factor:.0f} nats and does not "
        "predict what no fit has seen: record more rests and moves",
    }


def contradiction_of(reasons: Sequence[str]) -> dict[str, Any]:
    """Recordings that contradict the model, with the reasons as their description."""
    return {"block": "recordings", "kernel": "contradiction", "description": "; ".join(reasons)}
