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
from imucal.fleet.schema import BASE_NAMES, FIGURES, TEMPERATURES

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["ABOUT_COLUMNS", "batches_of", "conditions", "documents", "measurements", "query"]

# Maximum number of rows that are in memory at once.
ROWS_AT_ONCE: Final = 10_000
# Number of rows with blobs that are fetched at once. It is below 700, the number of new tuples after which
# Python's garbage collector runs. If all rows were fetched at once, the collector would take a third of the
# reading time.
BLOBS_AT_ONCE: Final = 500
# Columns of a table of measurements that precede the columns of figures of merit and parameters.
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
NUMBERS: Final = ("seconds", *TEMPERATURES, *FIGURES)
TEXTS: Final = ("serial", "date", "station", "operator", "batch", "role", "verdict")
# Columns that contain the float64 values of all parameters or figures of merit of a row as one blob.
PACKED: Final = ("parameter_values", "sigmas", "figure_values")
# SQL condition of each argument that selects rows.
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
    """The SQL condition for a selection such as {"serial": "A-17"}, and the arguments of the condition."""
    used = {name: value for name, value in given.items() if value is not None}
    return " AND ".join(CONDITIONS[name] for name in used) or "TRUE", list(used.values())


def query(
    connection: sqlite3.Connection, sql: str, arguments: Sequence[Any] = ()
) -> tuple[list[str], list[Any]]:
    """Column names and rows that a read-only SQL statement returns; InputError for other statements."""
    try:
        cursor = connection.execute(sql, arguments)
        if cursor.description is None:
            raise InputError(
                "the statement returns no rows: give a query, such as SELECT ... FROM measurements"
            )
        return [name for name, *_ in cursor.description], cursor.fetchall()
    except sqlite3.Warning as error:
        raise InputError(f"the query is refused: {error}: give one statement") from None
    except sqlite3.Error as error:
        raise InputError(
            f"the query is refused: {error}: a query can only read; docs/fleet.md describes the tables, such "
            "as measurements"
        ) from None


def batches_of(
    connection: sqlite3.Connection, where: str = "TRUE", arguments: Sequence[Any] = ()
) -> Iterator[pa.RecordBatch]:
    """Batches of the current rows (the last calibration of each recording), including rows without a result.

    The columns are texts, figures of merit, and parameters with their standard deviations.
    """
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
    """The last calibration of each selected recording, as arrays. Recordings without a result are omitted.

    Raises InputError if the rows differ in the units of their parameters.
    """
    # In one transaction, all statements read the same state of the store, even while a run is writing.
    connection.execute("BEGIN")
    try:
        return _measurements(connection, where, arguments, covariances=covariances)
    finally:
        connection.execute("ROLLBACK")


def _measurements(
    connection: sqlite3.Connection, where: str, arguments: Sequence[Any], *, covariances: bool
) -> Measurements:
    selected = f"FROM measurements WHERE names IS NOT NULL AND ({where})"
    # SQLite aggregates each column to one JSON list, which is faster than creating a Python object for each
    # cell.
    lists = ", ".join(f"json_group_array({name})" for name in ("id", "names", "figure_names", *TEXTS))
    found = connection.execute(f"SELECT {lists} {selected}", arguments).fetchone()
    texts = dict(zip(TEXTS, (_texts(json.loads(text)) for text in found[3:]), strict=True))
    dates = np.where(texts["date"] == "", "NaT", texts["date"]).astype("datetime64[s]")
    numbers = np.array([json.loads(text) for text in found[:3]], dtype=np.int64)
    # NaT is the smallest integer, so rows without a date come first.
    order = np.lexsort((numbers[0], texts["serial"], dates.astype(np.int64)))
    ids, kinds, figure_kinds = numbers[:, order]
    parameters = {number: [tuple(p) for p in pairs] for number, pairs in _names(connection, kinds).items()}
    names, units = _common(list(parameters.values()))
    columns = {number: [name for name, _ in pairs] for number, pairs in parameters.items()}
    packed: tuple[list[bytes], ...] = tuple([] for _ in PACKED)
    rows = connection.execute(f"SELECT {', '.join(PACKED)} {selected} ORDER BY id", arguments)
    while block := rows.fetchmany(BLOBS_AT_ONCE):
        for column, part in zip(packed, zip(*block, strict=True), strict=True):
            column.extend(part)
    by_id = numbers[:, np.argsort(numbers[0])]
    # The blobs are in the order of the identifiers. For each row of the result, `place` is the index of its
    # blobs.
    place = np.searchsorted(by_id[0], ids)
    names_of_figures = _names(connection, figure_kinds)
    figure_names = tuple(dict.fromkeys(name for each in names_of_figures.values() for name in each))
    values, sigmas = (_filled(blobs, by_id[1], columns, names)[place] for blobs in packed[:2])
    figure_values = _filled(packed[2], by_id[2], names_of_figures, figure_names)[place]
    return Measurements(
        serials=texts["serial"][order],
        dates=dates[order],
        stations=texts["station"][order],
        operators=texts["operator"][order],
        batches=texts["batch"][order],
        roles=texts["role"][order],
        verdicts=texts["verdict"][order],
        names=names,
        units=units,
        values_si=values,
        sigmas_si=sigmas,
        covariances=_covariances(connection, selected, arguments, ids, kinds, columns, names)
        if covariances
        else None,
        figures=_figures(dict(zip(figure_names, figure_values.T, strict=True))),
    )


