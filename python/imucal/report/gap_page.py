"""The report of a search for a missing effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import imucal.plot as plot
import imucal.report.sentences as sentences
from imucal.document.json_document import to_json
from imucal.plot.evidence import FIGURES, channel_name, figure_sets
from imucal.plot.style import shown_unit
from imucal.report.blocks import finding_texts
from imucal.report.page import Shown, Tab, write_page
from imucal.report.tables import file_button, heading, item_list, paragraph, rounded_to, table

if TYPE_CHECKING:
    from imucal.gap import Gap

SIGNALS = {
    "angular_rate_rms_radps": "angular rate, rms, rad/s",
    "specific_force_rms_mps2": "specific force, rms, m/s²",
}
# Maximum number of rests, and of moves, listed as having significant residuals.
MOST_WORST = 12

__all__ = ["effects_table", "gap_figures_table", "write_gap_page"]


def write_gap_page(path: str | Path, gap: Gap) -> None:
    """Write the report of a search.

    Raises ImucalError without plotly, and InputError if the file cannot be written.
    """
    tabs = [Tab("Summary", tuple(_summary(gap)))]
    # There are no residuals if the recordings were refused.
    where = getattr(gap, "where", None)
    if where:
        tabs.append(Tab("Where", tuple(_where(gap, where))))
    if gap.laws:
        tabs.append(Tab("Laws", tuple(_laws(gap))))
    if gap.ranking:
        tabs.append(Tab("Evidence", tuple(_evidence(gap))))
    if gap.calibration_set is not None:
        tabs.append(Tab("Before and after", tuple(_change(gap))))
    if gap.smallest_visible or gap.not_observable:
        tabs.append(Tab("Detectable effects", tuple(_visible(gap))))
    if gap.next_motion is not None:
        tabs.append(Tab("Next motion", tuple(_next_motion(gap.next_motion))))
    write_page(path, "Missing effects", tabs, sentences.of_gap(gap))


def effects_table(gap: Gap) -> str:
    """HTML table with the parameters of the effects added to the model; empty if there are none."""
    rows = [
        [
            f"{effect['name']} {p['name']}",
            rounded_to(p["value"], p["std"] or 0.0),
            rounded_to(p["std"], p["std"]) if p["std"] else "-",
            shown_unit(p["unit"]) or "1",
        ]
        for effect in gap.effects
        for p in effect["parameters"]
    ]
    return table(["effect", "value", "1 σ", "unit"], rows) if rows else ""


def gap_figures_table(gap: Gap) -> str:
    """HTML table with the figures of all sets before and after the effects were added; empty without sets."""
    known = figure_sets(gap)
    header = ["", *(f"{name}, {when}" for name in known for when in ("before", "after"))]
    rows = [
        [words, *(_number(of[when].get(key)) for of in known.values() for when in ("before", "after"))]
        for key, words in FIGURES.items()
    ]
    return table(header, rows) if known else ""


def _summary(gap: Gap) -> Iterator[str]:
    parameters = effects_table(gap)
    if parameters:
        yield heading("Effects added to the model")
        yield parameters
    if (gap.effects or gap.laws) and gap.remainder is not None:
        yield heading("Remainder")
        words = gap.remainder.description or "noise explains what the effects leave"
        yield paragraph(f"{gap.remainder.kind}: {words} (p {gap.remainder.p_value:.2g}).")
    if gap.resembles:
        yield paragraph(f"The residuals weakly resemble {', '.join(gap.resembles)}.")
    if gap.ambiguous_with:
        yield paragraph(f"Equally plausible: {' or '.join(gap.ambiguous_with)}.")
    yield gap_figures_table(gap)
    remarks = list(dict.fromkeys([*gap.notes, *finding_texts(gap.findings)]))
    if remarks:
        yield heading("Notes")
        yield item_list(remarks)


def _where(gap: Gap, where: Mapping[str, Any]) -> Iterator[Shown | str]:
    yield Shown(
        "where",
        plot.disagreement(gap),
        "Residuals of the model without effects, relative to their noise: 1 means that noise explains them.",
    )
    rows = [
        [
            channel_name(row),
            f"{row['rms']:.3g}",
            f"{row['noise_rms']:.3g}",
            shown_unit(row["unit"]),
            f"{row['times_noise']:.3g}",
            # Effects on the stand's angles are not part of the corrected signals.
            "-" if row["times_noise_after"] is None else f"{row['times_noise_after']:.3g}",
            "significant" if row["stands_out"] else "",
        ]
        for row in where["channels"]
    ]
    yield table(["channel", "rms", "noise", "unit", "rms / noise", "after", ""], rows)
    if where["depends"]:
        yield heading("Correlations of the residuals")
        rows = [
            [
                channel_name(row),
                row["on"].replace("_", " "),
                f"{100 * row['share']:.0f} %",
                f"{row['p_value']:.1g}",
            ]
            for row in where["depends"]
        ]
        yield table(["channel", "correlated with", "explained variance", "p"], rows, words=(1,))
    for kind, key, unit in (
        ("rests", "norm_error_mps2", "|f| − g, m/s²"),
        ("moves", "direction_error_deg", "direction error, deg"),
    ):
        if where[kind]:
            axis = where.get("turns_about") if kind == "moves" else None
            about = f", all of them rotations about {axis}" if axis else ""
            yield heading(f"{kind.capitalize()} with significant residuals{about}")
            worst = sorted(where[kind], key=lambda item: -item["times_noise"])[:MOST_WORST]
            rows = [
                [
                    f"{item['recording']}, {kind[:-1]} {item['index']}"
                    + (", excluded" if item.get("left_out") else ""),
                    f"{item['times_noise']:.2g}",
                    f"{item[key]:.3g}",
                ]
                for item in worst
            ]
            yield table([f"the worst {len(worst)} of {len(where[kind])}", "residual / noise", unit], rows)


def _laws(gap: Gap) -> Iterator[Shown | str]:
    yield paragraph(
        "Formulas that describe what no effect of the catalogue does. They are part of the improved "
        "calibration like any other effect."
    )
    for law in gap.laws:
        yield heading(law.formula)
        rows = [
            [p["name"], f"{p['value']:.4g}", f"{p['std']:.2g}" if p["std"] else "-", shown_unit(p["unit"])]
            for p in law.parameters
        ]
        yield table(["parameter", "value", "1 σ", "unit"], rows)
        if law.nearest:
            yield paragraph(f"Similar effects of the catalogue: {', '.join(law.nearest)}.")
        if law.curve is not None:
            yield Shown(
                f"law-{law.name}",
                plot.law(law),
                f"Error of the {law.sensor} over {law.curve.variable}, relative to its mean, with the 95 % "
                "band of its parameters.",
            )


def _evidence(gap: Gap) -> Iterator[Shown | str]:
    yield Shown(
        "ranking",
        plot.ranking(gap),
        "Evidence for each single candidate relative to the model without it. Effects with similar "
        "signatures score similarly; the search therefore adds the best one and scores the others again.",
    )
    rows = [
        [
            score["name"],
            f"{score['log_bayes_factor']:.1f}",
            f"{score['statistic']:.1f}",
            str(score["dof"]),
            f"{score['p_value']:.2g}",
        ]
        for score in gap.ranking
    ]
    yield table(["candidate", "log Bayes factor", "χ²", "degrees of freedom", "p"], rows)


def _change(gap: Gap) -> Iterator[Shown | str]:
    *unseen, seen = figure_sets(gap)
    but = f" but not the sets named {' or '.join(unseen)}" if unseen else ""
    words = f"Figures without and with the found effects. The fits have used the set named {seen}{but}."
    yield Shown("change", plot.before_and_after(gap), words)
    yield gap_figures_table(gap)
    error = getattr(gap, "corrected_error", None)
    if error:
        yield heading("Predicted error of the corrected signals, averaged over 1 s")
        figures = ("before", "after", "factor", "factor_low", "factor_high")
        rows = [
            [words, *(f"{error[name][figure]:.3g}" for figure in figures)] for name, words in SIGNALS.items()
        ]
        yield table(["", "before", "after", "improvement factor", "95 % interval from", "to"], rows)


def _visible(gap: Gap) -> Iterator[str]:
    if gap.smallest_visible:
        yield paragraph(
            "The smallest size of each effect, rms over its parameters, that is detectable in these "
            "recordings."
        )
        rows = [
            [name, f"{size['value']:.2g}", shown_unit(size["unit"]) or "1"]
            for name, size in gap.smallest_visible.items()
        ]
        yield table(["effect", "detectable from", "unit"], rows)
    if gap.not_observable:
        yield heading("Not observable in these recordings")
        yield table(["effect", "requires"], [[e["name"], e["needs"]] for e in gap.not_observable], words=(1,))


def _next_motion(motion: Any) -> Iterator[str]:
    yield paragraph(motion["description"])
    if motion.get("program") is not None:
        yield file_button("program", "next-motion.json", to_json(motion["program"]))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
