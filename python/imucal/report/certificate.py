"""The certificate of one unit: a page of one sheet, to be printed or saved as PDF by the browser.

Values and standard deviations are in the units of datasheets. A hash of the calibration identifies its
numbers, and the hashes of the recordings identify the data from which they were estimated.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from imucal.document.atomic import write_text
from imucal.limits.limits import Limits
from imucal.report.printed import write_pdf
from imucal.report.tables import figures_table, rounded_to, shown_name, table
from imucal.units import datasheet, significant

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.calibration.triad import Parameter
    from imucal.limits.judgement import Judgement

__all__ = ["calibration_hash", "write_certificate"]


GRAVITY_SOURCES: Final = {
    "standard": "standard gravity was assumed",
    "given": "given",
    "latitude": "normal gravity at the latitude",
    "unknown": "source unknown",
}


def write_certificate(
    path: str | Path,
    calibration: Calibration,
    *,
    limits: Limits | None = None,
    conditions: Mapping[str, str] | None = None,
) -> None:
    """Write the certificate of a unit as one page, atomically; as PDF if the name ends in .pdf, else as HTML.

    limits       limits against which the unit is judged
    conditions   further lines, such as the station and the operator

    Raises InputError if the file cannot be written, or if no browser is installed that prints a PDF.
    """
    judgement = None if limits is None else limits.judge(calibration)
    verdict, reasons = calibration.judged
    if judgement is not None:
        verdict, reasons = judgement.applied(verdict, reasons)
    limits_file = [] if judgement is None or judgement.source is None else [judgement.source]
    serial = calibration.serial_number or "without a number"
    page = _PAGE.format(
        title=escape(f"Calibration certificate of unit {serial}"),
        style=_STYLE,
        serial=escape(serial),
        verdict=escape(verdict),
        reasons="".join(f"<li>{escape(reason)}</li>" for reason in reasons),
        conditions=_pairs(_conditions(calibration, conditions or {})),
        parameters=_parameters(calibration.parameters, judgement),
        figures=_figures(calibration),
        files=_pairs(
            [
                (source.path.rsplit("/", 1)[-1], f"SHA-256 {source.sha256}")
                for source in (
                    *calibration.provenance.files,
                    *calibration.provenance.control_files,
                    *limits_file,
                )
            ]
            or [("recordings", "not recorded")]
        ),
        hash=calibration_hash(calibration),
    )
    write = write_pdf if Path(path).suffix.lower() == ".pdf" else write_text
    write(Path(path), page)


def calibration_hash(calibration: Calibration) -> str:
    """SHA-256 of the fields of the calibration file as JSON with sorted names."""
    text = json.dumps(calibration.to_dict(), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _conditions(calibration: Calibration, given: Mapping[str, str]) -> list[tuple[str, str]]:
    temperature = calibration.temperature_range_degc
    return [
        ("date", calibration.provenance.date or "not recorded"),
        *given.items(),
        (
            "temperature",
            "not recorded" if temperature is None else f"{temperature[0]:.1f} to {temperature[1]:.1f} °C",
        ),
        ("gravity", _gravity(calibration)),
        *([] if calibration.gyroscope is None else [("clock", _clock(calibration.references.clock_ppm))]),
        ("raw units", f"accelerometer {calibration.accel_unit}, gyroscope {calibration.gyro_unit}"),
        ("body frame", calibration.frame),
        ("software", f"imucal {calibration.provenance.imucal_version or 'of unknown version'}"),
    ]


def _gravity(calibration: Calibration) -> str:
    """Local gravity, its source, and whether the standard deviations of the scales include its error."""
    references = calibration.references
    text, source = f"{calibration.gravity_mps2:.6g}", GRAVITY_SOURCES[references.gravity_from]
    if references.gravity_sigma_mps2 is not None:
        return f"{text} ± {references.gravity_sigma_mps2:.2g} m/s², {source}, included in 1 σ"
    return f"{text} m/s², {source}; its error is not included in 1 σ"


def _clock(ppm: float | None) -> str:
    if ppm is None:
        return "taken as exact; its error is not included in 1 σ"
    return f"± {ppm:g} ppm, included in 1 σ"


def _parameters(parameters: Sequence[Parameter], judgement: Judgement | None) -> str:
    ranges = (
        {}
        if judgement is None
        else {check.what: check for check in judgement.checks if check.low is not None}
    )
    rows = []
    for parameter in parameters:
        scale = datasheet(parameter.name, parameter.unit)
        check = ranges.get(parameter.name)
        std = math.nan if parameter.std is None else parameter.std * abs(scale.factor)
        row = [
            shown_name(parameter.name, scale),
            rounded_to(scale.shown(parameter.value), std),
            "-" if parameter.std is None else rounded_to(std, std),
            scale.unit,
        ]
        if judgement is not None:
            low, high = (None, None) if check is None else (check.low, check.high)
            row += [
                "-"
                if low is None or high is None
                else f"{significant(scale.shown(low), 4)} to {significant(scale.shown(high), 4)}",
                "-" if check is None else "pass" if check.passed else "FAIL",
            ]
        rows.append(row)
    header = ["parameter", "value", "1 σ", "unit", *([] if judgement is None else ["limits", ""])]
    failed = [] if judgement is None else [check.reason for check in judgement.failed]
    return table(header, rows) + "".join(f"<p>{escape(reason)}</p>" for reason in failed)


def _figures(calibration: Calibration) -> str:
    sets = {
        "calibration": calibration.calibration_set or {},
        "control": calibration.control_set or {},
    }
    sets = {name: figures for name, figures in sets.items() if figures}
    if not sets:
        return ""
    return figures_table(sets)


def _pairs(pairs: Sequence[tuple[str, Any]]) -> str:
    return "".join(f"<dt>{escape(name)}</dt><dd>{escape(str(value))}</dd>" for name, value in pairs)


_STYLE = """
@page { size: A4; margin: 14mm; }
body { font: 10pt/1.35 system-ui, sans-serif; color: #1a1a1a; background: #fff;
  max-width: 48rem; margin: 1rem auto; }
h1 { font-size: 16pt; margin: 0 0 .2rem; } h2 { font-size: 11pt; margin: .8rem 0 .2rem; }
.verdict { font-size: 13pt; font-weight: 600; }
table { border-collapse: collapse; font-size: 8.5pt; font-variant-numeric: tabular-nums; }
th, td { padding: .08rem .7rem .08rem 0; border-bottom: 1px solid #c9ced4; text-align: right; }
th:first-child { text-align: left; font-weight: normal; }
.fail { color: #b34a00; font-weight: 600; }
dl { display: grid; grid-template-columns: 9rem 1fr; margin: 0; font-size: 9pt; }
dd { margin: 0; overflow-wrap: anywhere; }
"""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>Calibration certificate</h1>
<p class="verdict">Unit {serial}: {verdict}</p>
<ul>{reasons}</ul>
<h2>Conditions</h2>
<dl>{conditions}</dl>
<h2>Parameters: measured = T true + bias</h2>
{parameters}
<h2>Residuals</h2>
{figures}
<h2>Files</h2>
<dl>{files}<dt>calibration</dt><dd>SHA-256 {hash}</dd></dl>
</body>
</html>
"""
