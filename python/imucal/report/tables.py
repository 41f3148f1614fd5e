"""Tables, lists and paragraphs as HTML, for pages and notebooks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

from imucal.document.plain import plain
from imucal.plot.style import shown_unit
from imucal.units import SHOWN, Scale, datasheet

if TYPE_CHECKING:
    from imucal.calibration.triad import Parameter
    from imucal.limits.judgement import Judgement

FIGURES = {
    "gravity_direction_rms_deg": "gravity direction propagated over one move, rms error, deg",
    "gravity_norm_rms_mps2": "|f| − g at rest, rms, mg",
    "chi2_per_dof": "χ² per degree of freedom (1: noise only)",
    "rests": "rests evaluated",
    "moves": "moves evaluated",
}
# Maximum number of items of a list on a page. The JSON document contains all items.
MOST_ITEMS = 40
# A table with more columns than this number is too wide for one of the two columns of a printed page at
# normal text size.
WIDE = 5


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{escape(text)}</p>"


def heading(text: str) -> str:
    """A heading inside a tab."""
    return f"<h3>{escape(text)}</h3>"


def item_list(items: Sequence[str]) -> str:
    """A list of plain texts with at most `MOST_ITEMS` items; empty if there are no items."""
    if not items:
        return ""
    shown = [f"<li>{escape(item)}</li>" for item in items[:MOST_ITEMS]]
    if len(items) > MOST_ITEMS:
        shown.append(f"<li>and {len(items) - MOST_ITEMS} more, see --json</li>")
    return "<ul>\n" + "\n".join(shown) + "\n</ul>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], words: Sequence[int] = ()) -> str:
    """A table of plain text. The first column and the columns `words` contain words, all others numbers."""

    def kind(column: int, cell: str) -> str:
        return ' class="words"' if column in words else (' class="fail"' if cell == "FAIL" else "")

    head = "".join(f"<th scope=col{kind(i, cell)}>{escape(cell)}</th>" for i, cell in enumerate(header))
    head = f"<thead><tr>{head}</tr></thead>\n" if any(header) else ""
    body = "\n".join(
        # Long parameter names may break after an underscore, to fit on the screen of a phone.
        f"<tr><th scope=row>{escape(first).replace('_', '_<wbr>')}</th>"
        + "".join(f"<td{kind(i, cell)}>{escape(cell)}</td>" for i, cell in enumerate(rest, start=1))
        + "</tr>"
        for first, *rest in rows
    )
    # On paper, a wide table has smaller text, so that it fits into one of the two columns of a page.
    wide = " wide" if len(header) > WIDE else ""
    return f'<div class="table{wide}"><table>{head}<tbody>\n{body}\n</tbody></table></div>'


def parameter_table(parameters: Iterable[Parameter], truth: Mapping[str, float] | None = None) -> str:
    """Value and standard deviation of every parameter in the units of datasheets.

    With `truth`, which has true values in SI units by name, the table also has the true value and the error.
    """
    header = ["parameter", "value", "1 σ", "unit", *(["truth", "error / σ"] if truth else [])]
    rows = []
    for p in parameters:
        scale = datasheet(p.name, p.unit)
        std = math.nan if p.std is None else abs(scale.factor) * p.std
        value = scale.shown(p.value)
        row = [
            shown_name(p.name, scale),
            rounded_to(value, std),
            rounded_to(std, std) if p.std else "-",
            shown_unit(scale.unit) or "1",
        ]
        if truth:
            true = truth.get(p.name)
            row += _beside_truth(value, std, None if true is None else scale.shown(true))
        rows.append(row)
    return table(header, rows)


def shown_name(name: str, scale: Scale) -> str:
    """The name of a parameter in a table. A diagonal entry in ppm is shown as its difference from 1."""
    return scale.named(name).replace("-", "−")


def figures_table(columns: Mapping[str, object]) -> str:
    """Figures of merit, one column per set of recordings; sets that are None are omitted."""
    sets = {name: plain(figures) for name, figures in columns.items() if figures is not None}
    keys = [key for key in FIGURES if any(key in figures for figures in sets.values())]
    rows = [[FIGURES[key], *(_figure(key, figures.get(key)) for figures in sets.values())] for key in keys]
    return table(["", *sets], rows)


def checks_table(judgement: Judgement) -> str:
    """Every check with its limit. Failed checks come first, then the checks closest to their limits."""
    rows = [
        [c.what, c.value_text, c.limit_text, shown_unit(c.unit), "pass" if c.passed else "FAIL"]
        for c in judgement.by_use
    ]
    return table(["check", "value", "limit", "unit", ""], rows)


def rounded_to(value: float, std: float) -> str:
    """`value` with the decimals needed to show two significant digits of `std`."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{max(decimals, 0)}f}"


def _beside_truth(value: float, std: float, truth: float | None) -> list[str]:
    if truth is None:
        return ["-", "-"]
    return [rounded_to(truth, std), f"{(value - truth) / std:+.1f}" if std > 0.0 else "-"]


def _figure(key: str, value: float | None) -> str:
    if value is not None and key.endswith("_mps2"):
        value *= SHOWN["m/s^2"][0]
    return f"{value:.4g}" if value is not None and math.isfinite(value) else "-"


def file_button(name: str, file: str, text: str) -> str:
    """A text shown on the page with a button that saves it to a file.

    name   identifier of the text in the page
    file   proposed name of the saved file
    """
    return (
        f'<button type="button" hidden data-from="{escape(name)}" data-file="{escape(file)}">'
        f'Save {escape(file)}</button>\n<pre id="{escape(name)}">{escape(text)}</pre>'
    )
