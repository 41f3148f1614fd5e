"""The page of a search for the missing effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucal import plot
from imucal.document.json_document import to_json
from imucal.plot.evidence import FIGURES, channel_name, figure_sets
from imucal.plot.style import shown_unit
from imucal.report import sentences
from imucal.report.blocks import finding_texts
from imucal.report.page import Shown, Tab, write_page
from imucal.report.tables import file_button, heading, item_list, paragraph, rounded_to, table

if TYPE_CHECKING:
    from imucal.gap import Gap

SIGNALS = {
    "angular_rate_rms_radps": "angular rate, rms, rad/s",
    "specific_force_rms_mps2": "specific force, rms, m/s²",
}
# Rests and moves that stand out are listed up to this number.
MOST_WORST = 12

__all__ = ["effects_table", "gap_figures_table", "write_gap_page"]


def write_gap_page(path: str | Path, gap: Gap) -> None:
    """Write the page of a search.

    Raises ImucalError without plotly, and InputError if the file cannot be written.
    """
    tabs = [Tab("Summary", tuple(_summary(gap)))]
    # Recordings that are refused are not compared with anything.
    where = getattr(gap, "where", None)
    if where:
        tabs.append(Tab("Where", tuple(_where(gap, where))))
    if gap.ranking:
        tabs.append(Tab("Evidence", tuple(_evidence(gap))))
    if gap.calibration_set is not None:
        tabs.append(Tab("Before and after", tuple(_change(gap))))
    if gap.smallest_visible or gap.not_observable:
        tabs.append(Tab("What could be seen", tuple(_visible(gap))))
    if gap.next_motion is not None:
        tabs.append(Tab("Next motion", tuple(_next_motion(gap.next_motion))))
    write_page(path, "What the model misses", tabs, sentences.of_gap(gap))


def effects_table(gap: Gap) -> str:
    """The parameters of what joined the model; empty if nothing did."""
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
    """Figures of all sets, before and after; empty if there are none."""
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
        yield heading("What joined the model")
        yield parameters
    if gap.resembles:
        yield paragraph(f"It looks a little like {', '.join(gap.resembles)}.")
    if gap.ambiguous_with:
        yield paragraph(f"It may as well be {' or '.join(gap.ambiguous_with)}.")
    yield gap_figures_table(gap)
    remarks = list(dict.fromkeys([*gap.notes, *finding_texts(gap.findings)]))
    if remarks:
        yield heading("Worth knowing")
        yield item_list(remarks)


def _where(gap: Gap, where: Mapping[str, Any]) -> Iterator[Shown | str]:
    yield Shown(
        "where",
        plot.disagreement(gap),
        "Residuals of the model over what noise explains, before any effect is named: 1 is noise alone.",
    )
    rows = [
        [
            channel_name(row),
            f"{row['rms']:.3g}",
            f"{row['noise_rms']:.3g}",
            shown_unit(row["unit"]),
            f"{row['times_noise']:.3g}",
            # What acts on the stand's angles leaves no trace in the corrected signals.
            "-" if row["times_noise_after"] is None else f"{row['times_noise_after']:.3g}",
            "stands out" if row["stands_out"] else "",
        ]
        for row in where["channels"]
    ]
    yield table(["channel", "rms", "noise alone", "unit", "times noise", "after", ""], rows)
    if where["depends"]:
        yield heading("What it goes with")
        rows = [
            [
                channel_name(row),
                row["on"].replace("_", " "),
                f"{100 * row['share']:.0f} %",
                f"{row['p_value']:.1g}",
            ]
            for row in where["depends"]
        ]
        yield table(["channel", "goes with", "share of squares", "by chance"], rows, words=(1,))
    for kind, key, unit in (
        ("rests", "norm_error_mps2", "|f| − g, m/s²"),
        ("moves", "direction_error_deg", "direction error, deg"),
    ):
        if where[kind]:
            axis = where.get("turns_about") if kind == "moves" else None
            about = f", all of them turns about {axis}" if axis else ""
            yield heading(f"{kind.capitalize()} that stand out{about}")
            worst = sorted(where[kind], key=lambda item: -item["times_noise"])[:MOST_WORST]
            rows = [
                [
                    f"{item['recording']}, {kind[:-1]} {item['index']}"
                    + (", left out" if item.get("left_out") else ""),
                    f"{item['times_noise']:.2g}",
                    f"{item[key]:.3g}",
                ]
                for item in worst
            ]
            yield table([f"the worst {len(worst)} of {len(where[kind])}", "times noise", unit], rows)


def _evidence(gap: Gap) -> Iterator[Shown | str]:
    yield Shown(
        "ranking",
        plot.ranking(gap),
        "Evidence for each candidate by itself against the model without it. An effect leaves traces that "
        "others explain too: what counts is what is left when the best one has joined.",
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
    but = f" and not what is called {' or '.join(unseen)}" if unseen else ""
    words = f"Without and with what was found. The fits have seen what is called {seen}{but}."
    yield Shown("change", plot.before_and_after(gap), words)
    yield gap_figures_table(gap)
    error = getattr(gap, "corrected_error", None)
    if error:
        yield heading("Predicted error of the corrected signals, averaged over 1 s")
        figures = ("before", "after", "factor", "factor_low", "factor_high")
        rows = [
            [words, *(f"{error[name][figure]:.3g}" for figure in figures)] for name, words in SIGNALS.items()
        ]
        yield table(["", "before", "after", "times less", "95 % interval from", "to"], rows)


def _visible(gap: Gap) -> Iterator[str]:
    if gap.smallest_visible:
        yield paragraph(
            "The smallest size, rms over its parameters, at which these recordings show an effect."
        )
        rows = [
            [name, f"{size['value']:.2g}", shown_unit(size["unit"]) or "1"]
            for name, size in gap.smallest_visible.items()
        ]
        yield table(["effect", "seen from", "unit"], rows)
    if gap.not_observable:
        yield heading("Not to be seen in these recordings")
        yield table(["effect", "it needs"], [[e["name"], e["needs"]] for e in gap.not_observable], words=(1,))


def _next_motion(motion: Any) -> Iterator[str]:
    yield paragraph(motion["description"])
    if motion.get("program") is not None:
        yield file_button("program", "next-motion.json", to_json(motion["program"]))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
