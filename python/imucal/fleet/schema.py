"""The tables of a store, and the migration of stores of older versions of imucal.

    units -- jobs -- results -- documents
                |
             options

A job is one recording of a unit, or several recordings that are calibrated together, with the options of the
run. The row of a job contains its outcome: a verdict, or the reason for a missing verdict. The version of the
tables is SQLite's `user_version`.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from imucal.errors import FormatError, InputError

__all__ = [
    "BASE_NAMES",
    "FIGURES",
    "MIGRATIONS",
    "TEMPERATURES",
    "connect_reading",
    "connect_writing",
    "disk_error",
    "packed_figures",
]

# `application_id` of a store (the letters IMUF), by which the program `file` and this package recognise a
# store.
APPLICATION: Final = 0x494D5546
# Time, s, for which a process waits while another process writes to the store.
BUSY_S: Final = 60.0
# Maximum size of the memory map through which SQLite reads a store, bytes. Through the map, SQLite reads
# pages without copying them.
MAPPED_BYTES: Final = 1 << 31

_PAIRS: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
# The 21 parameters of both triads in the symmetric frame (the body frame in which the sensitivity matrix of
# the accelerometer is symmetric), in the order of `Calibration.parameters`. Each parameter is a column of the
# table results, and its standard deviation is the column NAME_sigma.
BASE_NAMES: Final = (
    *(f"accel_bias_{axis}" for axis in "xyz"),
    *(f"accel_sensitivity_{entry}" for entry in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *(f"gyro_bias_{axis}" for axis in "xyz"),
    *(f"gyro_sensitivity_{entry}" for entry in _PAIRS),
)
_SETS: Final = ("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg", "rests", "moves")
# Figures of merit on the calibration recordings, and, with the prefix `control_`, on the control recordings.
FIGURES: Final = (*_SETS, *(f"control_{name}" for name in _SETS))
# Columns with the temperature range of the recordings.
TEMPERATURES: Final = ("temperature_low_degc", "temperature_high_degc")


def _first(connection: sqlite3.Connection) -> None:
    """Version 1: creates all tables."""
    numbers = ", ".join(f"{name} REAL" for name in FIGURES)
    parameters = ", ".join(f"{name} REAL, {name}_sigma REAL" for name in BASE_NAMES)
    for statement in (
        "CREATE TABLE units (id INTEGER PRIMARY KEY, serial TEXT NOT NULL UNIQUE)",
        "CREATE TABLE options (id INTEGER PRIMARY KEY, options TEXT NOT NULL UNIQUE)",
        "CREATE TABLE names (id INTEGER PRIMARY KEY, names TEXT NOT NULL UNIQUE)",
        """CREATE TABLE jobs (
            id INTEGER PRIMARY KEY,
            key TEXT NOT NULL UNIQUE,
            recording TEXT NOT NULL,
            unit INTEGER NOT NULL REFERENCES units (id),
            date TEXT, station TEXT, operator TEXT, batch TEXT, role TEXT,
            files TEXT NOT NULL,
            control TEXT NOT NULL,
            options INTEGER NOT NULL REFERENCES options (id),
            version TEXT NOT NULL,
            verdict TEXT NOT NULL CHECK (verdict IN ('good', 'incomplete', 'poor', 'failed', 'poisoned')),
            code TEXT,
            message TEXT,
            seconds REAL,
            stored_at TEXT NOT NULL,
            current INTEGER NOT NULL CHECK (current IN (0, 1)))""",
        "CREATE INDEX jobs_recording ON jobs (recording)",
        "CREATE INDEX jobs_unit ON jobs (unit)",
        "CREATE INDEX jobs_verdict ON jobs (verdict, date)",
        f"""CREATE TABLE results (
            job INTEGER PRIMARY KEY REFERENCES jobs (id),
            reasons TEXT NOT NULL,
            findings TEXT NOT NULL,
            accel_unit TEXT NOT NULL, gyro_unit TEXT NOT NULL,
            temperature_low_degc REAL, temperature_high_degc REAL,
            {numbers},
            gap_verdict TEXT, gap_effects TEXT,
            {parameters},
            other_figures TEXT NOT NULL,
            other_parameters TEXT NOT NULL,
            names INTEGER NOT NULL REFERENCES names (id),
            parameter_values BLOB NOT NULL, sigmas BLOB NOT NULL)""",
        # Large values are in a separate table, so that a query over all results does not read them.
        """CREATE TABLE documents (
            job INTEGER PRIMARY KEY REFERENCES jobs (id), covariance BLOB, document BLOB NOT NULL)""",
        """CREATE VIEW measurements AS SELECT units.serial, jobs.*, results.*
            FROM jobs JOIN units ON units.id = jobs.unit LEFT JOIN results ON results.job = jobs.id
            WHERE jobs.current""",
    ):
        connection.execute(statement)


def _second(connection: sqlite3.Connection) -> None:
    """Version 2: adds the figures of merit as one blob, which is read faster than separate columns."""
    connection.execute("ALTER TABLE results ADD COLUMN figure_names INTEGER REFERENCES names (id)")
    connection.execute("ALTER TABLE results ADD COLUMN figure_values BLOB")
    columns = (*TEMPERATURES, *FIGURES)
    rows = connection.execute(f"SELECT job, other_figures, {', '.join(columns)} FROM results")
    names: dict[str, int] = {}
    while block := rows.fetchmany(1000):
        for job, others, *known in block:
            text, values = packed_figures(dict(zip(columns, known, strict=True)) | json.loads(others))
            if text not in names:
                connection.execute("INSERT INTO names (names) VALUES (?) ON CONFLICT DO NOTHING", [text])
                (names[text],) = connection.execute("SELECT id FROM names WHERE names = ?", [text]).fetchone()
            connection.execute(
                "UPDATE results SET figure_names = ?, figure_values = ? WHERE job = ?",
                [names[text], values, job],
            )


def packed_figures(figures: Mapping[str, float | None]) -> tuple[str, bytes]:
    """Names of figures of merit as a JSON list, and their values as float64; NaN for a missing value."""
    values = np.array([np.nan if value is None else value for value in figures.values()], dtype="<f8")
    return json.dumps(list(figures)), values.tobytes()


# The first function creates the tables of version 1. Each further function converts the tables from one
# version to the next. The number of functions is the current version of the tables.
MIGRATIONS: Final[tuple[Callable[[sqlite3.Connection], None], ...]] = (_first, _second)


def connect_writing(
    path: str | os.PathLike[str],
    migrations: tuple[Callable[[sqlite3.Connection], None], ...] = MIGRATIONS,
) -> sqlite3.Connection:
    """A connection for writing. The store is created, or migrated to this version, if necessary.

    Raises InputError if the file cannot be opened, and FormatError if it is not a store of this version or an
    older one.
    """
    connection = _open(path, f"{_uri(path)}?mode=rwc")
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        # With this setting, committed data are on the disk when the commit returns, and survive a power
        # failure.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        # Two processes may open a new store at the same time. One creates the tables while the other waits.
        connection.execute("BEGIN IMMEDIATE")
        version = _version(connection, path, len(migrations), may_be_new=True)
        for number in range(version, len(migrations)):
            migrations[number](connection)
        connection.execute(f"PRAGMA user_version = {len(migrations)}")
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute("COMMIT")
    except sqlite3.Error as error:
        connection.close()
        raise disk_error(path, error) from None
    except BaseException:
        connection.close()
        raise
    return connection


def connect_reading(path: str | os.PathLike[str]) -> sqlite3.Connection:
    """A connection that only reads and cannot attach other files.

    Raises InputError if the file cannot be opened, and FormatError if it is not a store of this version.
    """
    if not Path(path).is_file():
        raise InputError(f"{os.fspath(path)}: there is no such store: `imucal fleet run` makes one")
    connection = _open(path, f"{_uri(path)}?mode=ro")
    try:
        version = _version(connection, path, len(MIGRATIONS), may_be_new=False)
    except sqlite3.Error as error:
        connection.close()
        raise disk_error(path, error) from None
    except BaseException:
        connection.close()
        raise
    if version < len(MIGRATIONS):
        connection.close()
        connect_writing(path).close()
        return connect_reading(path)
    connection.execute("PRAGMA query_only = ON")
    connection.execute(f"PRAGMA mmap_size = {MAPPED_BYTES}")
    connection.set_authorizer(_only_reading)
    return connection


def disk_error(path: str | os.PathLike[str], error: sqlite3.Error, stored: str = "") -> InputError:
    """The error for a store that cannot be read or written.

    stored   part of the message that states how many outcomes are already in the store
    """
    reason, name = str(error), os.fspath(path)
    if "locked" in reason:
        way_out = "another process has locked it; wait until that process ends, or end it"
    elif "full" in reason or "I/O" in reason:
        way_out = "free space on its disk, and run the same command again, which resumes"
    elif "not a database" in reason or "malformed" in reason:
        way_out = "it is no store, or is damaged: give another file"
    else:
        way_out = "check its path and its permissions"
    return InputError(f"{name} cannot be used as a store: {reason}{stored}: {way_out}")


def _open(path: str | os.PathLike[str], uri: str) -> sqlite3.Connection:
    try:
        # No implicit transactions, because each writer begins and ends its transactions explicitly.
        connection = sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None)
    except sqlite3.Error as error:
        raise disk_error(path, error) from None
    return connection


def _uri(path: str | os.PathLike[str]) -> str:
    return Path(path).absolute().as_uri()


def _version(
    connection: sqlite3.Connection, path: str | os.PathLike[str], known: int, *, may_be_new: bool
) -> int:
    """The version of the tables; 0 for a new file. Raises FormatError for a version above `known`."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if may_be_new and not tables and not version and not application:
        return 0
    if application != APPLICATION:
        raise FormatError(
            f"{os.fspath(path)} is a database of another program: give the path of a store of `imucal fleet "
            "run`, or of a new file"
        )
    if version > known:
        raise FormatError(
            f"{os.fspath(path)} is a store of version {version}, and this imucal knows versions to {known}: "
            "install a newer imucal"
        )
    return int(version)


def _only_reading(action: int, *_: object) -> int:
    """Refuses statements that attach or detach another file."""
    refused = (sqlite3.SQLITE_ATTACH, sqlite3.SQLITE_DETACH)
    return sqlite3.SQLITE_DENY if action in refused else sqlite3.SQLITE_OK
