"""Reading from a store: rows as Arrow tables and as arrays, and the documents of units."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.outcome import document_of, full_covariance
from imucal.fleet.schema import BASE_NAMES, FIGURES

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["ABOUT_COLUMNS", "batches_of", "conditions", "documents", "measurements", "query"]

# Rows that are in memory at once.
ROWS_AT_ONCE: Final = 10_000
# Columns of a table of measurements before those of figures and parameters.
ABOUT_COLUMNS: Final = (
    *(
        "serial",
        "date",
        "station",
        "operator",
        "batch",
        "role",
        "verdict",
        "code",
        "message",
        "reasons",
        "findings",
    ),
    *("files", "control", "version", "seconds", "stored_at", "key", "accel_unit", "gyro_unit"),
    *("gap_verdict", "gap_effects"),
)
NUMBERS: Final = ("seconds", "temperature_low_degc", "temperature_high_degc", *FIGURES)
FIGURE_COLUMNS: Final = ("temperature_low_degc", "temperature_high_degc", *FIGURES, "other_figures")
# Names of the arguments that select rows, each with its condition.
CONDITIONS: Final = {
    "serial": "serial = ?",
    "role": "role IS ?",
    "station": "station IS ?",
    "operator": "operator IS ?",
    "batch": "batch IS ?",
    "verdict": "verdict = ?",
    "since": "date >= ?",
    "until": "date < ?",
}


def conditions(given: Mapping[str, str | None]) -> tuple[str, list[str]]:
    """The condition of SQL that selects rows, and its arguments."""
    used = {name: value for name, value in given.items() if value is not None}
    return " AND ".join(CONDITIONS[name] for name in used) or "TRUE", list(used.values())


def query(
    connection: sqlite3.Connection, sql: str, arguments: Sequence[Any] = ()
) -> tuple[list[str], list[Any]]:
    """Names of the columns and rows of a statement that reads; InputError for any other."""
    try:
        cursor = connection.execute(sql, arguments)
        if cursor.description is None:
            raise InputError(
                "the statement returns no rows: give one that reads, such as SELECT ... FROM measurements"
            )
        return [name for name, *_ in cursor.description], cursor.fetchall()
    except sqlite3.Warning as error:
        raise InputError(f"the query is refused: {error}: give one statement") from None
    except sqlite3.Error as error:
        raise InputError(
            f"the query is refused: {error}: it only reads, from measurements and the other tables, see "
            "docs/fleet.md"
        ) from None


def batches_of(
    connection: sqlite3.Connection, where: str = "TRUE", arguments: Sequence[Any] = ()
) -> Iterator[pa.RecordBatch]:
    """Current rows in batches, also those without a result: texts, figures, parameters with their sigmas."""
    import pyarrow as pa

    numbers = (*NUMBERS, *(column for name in BASE_NAMES for column in (name, f"{name}_sigma")))
    texts = tuple(name for name in ABOUT_COLUMNS if name not in numbers)
    schema = pa.schema(
        [*((name, pa.string()) for name in texts), *((name, pa.float64()) for name in numbers)]
    )
    rows = connection.execute(
        f"SELECT {', '.join((*texts, *numbers))} FROM measurements WHERE {where} ORDER BY id", arguments
    )
    is_first = True
    while (block := rows.fetchmany(ROWS_AT_ONCE)) or is_first:
        columns = list(zip(*block, strict=True)) if block else [()] * len(schema)
        yield pa.record_batch(
            [pa.array(c, f.type) for c, f in zip(columns, schema, strict=True)], schema=schema
        )
        is_first = False


def measurements(
    connection: sqlite3.Connection, where: str, arguments: Sequence[Any], *, covariances: bool
) -> Measurements:
    """The current rows with a result as arrays.

    Raises InputError if the rows differ in the units of their parameters.
    """
    selected = f"FROM measurements WHERE names IS NOT NULL AND ({where})"
    order = "ORDER BY date, serial, id"
    sets = connection.execute(
        f"SELECT n.id, n.names, count(*) FROM (SELECT names {selected}) s JOIN names n ON n.id = s.names "
        "GROUP BY n.id",
        arguments,
    ).fetchall()
    parameters = {number: [tuple(pair) for pair in json.loads(text)] for number, text, _ in sets}
    names, units = _common(list(parameters.values()))
    texts = ("serial", "date", "station", "operator", "batch", "role", "verdict")
    # One pass over the store; what is large is taken as bytes, which is fast.
    columns = (*texts, "names", "parameter_values", "sigmas", *FIGURE_COLUMNS)
    rows = connection.execute(f"SELECT {', '.join(columns)} {selected} {order}", arguments).fetchall()
    given = zip(*rows, strict=True) if rows else ([] for _ in columns)
    column_of = dict(zip(columns, given, strict=True))
    del rows
    text_of = {name: column_of[name] for name in texts}
    kinds = np.array(column_of["names"], dtype=np.int64)
    place = {name: index for index, name in enumerate(names)}
    layout = {number: np.array([place[name] for name, _ in pairs]) for number, pairs in parameters.items()}
    values, sigmas = (
        _filled(column_of[name], kinds, layout, len(names)) for name in ("parameter_values", "sigmas")
    )
    found = f"FROM (SELECT id, date, serial {selected}) s JOIN documents d ON d.job = s.id"
    blobs = (
        connection.execute(f"SELECT d.covariance {found} ORDER BY s.date, s.serial, s.id", arguments)
        if covariances
        else None
    )
    return Measurements(
        serials=_texts(text_of["serial"]),
        dates=np.array([date or "NaT" for date in text_of["date"]], dtype="datetime64[s]"),
        stations=_texts(text_of["station"]),
        operators=_texts(text_of["operator"]),
        batches=_texts(text_of["batch"]),
        roles=_texts(text_of["role"]),
        verdicts=_texts(text_of["verdict"]),
        names=names,
        units=units,
        values_si=values,
        sigmas_si=sigmas,
        covariances=None if blobs is None else _covariances(blobs, kinds, layout, len(names)),
        figures=_figures(column_of),
    )


def documents(
    connection: sqlite3.Connection, where: str, arguments: Sequence[Any]
) -> Iterator[tuple[str, Any]]:
    """Serial number and document of each current row with a result: calibration, judgement and gap."""
    rows = connection.execute(
        "SELECT m.serial, d.document, d.covariance FROM measurements m JOIN documents d ON d.job = m.id "
        f"WHERE {where} ORDER BY m.date, m.serial, m.id",
        arguments,
    )
    for serial, document, covariance in rows:
        yield serial, document_of(document, covariance)


def _common(sets: Sequence[Sequence[tuple[str, ...]]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """All parameters, those of every unit first, and their units."""
    units: dict[str, str] = {}
    for pairs in sorted(sets, key=len):
        for name, unit in pairs:
            if units.setdefault(name, unit) != unit:
                raise InputError(
                    f"{name} is in {units[name]} for some units and in {unit} for others: select units of "
                    "one kind, "
                    "such as those of one batch"
                )
    base = [name for name in BASE_NAMES if name in units]
    names = (*base, *(name for name in units if name not in BASE_NAMES))
    return names, tuple(units[name] for name in names)


def _filled(
    blobs: Sequence[bytes],
    kinds: np.ndarray[Any, Any],
    layout: Mapping[int, np.ndarray[Any, Any]],
    width: int,
) -> FloatArray:
    """(n, width) numbers of the blobs; NaN for a parameter that a row does not have."""
    found = np.full((len(blobs), width), np.nan)
    for number, columns in layout.items():
        rows = np.flatnonzero(kinds == number)
        numbers = np.frombuffer(b"".join(blobs[row] for row in rows.tolist()), dtype="<f8")
        found[np.ix_(rows, columns)] = numbers.reshape(len(rows), len(columns))
    return found


def _covariances(
    blobs: sqlite3.Cursor, kinds: np.ndarray[Any, Any], layout: Mapping[int, np.ndarray[Any, Any]], width: int
) -> FloatArray:
    found = np.full((len(kinds), width, width), np.nan)
    for row, (blob,) in enumerate(blobs):
        if blob is not None:
            columns = layout[int(kinds[row])]
            found[row][np.ix_(columns, columns)] = full_covariance(blob, len(columns))
    return found


def _figures(column_of: Mapping[str, Sequence[Any]]) -> dict[str, FloatArray]:
    known = {name: np.array(column_of[name], dtype=np.float64) for name in FIGURE_COLUMNS[:-1]}
    low, high = (known.pop(name) for name in FIGURE_COLUMNS[:2])
    figures = {"temperature_degc": (low + high) / 2, **known}
    parsed = [json.loads(text) for text in column_of["other_figures"]]
    for name in dict.fromkeys(name for each in parsed for name in each):
        figures[name] = np.array([each.get(name) for each in parsed], dtype=np.float64)
    return figures


def _texts(column: Sequence[str | None]) -> np.ndarray[Any, Any]:
    return np.array([text or "" for text in column], dtype=np.str_)
