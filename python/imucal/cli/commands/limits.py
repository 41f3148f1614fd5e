"""`imucal limits`: writing a first limits file, and checking many units against a limits file."""

from __future__ import annotations

import csv as csv_module
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from click.exceptions import Exit

from imucal.cli.group import Commands
from imucal.cli.options import JsonPath, Require, Required, writing_option
from imucal.cli.output import NO_RESULT, Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.working import working
from imucal.errors import ImucalError

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.limits.judgement import Judgement

__all__ = ["app"]

SCHEMA: Final = "imucal.limits-check/1"

app = Commands(
    "limits",
    help="Limits for units: write a first limits file from good units, and check units against it.",
    epilog="Example: imucal limits check limits.json unit-*.json --csv day.csv",
)

Calibrations = Annotated[list[Path], argument(metavar="CAL...", help="Calibration files, one for each unit.")]


@app.subcommand
def template(
    calibrations: Calibrations,
    output: Annotated[Path, writing_option("Limits file to write.")],
    deviations: Annotated[
        float,
        option(
            "--deviations", help="Ranges are the mean +- this number of standard deviations over the units."
        ),
    ] = 4.0,
    json: JsonPath = None,
) -> None:
    """Write a limits file from the spread of good units, to be edited.

    Example: imucal limits template good-*.json -o limits.json
    """
    import imucal
    from imucal.limits.template import limits_from

    require_apart(calibrations, {"--output": output, "--json": json})
    limits = limits_from([imucal.Calibration.load(path) for path in calibrations], deviations=deviations)
    limits.save(output)
    out = Output(json)
    out.document(limits.to_dict())
    # The uncertainty of a standard deviation s that is estimated from n normal values is s / sqrt(2 (n - 1)).
    doubt = 100 / (2 * (len(calibrations) - 1)) ** 0.5
    out.line(f"{output}: {limits.description}; the uncertainty of their spread is {doubt:.0f} %")


@app.subcommand
def check(
    limits: Annotated[Path, argument(metavar="LIMITS", help="Limits file.")],
    calibrations: Calibrations,
    csv: Annotated[Path | None, option("--csv", metavar="PATH", help="Also write the table as CSV.")] = None,
    require: Require = Required.incomplete,
    json: JsonPath = None,
) -> None:
    """Check calibration files against limits, one line per unit.

    An unreadable file gets the verdict no_result and the exit code is 1, but all other files are checked.

    Example: imucal limits check limits.json unit-*.json --csv day.csv
    """
    import imucal
    from imucal.document.atomic import write_text
    from imucal.document.date import now
    from imucal.document.plain import plain

    require_apart([limits, *calibrations], {"--csv": csv, "--json": json})
    loaded: list[Calibration | ImucalError] = []
    with working("reading", len(calibrations)) as stage:
        for path in calibrations:
            try:
                loaded.append(imucal.Calibration.load(path))
            except ImucalError as error:
                loaded.append(error)
            stage.step()
        own = {
            effect.name: effect
            for unit in loaded
            if not isinstance(unit, ImucalError)
            for effect in unit.user_effects
        }
        wanted = imucal.Limits.load(limits, user_effects=tuple(own.values()))
    judged = [None if isinstance(unit, ImucalError) else wanted.judge(unit) for unit in loaded]
    rows = [_row(*unit) for unit in zip(calibrations, loaded, judged, strict=True)]
    poor = sum(row["verdict"] == "poor" for row in rows)
    unread = [row for row in rows if row["verdict"] == "no_result"]
    incomplete = sum(row["verdict"] == "incomplete" for row in rows)
    verdict = "no_result" if unread else "poor" if poor else "incomplete" if incomplete else "good"
    warnings = _warnings(rows)
    if csv is not None:
        write_text(csv, _csv_text(rows))
    out = Output(json)
    out.document(
        {
            "schema": SCHEMA,
            "verdict": verdict,
            "units": [
                {
                    **row,
                    "judgement": None if judgement is None else judgement.to_dict(),
                    "provenance": None if isinstance(unit, ImucalError) else plain(unit.provenance),
                }
                for row, unit, judgement in zip(rows, loaded, judged, strict=True)
            ],
            "warnings": warnings,
            "imucal_version": imucal.__version__,
            "date": now(),
        }
    )
    out.table(
        ("serial number", "verdict", "failed", "worst check", "value", "limit", "unit"),
        [_shown(row, judgement) for row, judgement in zip(rows, judged, strict=True)],
    )
    for row in unread:
        out.line(f"no result: {row['reasons'][0]}")
    for warning in warnings:
        out.line(f"warning: {warning}")
    out.verdict(
        verdict,
        [
            *([f"{len(unread)} of {len(rows)} files cannot be checked"] if unread else []),
            *([f"{poor} of {len(rows)} units do not pass"] if poor else []),
            *([f"{incomplete} of {len(rows)} units are incomplete"] if incomplete else []),
        ],
        require,
    )
    if unread:
        raise Exit(NO_RESULT)


def _row(path: Path, unit: Calibration | ImucalError, judgement: Judgement | None) -> dict[str, Any]:
    """The table row of one unit; `unit` is its calibration, or the error if the file could not be read."""
    row: dict[str, Any] = {
        "serial_number": None,
        "file": str(path),
        "date": "",
        "verdict": "no_result",
        "checks": 0,
        "failed": 0,
        "warnings": 0,
        "worst_check": "",
        "value": None,
        "min": None,
        "max": None,
        "unit": "",
        "reasons": [str(unit)],
    }
    if isinstance(unit, ImucalError) or judgement is None:
        return row
    verdict, own = unit.judged
    reasons = [*judgement.reasons, *own]
    worst = judgement.by_use[0]
    return row | {
        "serial_number": unit.serial_number,
        "date": unit.provenance.date,
        "verdict": verdict if judgement.passed else "poor",
        "checks": len(judgement.checks),
        "failed": len(judgement.failed),
        "warnings": len(judgement.warnings),
        "worst_check": worst.what,
        "value": worst.value,
        "min": worst.low,
        "max": worst.high,
        "unit": worst.unit,
        "reasons": reasons,
    }


def _warnings(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings for files given twice, and for serial numbers that occur in several files."""
    files = set()
    units: dict[str, list[str]] = {}
    warnings = []
    for row in rows:
        file = Path(row["file"]).absolute()
        if file in files:
            warnings.append(f"{row['file']} is given twice, so it is one unit counted twice")
            continue
        files.add(file)
        if row["serial_number"]:
            units.setdefault(row["serial_number"], []).append(row["file"])
    for serial_number, names in units.items():
        if len(names) > 1:
            warnings.append(
                f"the serial number {serial_number} occurs in {' and '.join(names)}, which count as "
                f"{len(names)} units"
            )
    return warnings


def _shown(row: Mapping[str, Any], judgement: Judgement | None) -> list[str]:
    if judgement is None:
        return [row["file"], row["verdict"], *["-"] * 5]
    worst = judgement.by_use[0]
    return [
        row["serial_number"] or row["file"],
        row["verdict"],
        str(row["failed"]),
        worst.what,
        worst.value_text,
        worst.limit_text,
        worst.unit,
    ]


def _csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv_module.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**row, "reasons": "; ".join(row["reasons"])} for row in rows)
    return text.getvalue()
