"""HTML tables for the result of a search for a missing effect, used on its page and in notebooks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from imucal.gap.sizes import for_people
from imucal.plot.evidence import FIGURES, figure_sets, shown
from imucal.plot.style import shown_unit
from imucal.report.tables import rounded_to, table

if TYPE_CHECKING:
    from imucal.gap import Gap

__all__ = ["RATIO", "effects_table", "gap_figures_table"]

# Header of the column with the rms of residual / sigma. Here sigma is the standard deviation of each residual
# from noise. The value is not the quotient of the rms of the residuals and the rms of sigma.
RATIO: Final = "rms of residual / noise"


def effects_table(gap: Gap) -> str:
    """HTML table with the parameters of the effects added to the model; empty if there are none."""
    rows = []
    for effect in gap.effects:
        for p in effect["parameters"]:
            value, unit = for_people(p["value"], p["unit"])
            std = abs(for_people(p["std"] or 0.0, p["unit"])[0])
            rows.append(
                [
                    f"{effect['name']} {p['name']}",
                    rounded_to(value, std),
                    rounded_to(std, std) if std else "-",
                    shown_unit(unit) or "1",
                ]
            )
    return table(["effect", "value", "1 σ", "unit"], rows) if rows else ""


def gap_figures_table(gap: Gap) -> str:
    """HTML table with the figures of merit of all sets of recordings, without and with the effects.

    Empty if there are no sets.
    """
    known = figure_sets(gap)
    header = ["", *(f"{name}, {when}" for name in known for when in ("before", "after"))]
    rows = [
        [words, *(_number(shown(key, of[when])) for of in known.values() for when in ("before", "after"))]
        for key, words in FIGURES.items()
    ]
    return table(header, rows) if known else ""


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
