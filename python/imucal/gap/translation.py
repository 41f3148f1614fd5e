"""Conversion of the compiled library's result to a `Gap`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import imucal._core as _core
import imucal.gap.notes as notes
from imucal.calibration.figures import Figures
from imucal.calibration.triad import BASE
from imucal.effects.definition import UserEffect
from imucal.effects.effect import Effect
from imucal.effects.table import find
from imucal.estimation.calibrate import result_of
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.gap.next_motion import next_motion
from imucal.gap.question import Question
from imucal.gap.remaining import described
from imucal.gap.result import Gap

__all__ = ["gap_of"]

# Probability that a search names an effect whose size equals its detection limit. The name counts as right if
# it is the first name of the result, alone or followed by effects that the recordings cannot distinguish from
# it. The benchmark in docs/results/gap.md shows this share for 280 cases. At the detection limit the chi2
# test has a power of 90 %. The probability of the right name is lower, because the effect must also have more
# evidence than its rivals.
NAMED_AT_LIMIT: Final = 0.6
# Kinds of residuals on control or held-out data, in the order in which the compiled library returns them.
UNSEEN_KINDS: Final = ("rest_norm", "move_direction", "rest_rate")
FIGURES: Final = ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg")


def gap_of(question: Question, found: _core.GapResult) -> Gap:
    """Convert the library's result; add sentences and the motion that distinguishes between rivals."""
    own = tuple(question.definitions.values())
    if found.analysis is None:
        lines = tuple(fault.line for fault in found.faults)
        return Gap(
            found.verdict,
            effects=_faults(found.faults),
            findings=tuple(found.faults),
            notes=lines,
            user_effects=own,
        )
    analysis, search = found.analysis, found.analysis.search
    before = _result(question, analysis.before)
    after = before if analysis.after is None else _result(question, analysis.after)
    is_unknown, is_ambiguous = found.verdict == "unknown", found.verdict == "ambiguous"
    if analysis.after is None:
        effects = _faults(found.faults)
    else:
        shares = dict(analysis.shares)
        effects = tuple(
            {**_named(after, score, question.definitions), "closed": _shares(shares.get(score.name))}
            for score in analysis.effects
        )
    said = [fault for fault in found.faults if fault not in after.findings]
    of_control = () if after.control is None else after.control.findings
    findings = (*after.findings, *said, *of_control)
    remainder, generic, reasons = described(analysis, after)
    return Gap(
        found.verdict,
        effects=effects,
        ambiguous_with=tuple(dict.fromkeys(rival for _, rival, _ in analysis.rivals)),
        resembles=tuple(s.name for s in search.ranking[:3] if s.log_bayes_factor > 0) if is_unknown else (),
        generic=generic,
        remainder=remainder,
        not_observable=tuple({"name": name, "needs": needs} for name, needs in search.not_observable),
        smallest_visible={
            name: {
                "value": size,
                "unit": unit or _unit(name, question.definitions),
                "chance": NAMED_AT_LIMIT,
            }
            for name, size, unit in search.smallest_visible
        },
        next_motion=next_motion(question, analysis, after) if is_ambiguous else None,
        gap=_closed(question, analysis),
        where=analysis.residuals,
        corrected_error=analysis.corrected_errors,
        traces={
            name: {"times_noise": dict(times_noise), "taken_up": taken_up}
            for name, times_noise, taken_up in search.traces
        },
        calibration_set={
            "before": _figures(before.calibration_set),
            "after": _figures(after.calibration_set),
        },
        control_set=None
        if not question.control
        else {"before": _figures(before.control_set), "after": _figures(after.control_set)},
        held_out=_held_out(before, after),
        fits={"before": before, "after": after},
        calibration=after.calibration,
        ranking=tuple(_score(score) for score in search.ranking),
        findings=findings,
        notes=(
            *reasons,
            *notes.of_analysis(question, analysis),
            *(finding.line for finding in findings),
        ),
        user_effects=own,
        is_hand_moved=search.is_hand_moved,
    )


def _result(question: Question, fit: _core.GapFit) -> CalibrationResult:
    own = tuple(question.definitions[name] for name in fit.effects if name in question.definitions)
    options = replace(question.options, folds=_core.GAP_FOLDS if not question.control else None)
    return result_of(
        fit.outcome,
        question.recordings,
        options,
        own,
        question.control,
        fit.control,
        references=question.references,
    )


def _faults(faults: Sequence[Finding]) -> tuple[dict[str, Any], ...]:
    """Faults of the data, each listed once, in the form in which `Gap.effects` lists effects."""
    codes = dict.fromkeys(fault.code for fault in faults)
    return tuple({"name": code, "sensor": None, "parameters": ()} for code in codes)


def _closed(question: Question, analysis: _core.GapAnalysis) -> dict[str, Any]:
    """Figure of merit on control or held-out data, and the share of its excess that the effects remove.

    The excess is the figure of merit minus its value from noise alone. If the user gave a calibration and
    control recordings, `before` is the figure of merit of this calibration.
    """
    metric, before, after, floor = analysis.unseen
    refitted: float | None = None
    if analysis.chi2_of_given is not None and question.control:
        before, refitted = analysis.chi2_of_given[0], before
    return {
        "metric": metric,
        "before": before,
        "refitted": refitted,
        "after": after,
        "floor": floor,
        "closed": (before - after) / (before - floor) if before > floor else 0.0,
    }


def _held_out(before: CalibrationResult, after: CalibrationResult) -> dict[str, Any] | None:
    if before.held_out is None or after.held_out is None:
        return None
    names = ("gravity_direction_rms_deg", "gravity_norm_rms_mps2")
    figures = [
        {name: getattr(held_out, name) for name in names} for held_out in (before.held_out, after.held_out)
    ]
    return {"folds": before.held_out.folds, "before": figures[0], "after": figures[1]}


def _named(
    result: CalibrationResult, score: _core.EffectScore, own: Mapping[str, UserEffect]
) -> dict[str, Any]:
    effect: Effect | UserEffect = own[score.name] if score.name in own else find(score.name)
    shape = () if effect.shape is None else (effect.shape,)
    names = {f"{score.name}_{p.name}": p.name for p in (*effect.parameters, *shape)}
    parameters = [
        {"name": names[p.name], "value": p.value, "std": p.std, "unit": p.unit}
        for p in result.parameters[BASE:]
        if p.name in names
    ]
    return {"sensor": effect.sensor, "parameters": parameters, **_score(score)}


def _shares(closed: Sequence[float | None] | None) -> dict[str, float | None]:
    """Share of the excess chi2 (chi2 beyond noise) that an effect removes, by kind of residual."""
    return dict(zip(UNSEEN_KINDS, closed or (None,) * len(UNSEEN_KINDS), strict=True))


def _score(score: _core.EffectScore) -> dict[str, Any]:
    return {
        "name": score.name,
        "log_bayes_factor": score.log_bayes_factor,
        "statistic": score.statistic,
        "dof": score.dof,
        "p_value": score.p_value,
    }


def _figures(figures: Figures | None) -> dict[str, Any]:
    return {name: getattr(figures, name, None) for name in FIGURES}


def _unit(name: str, own: Mapping[str, UserEffect]) -> str:
    return own[name].parameters[0].unit if name in own else find(name).parameters[0].unit
