"""Reads recordings in JSON: one document, or one value per line (JSON Lines).

The samples become the rows of text tables (see `json_tables`), which are read like the text files of sensors.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from imucal.document.source import open_file
from imucal.errors import FormatError
from imucal.finding import Finding
from imucal.io.json_tables import MOST_COLUMNS, Row, tables_of
from imucal.io.layout import Layout
from imucal.io.remarks import lines_left_out
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.sensor_rows import SensorRows, rows_by_sensor, texts_of_rows
from imucal.io.text import Text, content_of
from imucal.recording.recording import Recording

__all__ = ["read_json"]

# Maximum share of lines that are no JSON values, for example after an error on a serial line.
MOST_GARBLED: Final = 0.01
# Matches a line at which a list or an object of a document starts. A document has one such line per list.
OPENING: Final = r"\"\s*:\s*[\[{]\s*$"


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
        tables = tables_of(file.name, document)
    except RecursionError:
        tables = {}
    if not tables:
        raise FormatError(
            f"{file.name} is JSON without samples in a known form: write a list of objects, each with a time "
            'and the axes of the sensors, such as {"time_s": 0.01, "accel_x_mps2": 0.1, ...}'
        )
    whole = Text(file.name, b"", Layout(None, None, [], ",", ".", 0, 1, 0, []), (file.source,))
    texts: list[Text] = []
    for label, rows in tables.items():
        apart = _apart(file.name, rows)
        if apart is None:
            texts += texts_of_rows(whole, {label: _cells(file.name, rows)})
        else:
            of_table = Text(f"{file.name} ({label})", b"", whole.layout, whole.sources) if label else whole
            texts += texts_of_rows(of_table, apart.tables)
            findings += apart.findings(of_table.name)
    recording = recording_of_texts(texts, file.name, columns, rate_hz, units)
    return replace(recording, findings=(*recording.findings, *findings))


def _decoded(name: str, content: bytes) -> tuple[Any, list[Finding]]:
    """The value of a document, or the list of the values in its lines, and a warning about skipped lines."""
    text = content.decode(errors="replace").removeprefix("\ufeff")
    try:
        return json.loads(text), []
    except RecursionError:
        raise FormatError(f"{name} is JSON with too many levels: write a list of objects") from None
    except ValueError as error:
        reason = str(error)
    values, bad = [], []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip(" \t\r,[]"):
            try:
                values.append(json.loads(line.strip().removesuffix(",")))
            except (ValueError, RecursionError):
                bad.append((number, line))
    # The last line may be incomplete, because the logger was switched off. Lines of several lists in a cut
    # document must not be mixed.
    is_mixed = sum(re.search(OPENING, line) is not None for _, line in bad) > 1
    if not values or is_mixed or len(bad) > 1 + MOST_GARBLED * len(values):
        raise FormatError(f"{name} is no valid JSON ({reason}): export it again")
    if not bad:
        return values, []
    number, line = bad[0]
    part = f"{len(bad)} lines that are no JSON (the first: line {number}, {line[:40]!r})"
    return values, [lines_left_out(name, [part], len(bad))]


def _apart(name: str, rows: Sequence[Row]) -> SensorRows | None:
    """The rows of each sensor if a member names the sensor of each object; otherwise None."""
    names, *cells = _cells(name, rows)
    return rows_by_sensor(names, cells)


def _cells(name: str, rows: Sequence[Row]) -> Iterator[list[Any]]:
    """A header and the cells of each row; cells that a row lacks are empty."""
    names: dict[str, None] = {}
    for row in rows:
        names |= dict.fromkeys(row)
        if len(names) > MOST_COLUMNS:
            raise FormatError(
                f"{name} has objects with more than {MOST_COLUMNS} different names, such as "
                f"{', '.join(list(names)[:3])}: write each time stamp as a member, and not as a name"
            )
    yield list(names)
    for row in rows:
        yield [row.get(own) for own in names]
