"""Finds the tables of samples in a JSON document.

Four forms are known:

    [{"t": 0.01, "acc": [0, 0, 9.8], "gyro": {"x": 0, "y": 0, "z": 0}}, ...]    a list of objects
    {"accelerometer": [{...}, ...], "gyroscope": [{...}, ...]}                  lists of objects by sensor
    {"t": [0.01, ...], "acc": [[0, 0, 9.8], ...], "gx": [0, ...]}               a list per column
    {"sensors": [{"name": "accX", "units": "m/s2"}, ...], "values": [[...]]}    Edge Impulse

The objects become the rows of a table: the column `acc.x` is the member `x`, or the first number, of the
member `acc`. A unit in the name of an outer member, or in a member `unit`, is appended to the names of its
columns: `acc.x (mps2)`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, TypeAlias

from imucal.errors import FormatError
from imucal.io.column_words import is_time, words_of
from imucal.io.interleaved import UNIT_COLUMN
from imucal.io.layout import is_number
from imucal.io.unit_words import split_unit, unit_of

__all__ = ["MOST_COLUMNS", "Row", "tables_of"]

# The cells of one object by column name.
Row: TypeAlias = dict[str, Any]
# Maximum number of objects and lists around the samples.
MOST_LEVELS: Final = 8
# Maximum number of columns of a table. The names of objects with more names are probably time stamps.
MOST_COLUMNS: Final = 500
AXES: Final = "xyz"
# Names of members that state the unit of their neighbours.
UNITS: Final = ("unit", "units")
# Names of members that identify a recording of a phone or a logger.
SESSION: Final = r"(?i)session[ _-]?(id|uuid)?"
# Minimum share of the objects in a list with lists of objects. With a smaller share, these lists do not
# contain the samples.
LEAST_MESSAGES: Final = 0.5


def tables_of(name: str, document: Any) -> dict[str, list[Row]]:
    """The rows of each table in a document, by its path; empty for an unknown form.

    Raises FormatError if the samples of several devices, or of several recordings, are in one list, and if
    the columns of a table have different lengths.
    """
    if isinstance(document, dict):
        for inner in _objects(document, MOST_LEVELS):
            rows = _of_edge_impulse(inner) or _of_split_frame(inner)
            if rows:
                return {"": rows}
        tables = _of_columns(name, document)
        if tables:
            return tables
    origins: dict[str, set[str]] = {}
    try:
        tables = dict(_lists(document, "", MOST_LEVELS, origins))
    except _SeveralSamples as found:
        raise FormatError(
            f"{name}: the member {found} of an object contains several samples: write one object per "
            "sample, each with its own time"
        ) from None
    for member, values in origins.items():
        if len(values) > 1:
            raise FormatError(
                f"{name} contains samples of {len(values)} devices or recordings ({member}: "
                f"{', '.join(sorted(values))[:60]}): write those of each to a separate file"
            )
    tables = {path: rows for path, rows in tables.items() if any(map(_has_number, rows))}
    return {"": next(iter(tables.values()))} if len(tables) == 1 else tables


def _has_number(row: Row) -> bool:
    return any(cell is not None and is_number(str(cell)) for cell in row.values())


def _objects(document: Mapping[str, Any], levels: int) -> Iterator[Mapping[str, Any]]:
    """The object and the objects in it."""
    yield document
    if levels:
        for value in document.values():
            if isinstance(value, dict):
                yield from _objects(value, levels - 1)


def _lists(
    value: Any, path: str, levels: int, origins: dict[str, set[str]]
) -> Iterator[tuple[str, list[Row]]]:
    """The lists of objects in a value, each with its path, such as `left.accelerometer`.

    If the objects of a list contain lists of objects, as the messages of some apps do, the inner lists are
    joined. The values of the members of these messages that identify a device or a recording are added to
    `origins`.
    """
    if isinstance(value, list) and levels:
        objects = [own for own in value if isinstance(own, dict)]
        if not objects or len(objects) < sum(own is not None for own in value):
            return
        within = [list(_lists(own, "", levels - 1, origins)) for own in objects]
        if sum(map(bool, within)) < LEAST_MESSAGES * len(objects):
            yield path, [_flat(own) for own in objects]
            return
        joined: dict[str, list[Row]] = {}
        for own, lists in zip(objects, within, strict=True):
            for member, origin in own.items():
                if _is_origin(member) and isinstance(origin, (str, int)):
                    origins.setdefault(member, set()).add(str(origin))
            for at, rows in lists:
                joined.setdefault(".".join(filter(None, (path, at))), []).extend(rows)
        yield from joined.items()
    elif isinstance(value, dict) and levels:
        for at, own in value.items():
            yield from _lists(own, f"{path}.{at}" if path else str(at), levels - 1, origins)


def _is_origin(member: str) -> bool:
    return any(re.fullmatch(form, member) for form in (UNIT_COLUMN, SESSION))


def _flat(value: Mapping[str, Any], outer: str = "", unit: str = "") -> Row:
    """The cells of an object; the names of members of members are joined by points."""
    unit = _stated_unit(value) or unit
    row: Row = {}
    for name, own in value.items():
        if name in UNITS and unit:
            continue
        if _are_samples(f"{outer}{name}", own):
            raise _SeveralSamples(f"{outer}{name}")
        if isinstance(own, dict):
            bare, ending = _without_unit(f"{outer}{name}")
            row |= _flat(own, f"{bare}.", ending or unit)
        elif isinstance(own, list) and len(own) == len(AXES):
            row |= zip(_of_axes(f"{outer}{name}", unit), own, strict=True)
        elif isinstance(own, (str, int, float)) or own is None:
            row[_with_unit(f"{outer}{name}", unit)] = own
    return row


class _SeveralSamples(Exception):
    """An object of a list contains several samples; the argument is the name of the member."""


def _are_samples(name: str, value: Any) -> bool:
    """Whether the value is a list of triples, or a list of numbers of one axis."""
    if not isinstance(value, list) or not value:
        return False
    if isinstance(value[0], list):
        return all(isinstance(own, list) and len(own) == len(AXES) for own in value)
    is_axis = words_of(split_unit(name)[0])[-1:] in (["x"], ["y"], ["z"])
    return is_axis and not isinstance(value[0], dict)


@lru_cache(maxsize=MOST_COLUMNS)
def _without_unit(name: str) -> tuple[str, str]:
    """The name and its unit: ("gyro", "dps") for gyro_dps. A unit in brackets stays in the name."""
    bare, unit = split_unit(name)
    return (name, "") if unit is None or re.search(r"[\[({]", name) else (bare, unit[1])


@lru_cache(maxsize=MOST_COLUMNS)
def _of_axes(name: str, unit: str) -> tuple[str, ...]:
    """The names of the columns of a list of three numbers."""
    bare, ending = _without_unit(name)
    return tuple(_with_unit(f"{bare}.{axis}", ending or unit) for axis in AXES)


def _with_unit(name: str, unit: str) -> str:
    """The name with the unit that its object states; a time has its own unit."""
    return f"{name} ({unit})" if unit and name.rpartition(".")[2].lower() in AXES else name


def _stated_unit(value: Mapping[str, Any]) -> str:
    """The unit that a member of the object states; empty if there is none, or if it is not known."""
    stated = [value[name] for name in UNITS if isinstance(value.get(name), str)]
    return next((unit for unit in stated if unit_of(unit) is not None), "")


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


def _of_split_frame(value: Mapping[str, Any]) -> list[Row]:
    """The rows of a data frame that pandas wrote with orient="split"."""
    names, data = value.get("columns"), value.get("data")
    if not (isinstance(names, list) and isinstance(data, list)):
        return []
    if not all(isinstance(row, list) and len(row) == len(names) for row in data):
        return []
    return [dict(zip(map(str, names), row, strict=True)) for row in data]


def _of_columns(name: str, document: Mapping[str, Any]) -> dict[str, list[Row]]:
    """The tables of an object with one list of numbers per column; empty for any other object.

    The columns form one table. If several inner objects have a time of their own, or if the columns of
    inner objects have different lengths, the columns of each of these objects form a table.
    """
    columns = {path: own for path, own in _columns(name, document, "") if len(own) > len(AXES)}
    if len(columns) <= len(AXES):
        return {}
    parents = {path: path.rpartition(".")[0] for path in columns}
    timed = {parents[path] for path in columns if _is_time(path.rpartition(".")[2])}
    if len(timed) <= 1 and len({len(own) for own in columns.values()}) == 1:
        return {"": _rows(columns)}
    groups: dict[str, dict[str, list[Any]]] = {}
    for path, own in columns.items():
        # A sensor may be an object within the object that has the time.
        around = [
            parent for parent in timed if f"{parents[path]}.".startswith(f"{parent}." if parent else "")
        ]
        group = max(around, key=len, default=parents[path])
        groups.setdefault(group, {})[path.removeprefix(f"{group}.") if group else path] = own
    for group, table in groups.items():
        lengths = {column: len(values) for column, values in table.items()}
        if len(set(lengths.values())) > 1:
            parts = ", ".join(f"{column} {count}" for column, count in list(lengths.items())[:6])
            where = f" of {group}" if group else ""
            raise FormatError(
                f"{name}: the columns{where} have different lengths ({parts}): write each sensor as an "
                "object with its own time"
            )
    return {group: _rows(table) for group, table in groups.items()}


def _is_time(name: str) -> bool:
    bare, unit = split_unit(name)
    return is_time(words_of(bare), unit)


def _rows(columns: Mapping[str, Sequence[Any]]) -> list[Row]:
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _columns(
    file: str, value: Mapping[str, Any], outer: str, unit: str = ""
) -> Iterator[tuple[str, list[Any]]]:
    """The lists of numbers in an object, with the names of their columns."""
    unit = _stated_unit(value) or unit
    for name, own in value.items():
        path = f"{outer}{name}"
        if isinstance(own, list) and not any(isinstance(cell, (list, dict)) for cell in own):
            yield _with_unit(path, unit), own
        elif isinstance(own, list) and all(isinstance(row, list) and len(row) == len(AXES) for row in own):
            names = _of_axes(path, unit)
            yield from ((column, [row[at] for row in own]) for at, column in enumerate(names))
        elif isinstance(own, dict) and own and all(re.fullmatch(r"\d+", key) for key in own):
            yield path, _of_labels(file, path, own)
        elif isinstance(own, dict):
            bare, ending = _without_unit(path)
            yield from _columns(file, own, f"{bare}.", ending or unit)


def _of_labels(file: str, column: str, cells: Mapping[str, Any]) -> list[Any]:
    """The cells of a column that pandas wrote as an object whose names are the labels of the rows."""
    labels = sorted(cells, key=int)
    if [int(label) for label in labels] != list(range(len(labels))):
        raise FormatError(
            f"{file}: the labels of the rows of {column} are no numbers from 0 to {len(labels) - 1}: if they "
            "are time stamps, write them as a column (reset_index in pandas)"
        )
    return [cells[label] for label in labels]
