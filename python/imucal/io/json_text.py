"""Reads recordings in JSON: one document, or one value per line (JSON Lines).

Four forms are known:

    [{"t": 0.01, "acc": [0, 0, 9.8], "gyro": {"x": 0, "y": 0, "z": 0}}, ...]    a list of objects
    {"accelerometer": [{...}, ...], "gyroscope": [{...}, ...]}                  lists of objects by sensor
    {"t": [0.01, ...], "acc": [[0, 0, 9.8], ...], "gx": [0, ...]}               a list per column
    {"sensors": [{"name": "accX", "units": "m/s2"}, ...], "values": [[...]]}    Edge Impulse

The objects become the rows of a text table: the column `acc.x` is the member `x`, or the first number, of the
member `acc`. If a member names the sensor of each object, each sensor has a table of its own.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeAlias

from imucal.document.source import open_file
from imucal.errors import FormatError
from imucal.finding import Finding
from imucal.io.first_cells import HEAD_ROWS
from imucal.io.header import sensor_column
from imucal.io.layout import Layout
from imucal.io.remarks import lines_left_out
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.sensor_rows import texts_of_rows
from imucal.io.text import Text, content_of
from imucal.recording.recording import Recording

__all__ = ["read_json"]

# The cells of one object by column name.
Row: TypeAlias = dict[str, Any]
# Maximum share of lines that are no JSON values, for example after an error on a serial line.
MOST_GARBLED: Final = 0.01
# Maximum number of objects and lists around the samples.
MOST_LEVELS: Final = 4
AXES: Final = "xyz"


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
        tables = _tables(document)
    except RecursionError:
        tables = {}
    if not tables:
        raise FormatError(
            f"{file.name} is JSON without samples in a known form: write a list of objects, each with a time "
            'and the axes of the sensors, such as {"time_s": 0.01, "accel_x_mps2": 0.1, ...}'
        )
    whole = Text(file.name, b"", Layout(None, None, [], ",", ".", 0, 1, 0, []), (file.source,))
    texts = texts_of_rows(whole, {sensor: _cells(rows) for sensor, rows in tables.items()})
    recording = recording_of_texts(texts, file.name, columns, rate_hz, units)
    return replace(recording, findings=(*recording.findings, *findings))


def _decoded(name: str, content: bytes) -> tuple[Any, list[Finding]]:
    """The value of a document, or the list of the values in its lines, and a warning about skipped lines."""
    text = content.decode(errors="replace")
    try:
        return json.loads(text), []
    except RecursionError:
        raise FormatError(f"{name} is JSON with too many levels: write a list of objects") from None
    except ValueError as error:
        reason = str(error)
    values, bad = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip(" \t\r,[]"):
            try:
                values.append(json.loads(line.strip().removesuffix(",")))
            except (ValueError, RecursionError):
                bad.append((number, line))
    # The last line may be incomplete, because the logger was switched off.
    if not values or len(bad) > 1 + MOST_GARBLED * len(values):
        raise FormatError(f"{name} is no valid JSON ({reason}): export it again")
    if not bad:
        return values, []
    number, line = bad[0]
    part = f"{len(bad)} lines that are no JSON (the first: line {number}, {line[:40]!r})"
    return values, [lines_left_out(name, [part], len(bad))]


def _tables(document: Any) -> dict[str, list[Row]]:
    """The rows of each sensor; the key is "" if rows contain both sensors. Empty for an unknown form."""
    if isinstance(document, dict):
        for inner in _objects(document, MOST_LEVELS):
            table = _of_edge_impulse(inner) or _of_columns(inner)
            if table:
                return {"": table}
    lists = dict(_lists(document, "", MOST_LEVELS))
    if len(lists) > 1:
        return lists
    rows = [row for own in lists.values() for row in own if row]
    # All names occur in the first rows of a sensor, but the rows of the other sensor may follow much later.
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = {
        name: list(dict.fromkeys(row[name] for row in rows if isinstance(row.get(name), str)))[:HEAD_ROWS]
        for name in names
    }
    sensor = sensor_column(cells)
    if sensor is None:
        return {"": rows} if rows else {}
    tables: dict[str, list[Row]] = {}
    for row in rows:
        if isinstance(own := row.pop(sensor, None), str):
            tables.setdefault(own, []).append(row)
    return tables


def _objects(document: Mapping[str, Any], levels: int) -> Iterator[Mapping[str, Any]]:
    """The object and the objects in it."""
    yield document
    if levels:
        for value in document.values():
            if isinstance(value, dict):
                yield from _objects(value, levels - 1)


def _lists(value: Any, path: str, levels: int) -> Iterator[tuple[str, list[Row]]]:
    """The lists of objects in a value, each with its path, such as `left.accelerometer`.

    If the objects of a list contain lists of objects, as the messages of some apps do, the inner lists are
    joined.
    """
    if isinstance(value, list) and value and all(isinstance(own, dict) for own in value) and levels:
        within = [(at, rows) for own in value for at, rows in _lists(own, "", levels - 1)]
        if not within:
            yield path, [_flat(own) for own in value]
            return
        joined: dict[str, list[Row]] = {}
        for at, rows in within:
            joined.setdefault(at, []).extend(rows)
        yield from joined.items()
    elif isinstance(value, dict) and levels:
        for at, own in value.items():
            yield from _lists(own, f"{path}.{at}" if path else str(at), levels - 1)


def _flat(value: Mapping[str, Any], outer: str = "") -> Row:
    """The cells of an object; the names of members of members are joined by points."""
    row: Row = {}
    for name, own in value.items():
        if isinstance(own, dict):
            row |= _flat(own, f"{outer}{name}.")
        elif isinstance(own, list) and len(own) == len(AXES):
            row |= {f"{outer}{name}.{axis}": number for axis, number in zip(AXES, own, strict=True)}
        elif isinstance(own, (str, int, float)) or own is None:
            row[f"{outer}{name}"] = own
    return row


def _of_edge_impulse(value: Mapping[str, Any]) -> list[Row]:
    """The rows of a file of Edge Impulse, which gives the name and the unit of each column."""
    sensors, values, step_ms = value.get("sensors"), value.get("values"), value.get("interval_ms")
    if not (isinstance(sensors, list) and isinstance(values, list)):
        return []
    if not all(isinstance(own, dict) and "name" in own for own in sensors):
        return []
    names = [f"{own['name']} ({own['units']})" if own.get("units") else str(own["name"]) for own in sensors]
    if not all(isinstance(row, list) and len(row) == len(names) for row in values):
        return []
    if not isinstance(step_ms, (int, float)):
        return [dict(zip(names, row, strict=True)) for row in values]
    times: list[Row] = [{"time (ms)": at * step_ms} for at in range(len(values))]
    return [time | dict(zip(names, row, strict=True)) for time, row in zip(times, values, strict=True)]


def _of_columns(value: Mapping[str, Any]) -> list[Row]:
    """The rows of an object with one list of numbers per column, also in the forms that pandas writes."""
    names, data = value.get("columns"), value.get("data")
    if isinstance(names, list) and isinstance(data, list):
        if not all(isinstance(row, list) and len(row) == len(names) for row in data):
            return []
        return [dict(zip(map(str, names), row, strict=True)) for row in data]
    lists = {name: column for name, column in _columns(value, "") if len(column) > len(AXES)}
    lengths = {len(column) for column in lists.values()}
    if len(lists) <= len(AXES) or len(lengths) != 1:
        return []
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]


def _columns(value: Mapping[str, Any], outer: str) -> Iterator[tuple[str, list[Any]]]:
    for name, own in value.items():
        if isinstance(own, list) and not any(isinstance(cell, (list, dict)) for cell in own):
            yield f"{outer}{name}", own
        elif isinstance(own, list) and all(isinstance(row, list) and len(row) == len(AXES) for row in own):
            yield from ((f"{outer}{name}.{axis}", [row[at] for row in own]) for at, axis in enumerate(AXES))
        elif isinstance(own, dict) and own and all(key.isdigit() for key in own):
            # pandas writes each column as an object whose keys are the row labels.
            yield f"{outer}{name}", list(own.values())
        elif isinstance(own, dict):
            yield from _columns(own, f"{outer}{name}.")


def _cells(rows: Sequence[Row]) -> Iterator[list[Any]]:
    """A header and the cells of each row; cells that a row lacks are empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    yield names
    for row in rows:
        yield [row.get(name) for name in names]
