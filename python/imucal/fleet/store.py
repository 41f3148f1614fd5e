"""Writing to a store. Only one process writes at a time. Committed data survive a power failure."""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import imucal._core as _core
from imucal.document.date import now
from imucal.fleet.job import UNREAD, KeyedJob
from imucal.fleet.outcome import TRANSIENT, Outcome
from imucal.fleet.schema import (
    BASE_NAMES,
    FIGURES,
    TEMPERATURES,
    connect_reading,
    connect_writing,
    disk_error,
    packed_figures,
)

__all__ = ["Known", "Store"]

JOB_COLUMNS: Final = (
    *(
        "key",
        "recording",
        "unit",
        "date",
        "station",
        "operator",
        "batch",
        "role",
        "files",
        "control",
        "options",
    ),
    *("version", "verdict", "code", "message", "seconds", "stored_at", "current"),
)
RESULT_COLUMNS: Final = (
    *(
        "job",
        "reasons",
        "findings",
        "accel_unit",
        "gyro_unit",
        "temperature_low_degc",
        "temperature_high_degc",
    ),
    *FIGURES,
    *("gap_verdict", "gap_effects"),
    *(column for name in BASE_NAMES for column in (name, f"{name}_sigma")),
    *("other_figures", "other_parameters", "names", "parameter_values", "sigmas"),
    *("figure_names", "figure_values"),
)
# Columns of a manifest that describe the measurement and not its files. A later manifest may correct the
# stored values.
ABOUT: Final = ("date", "station", "operator", "batch", "role")


def _insert(table: str, columns: Sequence[str]) -> str:
    return f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


INSERT_JOB: Final = _insert("jobs", JOB_COLUMNS) + " ON CONFLICT (key) DO NOTHING"
INSERT_RESULT: Final = _insert("results", RESULT_COLUMNS)
# A recording has several jobs if it was computed with different options or versions of imucal. The last job
# is the current job.
SET_CURRENT: Final = """UPDATE jobs SET current = id = (
    SELECT id FROM jobs WHERE recording = :r ORDER BY stored_at DESC, id DESC LIMIT 1) WHERE recording = :r"""


@dataclass(frozen=True)
class Known:
    """The outcome of a job as the store contains it."""

    verdict: str
    code: str | None
    message: str | None


