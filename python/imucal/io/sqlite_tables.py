"""Reads SQLite databases of phone apps, with one table per sensor or one table with both sensors."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from imucal.document.source import open_file
from imucal.errors import FormatError
from imucal.io.layout import Layout
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.sensor_rows import texts_of_rows
from imucal.io.text import Text
from imucal.recording.recording import Recording

__all__ = ["is_rosbag", "read_sqlite"]


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
    file = open_file(path)
    try:
        tables = _tables(path)
    except sqlite3.Error as error:
        raise FormatError(f"{file.name} cannot be read as an SQLite database: {error}") from None
    if not tables:
        raise FormatError(f"{file.name} contains no table with rows: export the recording again")
    whole = Text(file.name, b"", Layout(None, None, [], ",", ".", 0, 1, 0, []), (file.source,))
    return recording_of_texts(texts_of_rows(whole, tables), file.name, columns, rate_hz, units)


def is_rosbag(path: str | os.PathLike[str]) -> bool:
    """Whether a database has the tables of a ROS 2 bag. Also True if it cannot be read."""
    try:
        with closing(_opened(path)) as database:
            names = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
    except sqlite3.Error:
        return True
    return {"topics", "messages"} <= names


def _opened(path: str | os.PathLike[str]) -> sqlite3.Connection:
    return sqlite3.connect(f"{Path(path).absolute().as_uri()}?mode=ro", uri=True)


def _tables(path: str | os.PathLike[str]) -> dict[str, list[Sequence[object]]]:
    """The header and the rows of each table that has rows, by the name of the table."""
    tables: dict[str, list[Sequence[object]]] = {}
    with closing(_opened(path)) as database:
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        for (name,) in database.execute(query).fetchall():
            quoted = str(name).replace('"', '""')
            found = database.execute(f'SELECT * FROM "{quoted}"')
            rows = found.fetchall()
            if rows:
                tables[str(name)] = [[column[0] for column in found.description], *rows]
    return tables