def documents(
    connection: sqlite3.Connection, where: str, arguments: Sequence[Any]
) -> Iterator[tuple[str, Any]]:
    """Yield the serial number and the JSON document of the last calibration of each selected recording."""
    rows = connection.execute(
        "SELECT m.serial, d.document, d.covariance FROM measurements m JOIN documents d ON d.job = m.id "
        f"WHERE {where} ORDER BY m.date, m.serial, m.id",
        arguments,
    )
    for serial, document, covariance in rows:
        yield serial, document_of(document, covariance)


def _common(sets: Sequence[Sequence[tuple[str, ...]]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names and the units of all parameters in `sets`. The parameters in `BASE_NAMES` come first."""
    units: dict[str, str] = {}
    for pairs in sorted(sets, key=len):
        for name, unit in pairs:
            if units.setdefault(name, unit) != unit:
                raise InputError(
                    f"{name} is in {units[name]} for some units and in {unit} for others: select units of "
                    "one kind, such as those of one batch"
                )
    base = [name for name in BASE_NAMES if name in units]
    names = (*base, *(name for name in units if name not in BASE_NAMES))
    return names, tuple(units[name] for name in names)


def _names(connection: sqlite3.Connection, kinds: np.ndarray[Any, Any]) -> dict[int, Any]:
    """The stored lists of names (of parameters or figures of merit) whose identifiers are `kinds`.

    The keys of the result are the identifiers.
    """
    rows = connection.execute(
        "SELECT id, names FROM names WHERE id IN (SELECT value FROM json_each(?))",
        [json.dumps(np.unique(kinds).tolist())],
    )
    return {number: json.loads(text) for number, text in rows}


def _rows_of(ids: np.ndarray[Any, Any], given: Sequence[int]) -> np.ndarray[Any, Any]:
    """For each identifier in `given`, its index in `ids`."""
    sorted_ids = np.argsort(ids)
    found: np.ndarray[Any, Any] = sorted_ids[np.searchsorted(ids, given, sorter=sorted_ids)]
    return found


def _covariances(
    connection: sqlite3.Connection,
    selected: str,
    arguments: Sequence[Any],
    ids: np.ndarray[Any, Any],
    kinds: np.ndarray[Any, Any],
    columns: Mapping[int, Sequence[str]],
    names: Sequence[str],
) -> FloatArray:
    found = np.full((len(ids), len(names), len(names)), np.nan)
    place = {name: index for index, name in enumerate(names)}
    stored = connection.execute(
        "SELECT job, covariance FROM documents WHERE covariance IS NOT NULL "
        f"AND job IN (SELECT id {selected})",
        arguments,
    )
    while block := stored.fetchmany(ROWS_AT_ONCE):
        jobs, blobs = zip(*block, strict=True)
        rows = _rows_of(ids, jobs)
        for number, of_kind in columns.items():
            own = np.flatnonzero(kinds[rows] == number)
            inside = np.array([place[name] for name in of_kind], dtype=np.intp)
            matrices = full_covariance(b"".join([blobs[k] for k in own.tolist()]), len(inside))
            found[rows[own, None, None], inside[:, None], inside] = matrices
    return found


def _filled(
    blobs: Sequence[bytes],
    kinds: np.ndarray[Any, Any],
    own: Mapping[int, Sequence[str]],
    names: Sequence[str],
) -> FloatArray:
    """The numbers in the blobs as a table, (n, c), with one row per blob and one column per name in `names`.

    kinds   for each blob, the identifier of the list that names its numbers
    own     for each identifier, the list of names in the order of the numbers in a blob

    An entry of the table is NaN if the blob has no number with this name.
    """
    place = {name: index for index, name in enumerate(names)}
    found = np.full((len(blobs), len(names)), np.nan)
    for number, of_kind in own.items():
        rows = np.flatnonzero(kinds == number)
        numbers = np.frombuffer(b"".join([blobs[row] for row in rows.tolist()]), dtype="<f8")
        columns = np.array([place[name] for name in of_kind], dtype=np.intp)
        found[rows[:, None], columns] = numbers.reshape(len(rows), len(columns))
    return found


def _figures(known: dict[str, FloatArray]) -> dict[str, FloatArray]:
    if not known:
        return {}
    low, high = (known.pop(name) for name in TEMPERATURES)
    return {"temperature_degc": (low + high) / 2, **known}


def _texts(column: Sequence[str | None]) -> np.ndarray[Any, Any]:
    return np.array([text or "" for text in column], dtype=np.str_)
