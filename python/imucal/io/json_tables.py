"""Finds the tables in a JSON document: lists of objects, and objects with one list per column.

The label of a table, such as `left.accelerometer`, is its place in the document, and the name of the sensor
if a member of each object names the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import nan
from typing import Any, Final

from imucal.errors import FormatError
from imucal.io.column_words import is_time, words_of
from imucal.io.first_cells import HEAD_ROWS
from imucal.io.header import header_of, names_sensor, sensor_column
from imucal.io.json_columns import rows_of_program, tables_of_columns, with_labels
from imucal.io.json_members import AXES, IDENTITY, TYPE, UNIT, Row, described_by, flat
from imucal.io.layout import is_value
from imucal.io.sensor_labels import MOST_SENSORS

__all__ = ["stated_units", "tables_of"]

# Maximum number of objects and lists around the samples.
MOST_LEVELS: Final = 10
# Minimum number of members of an object for these members to count as samples, each under its own key.
LEAST_KEYED: Final = 40
# Maximum number of different names in the objects of a list. More names are for example time stamps.
MOST_NAMES: Final = 500


def tables_of(document: Any) -> tuple[dict[str, list[Row]], int]:
    """The rows of each table by its label, and the number of objects that lack the name of their sensor.

    Tables with fewer than three columns of numbers, such as a list of events, are left out. The label of the
    only table is "" if it names no sensor. Raises FormatError without the name of the file, for example for
    samples of several devices.
    """
    found: dict[str, list[Row]] = {}
    if isinstance(document, dict):
        found |= tables_of_columns(document, {})
    for path, rows in _found(document, "", {}, MOST_LEVELS):
        found.setdefault(path, []).extend(rows)
    sampled = {path: rows for path, rows in found.items() if _could_be_samples(rows)}
    if found and not sampled:
        paths = ", ".join(filter(None, found))[:80]
        raise FormatError(
            f"no list of objects has the three axes of a sensor{f' ({paths})' if paths else ''}: write one "
            "object per sample, with its time and all axes as numbers"
        )
    tables: dict[str, list[Row]] = {}
    count = 0
    for path, rows in sampled.items():
        by_sensor = _by_sensor(rows)
        count += len(rows) - sum(map(len, by_sensor.values()))
        if "" in by_sensor:
            by_sensor = _by_clock(rows)
        is_label = len(sampled) > 1 or any(names_sensor([f"{path} x"], what) for what in ("accel", "gyro"))
        for sensor, own in by_sensor.items():
            tables.setdefault(_joined(path if is_label else "", sensor), []).extend(own)
    is_known = any(map(_has_sensor, tables.values()))
    for rows in tables.values():
        _refuse_batches(rows, is_known)
    return tables, count


def stated_units(document: Any, tables: Mapping[str, Sequence[Row]]) -> str:
    """The units that members outside the tables state, such as `units.gyro = deg/s`; empty for none."""
    used = {
        own
        for rows in tables.values()
        for name, own in rows[0].items()
        if UNIT.search(name) and own is not None
    }
    # The first line of JSON Lines may describe the samples.
    objects = [document] if isinstance(document, dict) else document[:1]
    stated = {
        name: own
        for value in objects
        if isinstance(value, dict)
        for name, own in flat({key: own for key, own in value.items() if not isinstance(own, list)}).items()
        if isinstance(own, str) and own not in used and any(map(UNIT.search, name.split(".")))
    }
    return ", ".join(f"{name} = {own}" for name, own in stated.items())[:200]


def _found(value: Any, path: str, outer: Row, levels: int) -> Iterator[tuple[str, list[Row]]]:
    """The tables of objects in a value, each with its path in the document.

    outer   the members around the value that describe the samples
    """
    if not levels:
        return
    if isinstance(value, dict):
        if _are_keyed(value):
            yield from _found(with_labels(value), path, outer, levels - 1)
        elif rows := rows_of_program(value):
            yield path, [outer | described_by(value) | row for row in rows]
        else:
            around = outer | described_by(value)
            for name, own in value.items():
                yield from _found(own, _joined(path, name), around, levels - 1)
    elif isinstance(value, list):
        objects = [{} if own is None else own for own in value]
        if any(objects) and all(isinstance(own, dict) for own in objects):
            yield from _of_objects(objects, path, outer, levels)
        elif _has_header_row(value):
            yield path, [outer | dict(zip(value[0], row, strict=True)) for row in value[1:]]


def _of_objects(
    objects: Sequence[Mapping[str, Any]], path: str, outer: Row, levels: int
) -> Iterator[tuple[str, list[Row]]]:
    """The table of a list of objects, or the tables of the lists in these objects, such as messages."""
    parts: dict[str, list[list[Row]]] = {}
    for own in objects:
        if any(map(_may_hold_objects, own.values())):
            for at, rows in _found(own, "", outer, levels - 1):
                parts.setdefault(at, []).append(rows)
    rows = [outer | flat(own) for own in objects]
    inner = {at: [row for part in own for row in part] for at, own in parts.items()}
    sampled = [at for at, own in inner.items() if _has_sensor(own)]
    if not inner or _has_sensor(rows) or (not sampled and sum(map(len, inner.values())) < len(rows)):
        yield path, rows
    elif not sampled:
        sampled = list(inner)
    for at in sampled:
        _refuse_overlap(at, parts[at])
        yield _joined(path, at), inner[at]


def _refuse_overlap(name: str, parts: Sequence[Sequence[Row]]) -> None:
    """Raises FormatError if a list starts in the first half of the list before it.

    Such lists are no successive messages, but for example the recordings of several devices. The lists of
    several sensors may overlap, and `_by_sensor` refuses those of several devices that are named.
    """
    times = header_of(_names(parts[0])).times if len(parts) > 1 else []
    first = [part[0] for part in parts]
    sensor = sensor_column(
        {name: [row[name] for row in first if _is_text(row.get(name))] for name in first[0]}
    )
    by_sensor: dict[tuple[str, ...], list[Sequence[Row]]] = {}
    for part in parts if times else []:
        key = [
            str(own)
            for name, own in part[0].items()
            if name == sensor or IDENTITY.search(name) or (TYPE.search(name) and isinstance(own, int))
        ]
        by_sensor.setdefault(tuple(key), []).append(part)
    for successive in by_sensor.values():
        for before, after in pairwise(successive):
            found = [row.get(times[0][0]) for row in (before[0], before[-1], after[0])]
            start, end, later = (time if isinstance(time, (int, float)) else nan for time in found)
            if start <= later < (start + end) / 2:
                raise FormatError(
                    f"the lists {name!r} of several objects overlap in time, as those of several devices do: "
                    "write the samples of each device to a separate file"
                )


def _may_hold_objects(member: Any) -> bool:
    """Whether a member of a sample may contain lists of objects. The test is fast for cells and vectors."""
    return isinstance(member, dict) or (
        isinstance(member, list) and bool(member) and isinstance(member[-1], (dict, list))
    )


def _are_keyed(value: Mapping[str, Any]) -> bool:
    """Whether the members of an object are samples, each under its own key."""
    return (
        len(value) >= LEAST_KEYED
        and all(isinstance(own, dict) for own in value.values())
        and not all(name.isdecimal() for name in next(iter(value.values())))
    )


def _has_header_row(value: Sequence[Any]) -> bool:
    """Whether a list consists of lists of the same length, of which the first contains names."""
    return (
        len(value) > 1
        and all(isinstance(own, list) and len(own) == len(value[0]) for own in value)
        and all(isinstance(name, str) and not is_value(name) for name in value[0])
    )


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path and name else path or name


def _has_sensor(rows: Sequence[Row]) -> bool:
    """Whether the names of the members identify the axes of a sensor."""
    header = header_of(_names_of_cells(rows))
    return bool(header.accel or header.gyro or header.linear or header.plain)


def _could_be_samples(rows: Sequence[Row]) -> bool:
    """Whether the objects have at least three members with numbers, or members with lists."""
    numeric = set()
    for row in rows:
        for name, cell in row.items():
            if isinstance(cell, list):
                return True
            if isinstance(cell, (int, float)) or (isinstance(cell, str) and is_value(cell.strip(), ",")):
                numeric.add(name)
        if len(numeric) >= len(AXES):
            return True
    return False


def _names(rows: Sequence[Row]) -> list[str]:
    """The names of all members. Raises FormatError for too many different names."""
    names: dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
        if len(names) > MOST_NAMES:
            raise FormatError(
                f"the objects have more than {MOST_NAMES} different names "
                f"({', '.join(list(names)[-3:])[:80]}, ...)"
                ': write a time as a value and not as a name, such as {"time_s": 0.01, ...}'
            )
    return list(names)


def _names_of_cells(rows: Sequence[Row]) -> list[str]:
    """The names of the members that are lists in no row."""
    lists = {name for row in rows for name, cell in row.items() if isinstance(cell, list)}
    return [name for name in _names(rows) if name not in lists]


def _is_text(cell: Any) -> bool:
    return isinstance(cell, str)


def _by_sensor(rows: list[Row]) -> dict[str, list[Row]]:
    """The rows of each sensor that a member names; the key is "" if no member names the sensors.

    Raises FormatError if a member identifies several devices, or kinds of samples that are not known.
    """
    names = _names(rows)
    cells = {
        name: list(dict.fromkeys(row[name] for row in rows if _is_text(row.get(name))))[:HEAD_ROWS]
        for name in names
    }
    sensor, header = sensor_column(cells), header_of(names)
    if header.accel and header.gyro and not header.plain:
        # If every row has samples of both sensors, a member with words for sensors is a state.
        both = [triads[0].columns[0] for triads in (header.accel, header.gyro)]
        sensor = None if all(row.get(name) is not None for row in rows for name in both) else sensor
    for name in names:
        kinds = {own: None for row in rows if isinstance(own := row.get(name), (str, int))}
        # A member with more values is for example a counter.
        if name == sensor or not 1 < len(kinds) <= MOST_SENSORS:
            continue
        shown = ", ".join(map(str, kinds))[:60]
        if IDENTITY.search(name):
            raise FormatError(
                f"the samples are those of {len(kinds)} devices or sessions ({name}: {shown}): write the "
                "samples of each to a separate file; if the member names no device or session, remove or "
                "rename it"
            )
        if TYPE.search(name) and sensor is None and not (header.accel and header.gyro):
            raise FormatError(
                f"the member {name!r} names {len(kinds)} kinds of samples ({shown}), which are not known: "
                "write accelerometer and gyroscope in place of their names, or each kind to a separate file"
            )
    if sensor is None:
        return {"": rows}
    tables: dict[str, list[Row]] = {}
    labels: dict[str, str] = {}
    for row in rows:
        if isinstance(own := row.pop(sensor, None), str) and own:
            # Labels such as acc and ACC name one sensor.
            label = labels.setdefault(own.strip().casefold(), own.strip())
            tables.setdefault(label, []).append(row)
    return tables


def _by_clock(rows: list[Row]) -> dict[str, list[Row]]:
    """The rows of each sensor if each sensor is a member with its own time; otherwise all rows."""
    names = _names(rows)
    header = header_of(names)
    tables: dict[str, list[Row]] = {}
    for triads in (header.accel, header.gyro):
        outer = triads[0].columns[0].rpartition(".")[0] if len(triads) == 1 else ""
        own = [name for name in names if outer and name.startswith(f"{outer}.")]
        inner = {name: name.removeprefix(f"{outer}.") for name in own}
        times = {name: bare for name, bare in inner.items() if is_time(words_of(bare), None)}
        if times:
            tables[outer] = [
                {times.get(name, name): row[name] for name in own if name in row} for row in rows
            ]
    return tables if len(tables) > 1 else {"": rows}


def _refuse_batches(rows: Sequence[Row], is_known: bool) -> None:
    """Raises FormatError if a member of each object is a list with several samples of a sensor.

    is_known  whether any table has the axes of a sensor; otherwise any list may contain the samples
    """
    names = _names_of_cells(rows)
    lists, header = [name for name in _names(rows) if name not in names], header_of(names)
    for what, triads in (("accel", header.accel), ("gyro", header.gyro)):
        for name in lists:
            is_triple = f"{name}.x" in names
            if is_triple or (not triads and (not is_known or names_sensor([name, f"{name} x"], what))):
                raise FormatError(
                    f"the member {name!r} of an object is a list with several samples: write one object per "
                    "sample, with its own time"
                )
