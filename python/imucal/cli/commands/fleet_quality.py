"""`imucal fleet capability` and `grr`: process capability, and gauge repeatability and reproducibility."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imucal.cli.fleet_selection import CsvPath, Selection, StorePath, selection_options, store_of, write_table
from imucal.cli.options import JsonPath
from imucal.cli.output import Output
from imucal.cli.parameters import option
from imucal.units import datasheet, si

if TYPE_CHECKING:
    from imucal.calibration.parameter_text import Units
    from imucal.fleet.statistics.capability import Capability
    from imucal.fleet.statistics.grr import GaugeStudy
    from imucal.limits.limits import Limits

__all__ = ["By", "capability", "grr"]

LimitsOption = Annotated[
    Path | None, option("--limits", metavar="LIMITS", help="Limits file, as of `imucal limits template`.")
]
# The verdict is poor if the performance index Ppk is below LEAST_PPK, or if the number of distinct categories
# (ndc) of a gauge study is below LEAST_CATEGORIES. The limits are from the AIAG manuals Statistical Process
# Control and Measurement Systems Analysis.
LEAST_PPK = 1.0
LEAST_CATEGORIES = 5


class By(str, Enum):
    """Factor of a gauge study: the reproducibility is the spread between operators or between stations."""

    operator = "operator"
    station = "station"


@selection_options
def capability(
    store: StorePath,
    limits: LimitsOption = None,
    output: Annotated[
        Path | None,
        option("--output", "-o", metavar="PATH", help="Limits file to write, with the proposed limits."),
    ] = None,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Compare the units with limits: Cp, Cpk, Pp, Ppk, shares out of limits with and without noise.

    Uses the first calibration of each unit. The verdict is poor if a Ppk is below 1.

    Example: imucal fleet capability units.sqlite --limits limits.json --csv capability.csv
    """
    from imucal.fleet.statistics.capability import proposed_limits

    fleet = store_of(store, csv=csv, json=json, output=output)
    result = fleet.capability(_limits(limits), **selection.given)
    if output is not None:
        proposed_limits(result, fleet.measurements(covariances=False, **selection.given)).save(output)
    headings = (
        *("parameter", "units", "mean", "spread", "low", "high", "noise", "cp", "cpk", "ppk", "ppk_low"),
        *("ppk_high", "out_measured", "out_true", "proposed_min", "proposed_max", "unit"),
    )
    write_table(csv, headings, [_row(row, si) for row in result.rows])
    out = Output(json)
    limited = [row.indices.ppk.value for row in result.rows if row.indices is not None]
    poor = sum(ppk < LEAST_PPK for ppk in limited)
    verdict = "poor" if poor else "good"
    out.document(result.to_dict() | {"verdict": verdict})
    shown = ("parameter", "mean", "spread", "noise", "cp", "cpk", "ppk", "out_measured", "out_true", "unit")
    picked = [headings.index(name) for name in shown]
    rows = [_cells(_row(row, datasheet)) for row in result.rows]
    out.table(shown, [[row[column] for column in picked] for row in rows])
    if output is not None:
        out.line(f"{output}: mean -+ 4 standard deviations of a measured value")
    out.verdict(verdict, [f"{poor} of {len(limited)} indices Ppk are below {LEAST_PPK:g}"] if limited else [])


@selection_options
def grr(
    store: StorePath,
    by: Annotated[By, option("--by", help="Factor of the reproducibility.")] = By.operator,
    limits: LimitsOption = None,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Gauge study: repeatability and reproducibility from units x operators x repeats (analysis of variance).

    Shows repeatability, reproducibility, the number of distinct categories (ndc), and the ratio of the
    repeatability to the stated standard deviations, which is 1 if these are correct on this stand. The
    verdict is poor if a parameter has fewer than 5 categories.

    Example: imucal fleet grr units.sqlite --role grr --by operator --limits limits.json
    """
    fleet = store_of(store, csv=csv, json=json)
    result = fleet.grr(by=by.value, limits=_limits(limits), **selection.given)
    headings = (
        *(
            "parameter",
            "repeatability",
            "reproducibility",
            "grr",
            "units",
            "% of total",
            "ndc",
            "% of tolerance",
        ),
        *("repeatability / stated", "from", "to", "unit"),
    )
    write_table(csv, headings, [_study(study, si) for study in result.studies])
    out = Output(json)
    few = [study.name for study in result.studies if study.ndc is not None and study.ndc < LEAST_CATEGORIES]
    verdict = "poor" if few else "good"
    out.document(result.to_dict() | {"verdict": verdict})
    out.line(f"{result.units} units x {result.operators} {result.by}s x {result.repeats} repeats")
    out.table(headings, [_cells(_study(study, datasheet)) for study in result.studies])
    if result.left_out:
        out.line(f"{result.left_out} calibrations are left out, so that the study is balanced")
    for study in result.studies:
        if study.sigma is not None and not study.sigma.is_honest:
            out.line(
                f"{study.name}: repeats scatter by {study.sigma.factor:.2f} times the stated standard "
                f"deviation ({study.sigma.low:.2f} to {study.sigma.high:.2f})"
            )
    out.verdict(
        verdict, [f"{len(few)} parameters have fewer than {LEAST_CATEGORIES} categories"] if few else []
    )


def _limits(path: Path | None) -> Limits | None:
    import imucal

    return None if path is None else imucal.Limits.load(path)


def _row(row: Capability, units: Units) -> tuple[Any, ...]:
    scale, spread, indices = units(row.name, row.unit), row.spread, row.indices
    return (
        scale.named(row.name),
        row.units,
        None if spread is None else scale.shown(spread.mean),
        *(
            (None,) * 4
            if spread is None
            else (scale.factor * std for std in (spread.spread, spread.low, spread.high, spread.noise))
        ),
        None if indices is None or indices.cp is None else indices.cp.value,
        *((None,) * 4 if indices is None else (indices.cpk.value, *_three(indices.ppk))),
        row.out_measured,
        row.out_true,
        scale.shown(row.proposed_low),
        scale.shown(row.proposed_high),
        scale.unit,
    )


def _three(index: Any) -> tuple[float, float, float]:
    return index.value, index.low, index.high


def _study(study: GaugeStudy, units: Units) -> tuple[Any, ...]:
    grr, sigma, scale = study.component("grr"), study.sigma, units(study.name, study.unit)
    parts = (
        study.component("repeatability"),
        study.component("reproducibility"),
        grr,
        study.component("unit"),
    )
    return (
        scale.named(study.name),
        *(scale.factor * part.std for part in parts),
        100 * grr.study_variation,
        study.ndc,
        None if study.tolerance is None else 100 * study.tolerance,
        *((None,) * 3 if sigma is None else (sigma.factor, sigma.low, sigma.high)),
        scale.unit,
    )


def _cells(row: Sequence[Any]) -> list[str]:
    return ["-" if cell is None else f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row]
