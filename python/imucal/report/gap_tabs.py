"""Contents of the tabs of a search report: residuals, laws, evidence, and figures of merit.

A law is a formula for residuals that no effect of the catalogue describes. The gap is the part of the
residuals that exceeds their noise. Rivals are effects that explain the residuals about as well as the found
effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import imucal.plot as plot
from imucal.document.json_document import to_json
from imucal.gap.sizes import for_people
from imucal.plot.evidence import channel_name, figure_sets
from imucal.plot.style import shown_unit
from imucal.report.gap_tables import RATIO, gap_figures_table
from imucal.report.page import Shown
from imucal.report.tables import file_button, heading, paragraph, table

if TYPE_CHECKING:
    from imucal.gap import Gap
    from imucal.gap.laws.law import Law
    from imucal.gap.own_motion import OwnMotion
    from imucal.gap.temperature_loop import TemperatureLoop

__all__ = ["change", "evidence", "laws", "next_motion", "temperature", "visible", "where"]

SIGNALS = {
    "angular_rate_rms_radps": ("angular rate, rms", "rad/s"),
    "specific_force_rms_mps2": ("specific force, rms", "m/s^2"),
}
# For rests and moves: name of their residual, its field in the result, and the unit of this field.
RESIDUALS = {
    "rests": ("|f| − g", "norm_error_mps2", "m/s^2"),
    "moves": ("direction error", "direction_error_deg", "deg"),
}
# Maximum number of rests, and of moves, listed as having significant residuals.
MOST_WORST = 12
# Maximum number of panels of residuals against a variable.
MOST_PANELS = 4


def where(gap: Gap, motion: OwnMotion | None) -> Iterator[Shown | str]:
    """Residuals by kind and axis, residuals against explaining variables, and the worst rests and moves."""
    found = gap.where or {}
    yield Shown(
        "where",
        plot.disagreement(gap),
        "Residuals of the model without effects, relative to the white noise of the sensors. If noise "
        "explains them, the ratio is 1 or less. The verdict of a calibration uses a smaller noise, because "
        "the fitted parameters absorb a part of it.",
    )
    shown = [] if motion is None else plot.dependences(motion)[:MOST_PANELS]
    if shown:
        yield Shown(
            "against",
            plot.residual_against(shown, has_effects=gap.has_effects),
            "Residuals of rests, and of moves about one axis. The x-axis of each panel is the variable "
            "that explains most of its residuals. A pattern indicates a missing effect. Open markers are "
            "control recordings.",
        )
    yield _channels(found["channels"])
    yield paragraph(
        f"The column “{RATIO}” is the rms of all ratios of a residual to the standard deviation of its own "
        "noise. It exceeds the quotient of the columns “rms” and “noise” if large residuals have a small "
        "noise."
    )
    if found["depends"]:
        yield heading("Correlations of the residuals")
        rows = [
            [
                channel_name(row),
                row["on"].replace("_", " "),
                f"{100 * row['share']:.0f} %",
                f"{row['p_value']:.1g}",
            ]
            for row in found["depends"]
        ]
        yield table(["channel", "correlated with", "explained variance", "p"], rows, words=(1,))
    for kind in RESIDUALS:
        if found[kind]:
            axis = found.get("turns_about") if kind == "moves" else None
            about = f", all of them rotations about {axis}" if axis else ""
            yield heading(f"{kind.capitalize()} with significant residuals{about}")
            yield _worst(kind, found[kind])


def temperature(loops: Sequence[TemperatureLoop]) -> Iterator[Shown | str]:
    """Residuals at rest over temperature, for each sensor with a temperature effect."""
    for loop in loops:
        yield Shown(
            f"loop-{loop.sensor}",
            plot.temperature_loop(loop),
            f"Mean residuals of the {loop.sensor} at rest over temperature. A loop between heating and "
            "cooling is a lag or a hysteresis; a curve without a loop depends on the temperature alone.",
        )


def laws(gap: Gap, motion: OwnMotion | None) -> Iterator[Shown | str]:
    """For each law: formula, parameters, and curve with the residuals."""
    yield paragraph(
        "Laws are formulas for residuals that no effect of the catalogue describes. They are part of the "
        "improved calibration, as effects are."
    )
    for law in gap.laws:
        yield heading(law.formula)
        rows = [_parameter_of_law(parameter) for parameter in law.parameters]
        yield table(["parameter", "value", "1 σ", "unit"], rows)
        if law.nearest:
            yield paragraph(f"Similar effects of the catalogue: {', '.join(law.nearest)}.")
        if law.curve is not None:
            yield _curve(law, motion)


def _parameter_of_law(parameter: Mapping[str, Any]) -> list[str]:
    value, unit = for_people(parameter["value"], parameter["unit"])
    std, _ = for_people(parameter["std"] or 0.0, parameter["unit"])
    return [parameter["name"], f"{value:.4g}", f"{std:.2g}" if std else "-", shown_unit(unit)]


def _curve(law: Law, motion: OwnMotion | None) -> Shown:
    points = {} if motion is None else plot.law_points(motion, law)
    measured = (
        " Markers: the law plus the residual that remains, for each rest or move that shows this error."
        if points
        else ""
    )
    assert law.curve is not None
    return Shown(
        f"law-{law.name}",
        plot.law(law, points),
        f"Error of the {law.sensor} against {law.curve.variable}, relative to its mean, with the 95 % band "
        f"from the standard deviations of the parameters.{measured}",
    )


def evidence(gap: Gap) -> Iterator[Shown | str]:
    """The tab of the evidence: probability of each candidate, sizes of the named effects, and the ranking."""
    has_effects = any(effect["parameters"] for effect in gap.effects)
    none_added = " No candidate was added to the model" + (
        ": a law describes the residuals." if gap.laws else "."
    )
    yield Shown(
        "probabilities",
        plot.probabilities(gap),
        "Probability that a candidate is the first missing effect, for equal prior probabilities of all "
        f"candidates and of no missing effect.{'' if has_effects else none_added}",
    )
    if has_effects:
        yield Shown(
            "sizes",
            plot.effect_sizes(gap),
            "Parameters of the found effects with their 68 % and 95 % intervals, from the curvature of the "
            "likelihood. An interval that contains zero is compatible with no effect on that axis.",
        )
    yield Shown(
        "ranking",
        plot.ranking(gap),
        "Evidence for each candidate, added alone, relative to the model without it. Effects with similar "
        "residuals have similar evidence. Therefore the search adds the best effect and evaluates the others "
        "again.",
        printed=False,
    )
    rows = [
        [
            score["name"],
            # Adding 0.0 removes the sign of a negative zero.
            f"{round(score['log_bayes_factor'], 1) + 0.0:.1f}",
            f"{score['statistic']:.1f}",
            str(score["dof"]),
            f"{score['p_value']:.2g}" if score["p_value"] else "< 1e-300",
        ]
        for score in gap.ranking
    ]
    yield table(["candidate", "log Bayes factor", "χ²", "degrees of freedom", "p"], rows)


def change(gap: Gap) -> Iterator[Shown | str]:
    """The share of the gap that each effect closes, and the figures of merit without and with the effects."""
    if plot.waterfall_steps(gap):
        yield Shown(
            "waterfall",
            plot.waterfall(gap),
            "The gap between the residuals and their noise on control or held-out data, and the share of it "
            "that each effect closes.",
        )
    *unseen, seen = figure_sets(gap)
    but = f", but not the rows “{'” or “'.join(unseen)}”" if unseen else ""
    words = f"Figures of merit without and with the found effects. The fits used the rows “{seen}”{but}."
    yield Shown("change", plot.before_and_after(gap), words)
    yield gap_figures_table(gap)
    error = gap.corrected_error
    if error:
        yield heading("Predicted error of the corrected signals, averaged over 1 s")
        rows = []
        for name, (words, si_unit) in SIGNALS.items():
            before, unit = for_people(error[name]["before"], si_unit)
            after, _ = for_people(error[name]["after"], si_unit)
            factors = [f"{error[name][figure]:.3g}" for figure in ("factor", "factor_low", "factor_high")]
            rows.append([f"{words}, {shown_unit(unit)}", f"{before:.3g}", f"{after:.3g}", *factors])
        yield table(["", "before", "after", "improvement factor", "95 % interval from", "to"], rows)


def visible(gap: Gap) -> Iterator[str]:
    """The detection limit of each effect, and the effects that are not observable in the recordings."""
    if gap.smallest_visible:
        yield paragraph(
            "The smallest size of each effect, rms over its parameters, that is detectable in these "
            "recordings."
        )
        rows = []
        for name, size in gap.smallest_visible.items():
            value, unit = for_people(size["value"], size["unit"])
            rows.append([name, f"{value:.2g}", shown_unit(unit) or "1"])
        yield table(["effect", "detectable from", "unit"], rows)
    if gap.not_observable:
        yield heading("Not observable in these recordings")
        yield table(["effect", "requires"], [[e["name"], e["needs"]] for e in gap.not_observable], words=(1,))


def next_motion(motion: Any) -> Iterator[str]:
    """Description and stand program of the motion that distinguishes the equally plausible effects."""
    yield paragraph(motion["description"])
    if motion.get("program") is not None:
        yield file_button("program", "next-motion.json", to_json(motion["program"]))


def _channels(channels: Any) -> str:
    rows = []
    for row in channels:
        (rms, unit), (noise, _) = (for_people(row[key], row["unit"]) for key in ("rms", "noise_rms"))
        rows.append(
            [
                channel_name(row),
                f"{rms:.3g}",
                f"{noise:.3g}",
                shown_unit(unit),
                f"{row['times_noise']:.3g}",
                # The value is None if the model has an effect that cannot be removed from the samples, such
                # as an error of the stand's encoders.
                "-" if row["times_noise_after"] is None else f"{row['times_noise_after']:.3g}",
                "significant" if row["stands_out"] else "",
            ]
        )
    return table(["channel", "rms", "noise", "unit", RATIO, "after", ""], rows)


def _worst(kind: str, items: Any) -> str:
    name, key, si_unit = RESIDUALS[kind]
    worst = sorted(items, key=lambda item: -item["times_noise"])[:MOST_WORST]
    rows = [
        [
            f"{item['recording']}, {kind[:-1]} {item['index']}"
            + (", excluded" if item.get("left_out") else ""),
            f"{item['times_noise']:.2g}",
            f"{for_people(item[key], si_unit)[0]:.3g}",
        ]
        for item in worst
    ]
    unit = shown_unit(for_people(1.0, si_unit)[1])
    return table([f"the worst {len(worst)} of {len(items)}", "residual / noise", f"{name}, {unit}"], rows)
