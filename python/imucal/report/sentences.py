"""The verdict of each kind of result in one sentence, with supporting numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from imucal.report.page import Verdict
from imucal.units import SHOWN

if TYPE_CHECKING:
    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.inspection import Inspection
    from imucal.estimation.result import CalibrationResult
    from imucal.gap import Gap
    from imucal.noise_analysis.noise import NoiseResult

MG = SHOWN["m/s^2"][0]
METRICS = {
    "chi2_per_dof": "χ² per degree of freedom",
    "held_out_gravity_direction_rms_deg": "the rms error of the gravity direction, deg,",
    "held_out_gravity_norm_rms_mps2": "the rms error of |f| at rest, m/s²,",
}
# For each verdict without named effects: the mood, which selects the symbol and colour (see `Verdict` in
# page.py), and the sentence.
NO_NAME = {
    "nothing_missing": ("good", "No missing effect is detectable in these recordings."),
    "stochastic": ("poor", "A bias fluctuates randomly by more than the unit's noise explains."),
    "unknown": ("poor", "An effect is missing from the model, and it is not in the catalogue."),
    "data_fault": ("poor", "The data have a fault: fix it and record again."),
}


def of_calibration(result: CalibrationResult) -> Verdict:
    """Whether the calibration is good, and by how much it improves figures of merit on control recordings."""
    beside = f"{result.used.removesuffix(' used')} are used."
    if result.control is None:
        beside += " There is no control recording to verify it: give one with --control."
        sentence = "Good on the recordings of the fit; not verified on other recordings."
    else:
        beside = f"{_better(result.control)} {beside}".strip()
        sentence = "Good: the calibration is valid on recordings that the fit has not used."
    if result.judgement is not None:
        beside += f" {result.judgement.count}."
    return _judged(result, sentence, beside)


def of_evaluation(judged: Evaluation) -> Verdict:
    """Whether the calibration is good on the evaluated recordings."""
    beside = _better(judged)
    if judged.judgement is not None:
        beside += f" {judged.judgement.count}."
    return _judged(judged, "Good: the calibration holds on these recordings.", beside.strip())


def of_inspection(seen: Inspection) -> Verdict:
    """Whether a recording can be calibrated, and whether it determines all parameters."""
    beside = (
        f"{seen.samples} samples, {seen.duration_s:.5g} s, {seen.rate_in_words}, {seen.sensors_in_words}, "
        f"{len(seen.rests)} rests."
    )
    if not seen.usable:
        codes = dict.fromkeys(finding.code for finding in seen.findings if finding.severity == "error")
        return Verdict("poor", f"A calibration would refuse this recording: {', '.join(codes)}.", beside)
    if seen.missing is not None:
        return Verdict(
            "incomplete",
            "This recording alone does not determine all parameters.",
            f"{seen.missing} {beside}",
        )
    return Verdict("good", "This recording determines all parameters.", beside)


def of_noise(found: NoiseResult) -> Verdict:
    """Whether the noise figures are reliable."""
    sentence = f"Good: noise figures from {found.duration_s:.5g} s at rest."
    return _judged(found, sentence, found.heading() + ".")


def of_gap(gap: Gap) -> Verdict:
    """The effects missing from the model, and the share of the gap that they close.

    The gap is the part of the residuals that exceeds their noise.
    """
    names = " and ".join(effect["name"] for effect in gap.effects)
    beside = _closed(gap)
    remainder = gap.remainder
    is_left = remainder is not None and remainder.kind != "nothing"
    if gap.laws:
        found = " and ".join(f"{law.formula} ({law.sensor})" for law in gap.laws)
        named = f" beside {names}" if names else ""
        missing = "An error is missing from the model: no effect of the catalogue describes it, but a law "
        if remainder is not None and remainder.matters:
            beside = f"Remainder: {remainder.description}. {beside}"
            return Verdict(
                "incomplete", f"{missing}describes a part of it{named}.", f"{found}. {beside}".strip()
            )
        return Verdict(
            "incomplete" if is_left else "found", f"{missing}does{named}.", f"{found}. {beside}".strip()
        )
    if remainder is not None and gap.effects and gap.has_effects and is_left:
        beside = f"Remainder: {remainder.description}. {beside}"
    if gap.verdict == "named" and remainder is not None and remainder.matters:
        rest = "varies randomly" if remainder.kind == "stochastic" else "has an unknown cause"
        return Verdict(
            "incomplete", f"Missing from the model: {names}. The remaining error {rest}.", beside.strip()
        )
    if gap.verdict == "named":
        return Verdict(
            "incomplete" if is_left else "found", f"Missing from the model: {names}.", beside.strip()
        )
    if gap.verdict == "ambiguous":
        rivals = " or ".join(gap.ambiguous_with)
        return Verdict(
            "open",
            f"Missing from the model: {names}, or {rivals}; these recordings cannot distinguish them.",
            beside,
        )
    mood, sentence = NO_NAME[gap.verdict]
    if gap.verdict == "data_fault":
        beside = f"{names}. {beside}"
    elif gap.remainder is not None and gap.remainder.pattern == "between_sessions":
        sentence = "The biases changed between the calibration recordings and the control recordings."
        changed = str(gap.remainder.description)
        beside = f"{changed[:1].upper()}{changed[1:]}. {beside}"
    elif gap.generic is not None:
        beside = f"{gap.generic['description']}. {beside}"
    return Verdict(mood, sentence, beside.strip())


def _judged(result: CalibrationResult | Evaluation | NoiseResult, good: str, beside: str) -> Verdict:
    if result.verdict == "good":
        return Verdict("good", good, beside)
    first, more = result.reasons[0], len(result.reasons) - 1
    others = f", and {more} more reason{'s' if more > 1 else ''}" if more else ""
    word = "Incomplete" if result.verdict == "incomplete" else "Poor"
    return Verdict(result.verdict, f"{word}: {first}{others}.", beside)


def _better(judged: Evaluation) -> str:
    """A sentence on one figure of merit before and after calibration; empty if none is known.

    The figure of merit is the direction error after moves. If there are no moves, it is the error of the norm
    at rests.
    """
    uncalibrated = judged.before.gravity_direction_rms_deg
    calibrated = judged.figures.gravity_direction_rms_deg
    if uncalibrated is None or calibrated is None:
        return _better_norm(judged)
    return (
        "On the control recordings, the gravity direction propagated over a move has an rms error of "
        f"{calibrated:.2g} deg, compared to {uncalibrated:.2g} deg without calibration."
    )


def _better_norm(judged: Evaluation) -> str:
    """The sentence of `_better` for recordings without moves; empty if the norms at rest are not known."""
    before, after = judged.before.gravity_norm_rms_mps2, judged.figures.gravity_norm_rms_mps2
    if before is None or after is None or judged.moves:
        return ""
    return (
        f"On the control recordings, the norm of gravity at the rests has an rms error of {MG * after:.2g} "
        f"mg, compared to {MG * before:.2g} mg without calibration."
    )


def _closed(gap: Gap) -> str:
    if gap.gap is None or not (gap.verdict in ("named", "ambiguous") or gap.laws):
        return ""
    figure: Mapping[str, Any] = gap.gap
    where = "On the control recordings" if gap.control_set is not None else "On held-out rests and moves"
    if gap.remainder is not None and gap.remainder.session is not None:
        where += ", after a fit of their biases,"
    metric = METRICS.get(figure["metric"], figure["metric"])
    closed = min(100.0, max(0.0, 100 * figure["closed"]))
    return (
        f"{where} {metric} decreases from {figure['before']:.4g} to {figure['after']:.4g}, which closes "
        f"{closed:.0f} % of the gap to its noise floor of {figure['floor']:.3g}."
    )