class Store:
    """A store that is open for writing; use it in a `with` block.

    Raises InputError, with the number of outcomes that this object has stored, if the disk is full or fails.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self.stored = 0
        self._connection = connect_writing(path)
        # Cached identifiers of texts that many rows share. Serial numbers are not cached, because there are
        # too many.
        self._ids: dict[tuple[str, str], int] = {}
        with self._failing():
            (self._was_empty,) = self._connection.execute("SELECT NOT EXISTS (SELECT 1 FROM jobs)").fetchone()
            self._others = self._version_by_others()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(sqlite3.Error):
            self._connection.close()

    def known(self, keys: Sequence[str]) -> dict[str, Known]:
        """The stored outcomes of the jobs with these keys; a key that is not in the store is omitted."""
        with self._failing():
            rows = self._connection.execute(
                "SELECT key, verdict, code, message FROM jobs WHERE key IN (SELECT value FROM json_each(?))",
                [json.dumps(list(keys))],
            ).fetchall()
        return {key: Known(*rest) for key, *rest in rows}

    @property
    def is_new(self) -> bool:
        """Whether the store was empty when it was opened, and no other process has changed it since."""
        with self._failing():
            return bool(self._was_empty) and self._version_by_others() == self._others

    def put(self, outcomes: Sequence[Outcome], options: str) -> list[bool]:
        """Store outcomes in one transaction, so that after a crash the store has all of them or none.

        If the key of an outcome is already in the store, the stored outcome is not changed. Returns for each
        outcome whether it was new.
        """
        moment, version = now(), str(_core.__version__)
        with self._transaction():
            number = self._id("options", "options", options)
            new = [self._put(outcome, number, version, moment) for outcome in outcomes]
        self.stored += len(outcomes)
        return new

    def describe(self, jobs: Sequence[KeyedJob]) -> None:
        """Copy the known dates, stations, operators, batches and roles of `jobs` to the stored jobs."""
        changes = ", ".join(f"{name} = ifnull(?, {name})" for name in ABOUT)
        with self._transaction():
            self._connection.executemany(
                f"UPDATE jobs SET {changes} WHERE key = ?",
                [(*(getattr(keyed.job, name) for name in ABOUT), keyed.key) for keyed in jobs],
            )

    def forget(self, keys: Sequence[str]) -> None:
        """Remove jobs without a result, so that they are tried again."""
        with self._transaction():
            self._connection.executemany(
                "DELETE FROM jobs WHERE key = ? AND verdict IN ('failed', 'poisoned')",
                [(key,) for key in keys],
            )

    def take_from(self, path: str | os.PathLike[str]) -> int:
        """Copy all jobs of another store that are not in this store. Returns their number."""
        source, taken = connect_reading(path), 0
        try:
            source.row_factory = sqlite3.Row
            rows = source.execute(
                "SELECT jobs.*, units.serial, options.options AS option_text FROM jobs "
                "JOIN units ON units.id = jobs.unit JOIN options ON options.id = jobs.options ORDER BY "
                "jobs.id"
            )
            while block := rows.fetchmany(COPIED_AT_ONCE):
                with self._transaction():
                    taken += sum(self._copy(source, row) for row in block)
        except sqlite3.Error as error:
            raise disk_error(path, error) from None
        finally:
            source.close()
        return taken

    def _put(self, outcome: Outcome, options: int, version: str, moment: str) -> bool:
        """Insert an outcome. Returns whether its key is new."""
        job, keyed = outcome.keyed.job, outcome.keyed
        self._forget_failures_of(keyed)
        code, message = outcome.code, outcome.message
        row = (
            *(keyed.key, keyed.recording, self._unit(job.serial)),
            *(getattr(job, name) for name in ABOUT),
            *(json.dumps(job.files), json.dumps(job.control), options, version),
            *(
                outcome.verdict,
                code,
                None if message is None else _valid(message),
                outcome.seconds,
                moment,
                1,
            ),
        )
        number = self._insert_job(row, keyed.recording)
        if number is None or outcome.measured is None:
            return number is not None
        given = outcome.measured
        numbers = zip(_numbers(given.values), _numbers(given.sigmas), strict=True)
        pairs = dict(zip((name for name, _ in given.names), numbers, strict=True))
        low, high = given.temperature_degc or (None, None)
        others = {name: pair for name, pair in pairs.items() if name not in BASE_NAMES}
        other_figures = {name: value for name, value in given.figures.items() if name not in FIGURES}
        figure_names, figure_values = packed_figures(
            dict(zip(TEMPERATURES, (low, high), strict=True)) | dict.fromkeys(FIGURES) | dict(given.figures)
        )
        result = (
            *(
                number,
                json.dumps(given.reasons),
                json.dumps(given.findings),
                given.accel_unit,
                given.gyro_unit,
            ),
            *(low, high),
            *(given.figures.get(name) for name in FIGURES),
            *(given.gap_verdict, json.dumps(given.gap_effects)),
            *(each for name in BASE_NAMES for each in pairs.get(name, (None, None))),
            *(json.dumps(other_figures), json.dumps(others)),
            self._id("names", "names", json.dumps(given.names)),
            *(given.values, given.sigmas),
            *(self._id("names", "names", figure_names), figure_values),
        )
        self._connection.execute(INSERT_RESULT, result)
        self._connection.execute(
            "INSERT INTO documents VALUES (?, ?, ?)", (number, given.covariance, given.document)
        )
        return True

    def _insert_job(self, row: Sequence[Any], recording: str) -> int | None:
        """Insert a job. Returns the identifier of its row, or None if its key is already in the store."""
        cursor = self._connection.execute(INSERT_JOB, row)
        if cursor.rowcount != 1:
            return None
        self._connection.execute(SET_CURRENT, {"r": recording})
        return cursor.lastrowid

    def _forget_failures_of(self, keyed: KeyedJob) -> None:
        """Remove stored failures of the files of this job if their cause may be gone (`TRANSIENT`)."""
        self._connection.execute(
            f"DELETE FROM jobs WHERE unit = ? AND files = ? AND (code IN ({', '.join('?' * len(TRANSIENT))}) "
            "OR substr(key, 1, ?) = ?)",
            (self._unit(keyed.job.serial), json.dumps(keyed.job.files), *TRANSIENT, len(UNREAD), UNREAD),
        )

    def _copy(self, source: sqlite3.Connection, row: sqlite3.Row) -> bool:
        number = row["id"]
        values = {name: row[name] for name in JOB_COLUMNS}
        values["unit"] = self._unit(row["serial"])
        values["options"] = self._id("options", "options", row["option_text"])
        copied = self._insert_job([values[name] for name in JOB_COLUMNS], row["recording"])
        if copied is None:
            return False
        for table, columns in (("results", RESULT_COLUMNS), ("documents", ("job", "covariance", "document"))):
            found = source.execute(
                f"SELECT {', '.join(columns)} FROM {table} WHERE job = ?", [number]
            ).fetchone()
            if found is None:
                continue
            fields = dict(zip(columns, found, strict=True)) | {"job": copied}
            for name in fields.keys() & {"names", "figure_names"}:
                (names,) = source.execute("SELECT names FROM names WHERE id = ?", [fields[name]]).fetchone()
                fields[name] = self._id("names", "names", names)
            self._connection.execute(_insert(table, columns), list(fields.values()))
        return True

    def _version_by_others(self) -> int:
        """A number that changes when another connection changes the store."""
        (version,) = self._connection.execute("PRAGMA data_version").fetchone()
        return int(version)

    def _unit(self, serial: str) -> int:
        self._connection.execute("INSERT INTO units (serial) VALUES (?) ON CONFLICT DO NOTHING", [serial])
        (number,) = self._connection.execute("SELECT id FROM units WHERE serial = ?", [serial]).fetchone()
        return int(number)

    def _id(self, table: str, column: str, text: str) -> int:
        """The identifier of a text that many rows share. A new text is inserted."""
        if (table, text) not in self._ids:
            self._connection.execute(
                f"INSERT INTO {table} ({column}) VALUES (?) ON CONFLICT DO NOTHING", [text]
            )
            found = self._connection.execute(f"SELECT id FROM {table} WHERE {column} = ?", [text]).fetchone()
            self._ids[table, text] = int(found[0])
        return self._ids[table, text]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._failing():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                # The rollback may fail, because the failed statement may already have ended the transaction.
                with suppress(sqlite3.Error):
                    self._connection.execute("ROLLBACK")
                # The cache is cleared, because it may contain identifiers of rows that were rolled back.
                self._ids.clear()
                raise

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise disk_error(self.path, error, f"; {self.stored} outcomes of this run are stored") from None


# Number of rows of another store that are copied in one transaction.
COPIED_AT_ONCE: Final = 500


def _numbers(packed: bytes) -> list[float | None]:
    """The float64 numbers of a blob for SQLite, where NULL replaces NaN and infinity."""
    return [value if math.isfinite(value) else None for value in np.frombuffer(packed).tolist()]


def _valid(text: str) -> str:
    """Valid UTF-8 text. File names may contain characters that UTF-8 cannot represent; these are escaped."""
    return text.encode("utf-8", "backslashreplace").decode()
