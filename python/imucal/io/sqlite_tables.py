"""Reads SQLite databases of phone apps, with one table per sensor or one table with both sensors.

If no table has samples, the views of the database are read like tables.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from imucal.document.source import first_bytes, open_large
from imucal.errors import FormatError
from imucal.finding import Finding
from imucal.io.header import layout_header
from imucal.io.layout import Layout, is_number
from imucal.io.remarks import remark
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.sensor_rows import rows_by_sensor, texts_of_rows
from imucal.io.text import Text
from imucal.recording.recording import Recording

__all__ = ["is_rosbag", "read_sqlite"]

# Number of the first rows from which the types of the columns are determined.
FIRST_ROWS: Final = 50
# A table can only be a recording if at least this number of columns contains numbers.
LEAST_NUMBERS: Final = 3
# The write-ahead mode of a database is in this byte of the header, with this value (SQLite file format, 1.3).
MODE_AT, WRITE_AHEAD = 18, 2


def read_sqlite(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read the tables of a database as `read_folder` reads the files in a folder; arguments as there."""
    units = units_given(time_unit, accel_unit, gyro_unit, rate_hz)
    whole = Text(Path(path).name, b"", Layout(None, None, [], ",", ".", 0, 1, 0, []), (open_large(path),))
    try:
        with _opened(path) as database:
            texts, findings = _texts(database, whole, "table")
            if not any(map(_has_sensor, texts)):
                of_views, more = _texts(database, whole, "view")
                texts, findings = [*texts, *of_views], [*findings, *more]
    except sqlite3.Error as error:
        raise FormatError(
            f"{whole.name} cannot be read as an SQLite database ({error}): it is damaged, incomplete or in "
            "use: close the program that writes it, and copy it again"
        ) from None
    if not texts:
        raise FormatError(f"{whole.name} contains no table with rows of numbers: {_way_out(path, findings)}")
    recording = recording_of_texts(texts, whole.name, columns, rate_hz, units)
    return replace(recording, findings=(*recording.findings, *findings))


def is_rosbag(path: str | os.PathLike[str]) -> bool:
    """Whether a database has the tables of a ROS 2 bag. If it cannot be read, its extension decides."""
    try:
        with _opened(path) as database:
            columns = {row[1] for row in database.execute("PRAGMA table_info(messages)")}
            topics = database.execute("PRAGMA table_info(topics)").fetchall()
    except sqlite3.Error:
        return Path(path).suffix.lower() == ".db3"
    return bool(topics) and {"topic_id", "timestamp", "data"} <= columns


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[sqlite3.Connection]:
    """A connection for reading that leaves no file beside the database.

    In write-ahead mode, SQLite creates the files -wal and -shm beside the database if they are missing,
    unless the database is opened as immutable. This is right only if there is no file -wal, which contains
    the last changes.
    """
    file = Path(path).absolute()
    wal, shared = _beside(file, "-wal"), _beside(file, "-shm")
    with TemporaryDirectory() as folder:
        if wal.exists() and not shared.exists():
            for part in (file, wal):
                shutil.copy(part, folder)
            file = Path(folder, file.name)
        is_immutable = _is_write_ahead(file) and not wal.exists()
        address = f"{file.as_uri()}?mode=ro{'&immutable=1' if is_immutable else ''}"
        with closing(sqlite3.connect(address, uri=True)) as database:
            database.text_factory = lambda content: content.decode(errors="replace")
            yield database


def _beside(file: Path, ending: str) -> Path:
    return file.with_name(file.name + ending)


def _is_write_ahead(path: str | os.PathLike[str]) -> bool:
    return first_bytes(path, MODE_AT + 1)[MODE_AT:] == bytes([WRITE_AHEAD])


def _texts(database: sqlite3.Connection, whole: Text, kind: str) -> tuple[list[Text], list[Finding]]:
    """The texts of all tables or views that can be recordings, and warnings about those that are not read."""
    texts: list[Text] = []
    findings: list[Finding] = []
    query = "SELECT name FROM sqlite_master WHERE type = ? AND name NOT LIKE 'sqlite_%'"
    for (table,) in database.execute(query, (kind,)).fetchall():
        try:
            names, rows = _rows(database, str(table))
        except sqlite3.OperationalError as error:
            # Only the table is unusable if it needs, for example, an extension of SQLite.
            if not str(error).startswith("no such"):
                raise
            message = f"the {kind} {table!r} was left out, because SQLite cannot read it ({error})"
            way_out = "if it contains samples, export it as CSV with the program that wrote it"
            findings.append(remark(whole.name, "file_damaged", message, way_out))
            continue
        if not rows:
            continue
        apart = rows_by_sensor(names, rows)
        if apart is None:
            texts += texts_of_rows(whole, {str(table): [names, *rows]})
        else:
            of_table = Text(f"{whole.name} ({table})", b"", whole.layout, whole.sources)
            texts += texts_of_rows(of_table, apart.tables)
            findings += apart.findings(of_table.name)
    return texts, findings


def _rows(database: sqlite3.Connection, table: str) -> tuple[list[str], list[Sequence[object]]]:
    """The columns of a table and its rows, without columns of blobs; no rows if it cannot be a recording."""

    def query(expressions: Sequence[str], rows: int) -> sqlite3.Cursor:
        return database.execute(f"SELECT {', '.join(expressions)} FROM {_quoted(table)} LIMIT {rows}")

    names = [str(column[0]) for column in query(["*"], 0).description]
    # The types are queried first, because the rows may contain large blobs, such as images.
    types = query([f"typeof({_quoted(name)})" for name in names], FIRST_ROWS).fetchall()
    names = [name for name, *kinds in zip(names, *types, strict=True) if "blob" not in kinds]
    quoted = list(map(_quoted, names))
    first = query(quoted, FIRST_ROWS).fetchall() if names else []
    numbers = [any(is_number(str(cell)) for cell in cells) for cells in zip(*first, strict=True)]
    return names, query(quoted, -1).fetchall() if sum(numbers) >= LEAST_NUMBERS else []


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _has_sensor(text: Text) -> bool:
    header = layout_header(text.layout)
    return bool(header.accel or header.gyro or header.plain)


def _way_out(path: str | os.PathLike[str], findings: Sequence[Finding]) -> str:
    """What the user can do about a database without rows."""
    if findings:
        return "; ".join(f"{finding.message}: {finding.way_out}" for finding in findings)
    wal = _beside(Path(path), "-wal")
    if _is_write_ahead(path) and not wal.exists():
        return f"if there was a file {wal.name}, it contains the last changes: copy both files"
    return "export the recording again"
