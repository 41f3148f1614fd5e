"""Reads recordings in JSON: one document, or one value per line (JSON Lines).

Four forms are known:

    [{"t": 0.01, "acc": [0, 0, 9.8], "gyro": {"x": 0, "y": 0, "z": 0}}, ...]    a list of objects
    {"accelerometer": [{...}, ...], "gyroscope": [{...}, ...]}                  lists of objects by sensor
    {"t": [0.01, ...], "acc": [[0, 0, 9.8], ...], "gx": [0, ...]}               a list per column
    {"sensors": [{"name": "accX", "units": "m/s2"}, ...], "values": [[...]]}    Edge Impulse

`json_tables` finds the tables in the document, and `json_cells` writes each table as a text table.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from imucal.document.source import open_file
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.json_cells import text_of_table
from imucal.io.json_tables import stated_units, tables_of
from imucal.io.remarks import lines_left_out, remark
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.text import content_of
from imucal.recording.recording import Recording

__all__ = ["read_json"]

# Maximum share of lines that are no JSON values, for example after an error on a serial line.
MOST_GARBLED: Final = 0.01


def read_json(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read a recording in JSON.

    columns  "canonical=name,..." for objects that contain both sensors; a member of a member has the name
             `outer.inner`, and the numbers of a list of three are `outer.x`, `outer.y` and `outer.z`

    The other arguments are those of `read_pair`.
    """
    units = units_given(time_unit, accel_unit, gyro_unit, rate_hz)
    file = open_file(path)
    document, findings = _decoded(file.name, content_of(file))
    try:
        tables, nameless = tables_of(document)
    except RecursionError:
        tables, nameless = {}, 0
    except FormatError as error:
        raise FormatError(f"{file.name}: {error}") from None
    if not tables:
        raise FormatError(
            f"{file.name} is JSON without samples in a known form: write a list of objects, each with a time "
            'and the axes of the sensors, such as {"time_s": 0.01, "accel_x_mps2": 0.1, ...}'
        )
    texts = [text_of_table(file, label, rows) for label, rows in tables.items()]
    if nameless:
        findings.append(
            lines_left_out(file.name, [f"{nameless} objects without the name of a sensor"], nameless)
        )
    stated = stated_units(document, tables)
    try:
        recording = recording_of_texts(texts, file.name, columns, rate_hz, units)
    except (FormatError, InputError) as error:
        if not stated:
            raise
        raise type(error)(f"{error}. The file states these units: {stated}") from None
    if stated:
        findings.append(
            remark(
                file.name,
                "read_by_header",
                f"the file states units that were not used: {stated}",
                "compare them with the units of this recording, and give the right ones with --columns",
            )
        )
    if len(recording.sensors) == 1 and len(tables) > 1:
        findings.append(
            remark(
                file.name,
                "sensor_missing",
                f"only the {recording.sensors[0]} was found in the tables {', '.join(tables)[:200]}",
                "if one of them belongs to the other sensor, name it accelerometer or gyroscope",
            )
        )
    return replace(recording, findings=(*recording.findings, *findings))


def _decoded(name: str, content: bytes) -> tuple[Any, list[Finding]]:
    """The value of a document, or the list of the values in its lines, and a warning about skipped lines."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", "replace")
    try:
        return json.loads(text), []
    except RecursionError:
        raise FormatError(f"{name} is JSON with too many levels: write a list of objects") from None
    except ValueError as error:
        reason = str(error)
    lines = [(number, line.strip()) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]
    if lines and lines[0][1] == "[":
        del lines[0]
    values, bad = _values_of_lines(lines)
    # The last line may be incomplete, because the logger was switched off. In a document with one object per
    # line, any other line that is no object separates two lists, whose objects must not be joined.
    first = text.lstrip().partition("\n")[0]
    is_document = (
        first[:1] in ("{", "[") and not _parses(first) and any(line.endswith(",") for _, line in lines)
    )
    most = 0 if is_document else MOST_GARBLED * len(values)
    others = [line for line in bad if line != lines[-1]]
    if not values or len(others) > most:
        raise FormatError(f"{name} is no valid JSON ({reason}): it is cut off or damaged: export it again")
    if not bad:
        return values, []
    number, line = bad[0]
    part = f"{len(bad)} lines that are no JSON (the first: line {number}, {line[:40]!r})"
    return values, [lines_left_out(name, [part], len(bad))]


def _values_of_lines(lines: Sequence[tuple[int, str]]) -> tuple[list[Any], list[tuple[int, str]]]:
    """The values of numbered lines, and the lines that are no JSON values."""
    values, bad = [], []
    for at, (number, line) in enumerate(lines):
        # The first object of a list may be in the line of its bracket.
        inner = line[1:] if at == 0 and line.startswith("[{") and not _parses(line) else line
        try:
            values.append(json.loads(inner.removesuffix(",")))
        except (ValueError, RecursionError):
            bad.append((number, line))
    return values, bad


def _parses(line: str) -> bool:
    try:
        json.loads(line.strip().removesuffix(","))
    except (ValueError, RecursionError):
        return False
    return True
