"""Tables as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

JUDGEMENTS = {
    "gravity_direction_rms_deg": "direction of gravity carried over one move, rms error, deg",
    "gravity_norm_rms_mps2": "norm of gravity at rest, rms error, m/s²",
    "chi2_per_dof": "chi² per degree of freedom (1 = noise alone)",
    "rests": "rests judged",
    "moves": "moves judged",
}


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of plain text cells; the first column is words, the others are numbers."""
    head = "".join(f"<th scope=col>{escape(cell)}</th>" for cell in header)
    body = "\n".join(
        f"<tr><th scope=row>{escape(first)}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in rest)
        + "</tr>"
        for first, *rest in rows
    )
    return (
        f'<div class="table"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'
    )


def parameter_table(parameters: Iterable[Mapping[str, Any]], truth: Mapping[str, float] | None = None) -> str:
    """Value, one sigma and unit of every parameter; beside the truth where it is known.

    Args:
        parameters: One mapping per parameter with `name`, `value`, `std` (None: not known) and `unit`,
            as in `imucal calibrate --json`.
        truth: True value by parameter name, in the same units (simulated recordings).
    """
    header = ["parameter", "value", "1 σ", "unit"]
    if truth is not None:
        header += ["truth", "error / σ"]
    rows = []
    for parameter in parameters:
        name, value, std = str(parameter["name"]), float(parameter["value"]), parameter["std"]
        sigma = math.nan if std is None else float(std)
        unit = str(parameter["unit"]).replace("^2", "²")
        row = [name, rounded_to(value, sigma), _sigma(sigma), unit]
        if truth is not None:
            row += _beside_truth(value, sigma, truth.get(name))
        rows.append(row)
    return table(header, rows)


def judgement_table(before: Mapping[str, float | None], after: Mapping[str, float | None]) -> str:
    """What a recording says about the unit, uncalibrated and calibrated.

    Args:
        before: Uncalibrated figures by key: `gravity_norm_rms_mps2`, `gravity_direction_rms_deg`,
            `chi2_per_dof`.
        after: The same, calibrated. A key that only one of them has is shown with a dash.
    """
    given = {*after, *before}
    keys = [key for key in JUDGEMENTS if key in given] + sorted(given - set(JUDGEMENTS))
    rows = [
        [JUDGEMENTS.get(key, key), _significant(before.get(key)), _significant(after.get(key))]
        for key in keys
    ]
    return table(["", "uncalibrated", "calibrated"], rows)


def rounded_to(value: float, std: float) -> str:
    """`value` with as many decimals as two significant digits of `std` need."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{max(decimals, 0)}f}"


def _beside_truth(value: float, std: float, truth: float | None) -> list[str]:
    if truth is None:
        return ["-", "-"]
    return [rounded_to(truth, std), f"{(value - truth) / std:+.1f}" if std > 0.0 else "-"]


def _sigma(std: float) -> str:
    return rounded_to(std, std) if math.isfinite(std) else "-"


def _significant(value: float | None) -> str:
    return f"{value:.4g}" if value is not None and math.isfinite(value) else "-"
