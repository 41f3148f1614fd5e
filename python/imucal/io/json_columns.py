"""Reads JSON objects with one list per column, and tables of Edge Impulse, pandas and InfluxDB."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from imucal.errors import FormatError
from imucal.io.header import header_of
from imucal.io.json_members import AXES, Row, described_by, is_cell
from imucal.io.layout import is_number, is_value
from imucal.io.scale import epoch_unit

__all__ = ["rows_of_program", "tables_of_columns", "with_labels"]

# The columns of an object: each name with its cells.
Columns: TypeAlias = dict[str, list[Any]]
# A list with at most this number of cells is no column of samples, but for example an offset.
LONGEST_SETTING: Final = 3


def rows_of_program(value: Mapping[str, Any]) -> list[Row]:
    """The rows of an object in the form of Edge Impulse, pandas (split) or InfluxDB; else empty."""
    rows, names = value.get("values", value.get("data")), _names_of_program(value)
    if not names or not isinstance(rows, list):
        return []
    if not all(isinstance(row, list) and len(row) == len(names) for row in rows):
        return []
    step_ms = value.get("interval_ms")
    if not isinstance(step_ms, (int, float)):
        return [dict(zip(names, row, strict=True)) for row in rows]
    return [{"time (ms)": at * step_ms} | dict(zip(names, row, strict=True)) for at, row in enumerate(rows)]


def _names_of_program(value: Mapping[str, Any]) -> list[str]:
    """The name of each column; Edge Impulse gives its unit, too."""
    sensors, columns = value.get("sensors"), value.get("columns")
    if isinstance(sensors, list) and all(isinstance(own, dict) and "name" in own for own in sensors):
        return [
            f"{own['name']} ({own['units']})" if own.get("units") else str(own["name"]) for own in sensors
        ]
    return list(map(str, columns)) if isinstance(columns, list) else []


def tables_of_columns(value: Mapping[str, Any], outer: Row) -> Iterator[tuple[str, list[Row]]]:
    """The rows of an object with a list per column, each with its path in the object.

    Inner objects are separate tables if several of them have a time, or if they have other numbers of rows.
    Raises FormatError if the columns of one table have different lengths.

    outer   the members that describe the samples
    """
    outer = outer | described_by(value)
    columns = _own_columns(value, "")
    inner = {
        name: columns_of
        for name, own in value.items()
        if isinstance(own, dict) and not _is_labelled(own) and (columns_of := _columns(own, f"{name}."))
    }
    separate = _separate(columns, inner)
    for name in filter(separate.__contains__, inner):
        for path, rows in tables_of_columns(value[name], outer):
            yield f"{name}.{path}" if path else name, rows
    for name, own in inner.items():
        columns |= {} if name in separate else own
    header = header_of(list(columns))
    triads = [*header.accel, *header.gyro, *header.linear, *(triad for triad, _ in header.plain)]
    sampled = [name for triad in triads for name in triad.columns] + [name for name, _ in header.times]
    lengths = _lengths({name: columns[name] for name in sampled} if triads else columns)
    if triads and len(lengths) > 1:
        shown = ", ".join(f"{name}: {len(column)}" for name, column in columns.items())
        raise FormatError(
            f"the lists of one table have different lengths ({shown[:200]}): write a table with a time for "
            'each sensor, such as {"accelerometer": {"t": [...], "x": [...], ...}, "gyroscope": {...}}'
        )
    columns = {name: column for name, column in columns.items() if {len(column)} == lengths}
    if len(columns) >= len(AXES):
        yield (
            "",
            [outer | dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        )


def _separate(columns: Columns, inner: Mapping[str, Columns]) -> set[str]:
    """The inner objects that are tables without the columns of the object around them.

    columns  the columns of the object itself
    inner    the columns of each inner object
    """
    timed = [own for own in inner.values() if len(own) > len(AXES) and header_of(list(own)).times]
    if columns:
        others = {name for name, own in inner.items() if _lengths(own).isdisjoint(_lengths(columns))}
        return set(inner) if len(timed) > 1 else others
    is_uneven = len(set().union(*map(_lengths, inner.values()))) > 1
    has_triad = any(len(own) >= len(AXES) for own in inner.values())
    return set(inner) if len(timed) > 1 or len(inner) == 1 or (is_uneven and has_triad) else set()


def _lengths(columns: Columns) -> set[int]:
    return {len(column) for column in columns.values()}


def _columns(value: Mapping[str, Any], outer: str) -> Columns:
    """The columns of an object and of the objects in it, each with its path."""
    columns = _own_columns(value, outer)
    for name, own in value.items():
        if isinstance(own, dict) and not _is_labelled(own):
            columns |= _columns(own, f"{outer}{name}.")
    return columns


def _own_columns(value: Mapping[str, Any], outer: str) -> Columns:
    """The columns of an object; a list of lists of three numbers is three columns."""
    if _names_of_program(value):
        return {}
    columns: Columns = {}
    labels: list[str] = []
    for name, own in value.items():
        if isinstance(own, list) and len(own) > LONGEST_SETTING:
            if all(map(is_cell, own)):
                columns[f"{outer}{name}"] = own
            elif all(
                isinstance(row, list) and len(row) == len(AXES) and all(map(is_cell, row)) for row in own
            ):
                columns |= {f"{outer}{name}.{axis}": [row[at] for row in own] for at, axis in enumerate(AXES)}
        elif isinstance(own, dict) and _is_labelled(own):
            # pandas writes each column as an object whose keys are the row labels.
            labels = labels or sorted(own, key=int)
            if own.keys() != set(labels):
                raise FormatError(
                    f"the column {name!r} has other row labels than the first column: export the table again"
                )
            columns[f"{outer}{name}"] = [own[label] for label in labels]
    if _are_times(labels) and not header_of(list(columns)).times:
        columns = {"timestamp": list(labels)} | columns
    return columns


def _is_labelled(value: Mapping[str, Any]) -> bool:
    """Whether the keys of an object are row labels, and its members are cells."""
    return (
        len(value) > LONGEST_SETTING
        and all(label.isdecimal() for label in value)
        and all(map(is_cell, value.values()))
    )


def with_labels(samples: Mapping[str, Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The samples in an object in the order of their keys, with a time if only the keys are times."""
    labels = sorted(samples, key=int) if all(label.isdecimal() for label in samples) else list(samples)
    if _are_times(labels) and not header_of(list(samples[labels[0]])).times:
        return [{"timestamp": label, **samples[label]} for label in labels]
    return [samples[label] for label in labels]


def _are_times(labels: Sequence[str]) -> bool:
    """Whether labels are times since 1970, or dates."""
    if all(map(is_number, labels)):
        return bool(labels) and epoch_unit(np.array(labels[:1], dtype=np.float64)) is not None
    return all(map(is_value, labels))
