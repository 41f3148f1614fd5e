"""A fleet: many units in one store.

fleet = imucal.Fleet("units.sqlite")
fleet.run("manifest.csv")
fleet.measurements(since="2026-11-01").values_si
fleet.to_pandas()
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucal.calibration.calibration import Calibration
from imucal.errors import InputError
from imucal.fleet.cluster import DaskPool
from imucal.fleet.job import Job, Options, as_date
from imucal.fleet.judging import Judging
from imucal.fleet.local import LocalPool, Pool
from imucal.fleet.manifest import is_manifest, jobs_of_manifest
from imucal.fleet.measurements import Measurements
from imucal.fleet.naming import files_of, naming_of
from imucal.fleet.reading import batches_of, conditions, documents, measurements, query
from imucal.fleet.run import Tally, Tell, run_jobs
from imucal.fleet.schema import connect_reading, disk_error
from imucal.fleet.store import Store
from imucal.limits.limits import Limits

if TYPE_CHECKING:
    import pandas
    import pyarrow as pa

__all__ = ["Fleet"]


@dataclass(frozen=True)
class Fleet(Judging):
    """The store of many units, which is one SQLite file. `run` creates it.

    The object contains only the path, so it can be sent to other processes. Every method opens the file.
    Reading methods return all rows that are stored at that time, even during a run.

    All methods select rows in the same way: `serial`, `station`, `operator`, `batch`, `role` and `verdict`
    must equal the given text; `since` is the first selected date, and `until` the first date after the
    selection. If a recording was calibrated several times, with different options or versions, the last
    calibration is used.
    """

    path: str | os.PathLike[str]

    def run(
        self,
        what: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Iterable[Job],
        *,
        names: str | None = None,
        limits: Limits | str | os.PathLike[str] | None = None,
        gap: bool = False,
        read: Mapping[str, Any] | None = None,
        calibrate: Mapping[str, Any] | None = None,
        workers: int | None = None,
        scheduler: Any = None,
        retry: bool = False,
        time_limit_s: float | None = None,
        total: int | None = None,
        tell: Tell | None = None,
        tally: Tally | None = None,
    ) -> Tally:
        """Calibrate the units whose recordings are not in the store.

        what       path of a manifest (.csv, see docs/fleet.md), files, folders or glob patterns, or jobs
        names      pattern of paths from which serial numbers are taken, such as "{date}/{serial}.csv"
        limits     limits, or the path of a limits file
        gap        whether to also search each unit for an effect that its calibration does not include
        read, calibrate   arguments of `imucal.read` and `imucal.calibrate`
        workers    processes on this computer; None for one per processor
        scheduler  address of a Dask scheduler, or a `distributed.Client`, instead of `workers`
        retry      whether to compute again the units that have no result
        time_limit_s   longest computing time for one unit, s; a unit that takes longer has no result
        total      number of jobs, if it is known
        tell       callback for each unit with its job, its verdict, and code and message of a failure
        tally      counts of earlier runs, to which the counts of this run are added

        Raises InputError for wrong arguments and if the store cannot be written, and ImucalError if the
        scheduler is lost. After such an error, the store contains all outcomes that were reported to `tell`,
        and another call of `run` computes the remaining units.
        """
        if workers is not None and workers < 1:
            raise InputError(f"workers is {workers}: give 1 or more, or leave it out")
        if limits is not None and not isinstance(limits, Limits):
            limits = Limits.load(limits)
        options = Options(read or {}, calibrate or {}, limits, gap, time_limit_s)
        jobs = _jobs_of(what, names)
        make_pool: Callable[[], Pool] = (
            partial(LocalPool, workers) if scheduler is None else partial(DaskPool, scheduler)
        )
        known = len(jobs) if total is None and isinstance(jobs, Sequence) else total
        with Store(self.path) as store:
            return run_jobs(store, jobs, options, make_pool, total=known, retry=retry, tell=tell, tally=tally)

    def merge(self, *stores: str | os.PathLike[str]) -> int:
        """Copy the rows of other stores into this store. Returns the number of rows that were new to it."""
        for path in stores:
            if Path(path).exists() and Path(self.path).exists() and Path(path).samefile(self.path):
                raise InputError(f"{os.fspath(path)} cannot be merged with itself: give other stores")
        with Store(self.path) as store:
            return sum(store.take_from(path) for path in stores)

    def query(self, sql: str, arguments: Sequence[Any] = ()) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Column names and rows of the result of a read-only SQL statement.

        docs/fleet.md describes the tables. Raises InputError for a statement that is wrong or would write.
        """
        with self._reading() as connection:
            return query(connection, sql, arguments)

    def rows(
        self, columns: Sequence[str], **selection: str | None
    ) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of the given columns of the SQL view `measurements`, and the selected rows sorted by date."""
        where, arguments = _selected(selection)
        with self._reading() as connection:
            sql = f"SELECT {', '.join(columns)} FROM measurements WHERE {where} ORDER BY date, serial, id"
            return query(connection, sql, arguments)

    def count(self, **selection: str | None) -> dict[str, int]:
        """The number of selected rows for each verdict."""
        where, arguments = _selected(selection)
        with self._reading() as connection:
            sql = f"SELECT verdict, count(*) FROM measurements WHERE {where} GROUP BY verdict"
            return dict(query(connection, sql, arguments)[1])

    def failures(self, **selection: str | None) -> dict[str, int]:
        """For each reason code, most frequent first, the number of selected rows that have no result."""
        where, arguments = _selected(selection)
        with self._reading() as connection:
            sql = (
                f"SELECT code, count(*) FROM measurements WHERE {where} AND code IS NOT NULL "
                "GROUP BY code ORDER BY count(*) DESC, code"
            )
            return dict(query(connection, sql, arguments)[1])

    def same_recordings(self, **selection: str | None) -> list[list[str]]:
        """Lists of serial numbers; the calibrations of the units of one list are equal to the last bit.

        Such units have the same recording, because a file was copied or a serial number is wrong. Even two
        recordings of one unit never have equal results, because the noise in the recordings differs.
        """
        where, arguments = _selected(selection)
        with self._reading() as connection:
            sql = (
                "SELECT json_group_array(DISTINCT serial) FROM measurements "
                f"WHERE {where} AND parameter_values IS NOT NULL GROUP BY parameter_values, sigmas "
                "HAVING count(DISTINCT serial) > 1"
            )
            found = query(connection, sql, arguments)[1]
        return sorted(sorted(json.loads(serials)) for (serials,) in found)

    def to_arrow(self, **selection: str | None) -> pa.Table:
        """The selected rows as an Arrow table, including rows without a result."""
        import pyarrow as pa

        where, arguments = _selected(selection)
        with self._reading() as connection:
            return pa.Table.from_batches(batches_of(connection, where, arguments))

    def to_pandas(self, **selection: str | None) -> pandas.DataFrame:
        """The selected rows as a data frame; needs pandas."""
        return self.to_arrow(**selection).to_pandas()

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """All current rows as an Arrow stream."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def write_parquet(self, path: str | os.PathLike[str], **selection: str | None) -> int:
        """Write the selected rows to a Parquet file, atomically; returns their number."""
        import pyarrow.parquet as parquet

        from imucal.document.atomic import write_atomically

        where, arguments = _selected(selection)
        rows = 0
        with self._reading() as connection, write_atomically(path) as file:
            batches = batches_of(connection, where, arguments)
            first = next(batches)
            with parquet.ParquetWriter(file, first.schema) as writer:
                for batch in (first, *batches):
                    writer.write_batch(batch)
                    rows += batch.num_rows
        return rows

    def measurements(self, *, covariances: bool = False, **selection: str | None) -> Measurements:
        """The selected calibrations as arrays, in order of their dates.

        covariances   whether to include the covariances of the parameters, which need 3.5 kB per row
        """
        where, arguments = _selected(selection)
        with self._reading() as connection:
            return measurements(connection, where, arguments, covariances=covariances)

    def documents(self, **selection: str | None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Serial number and JSON document of each selected calibration.

        A document has the keys `calibration` (the calibration file), `judgement` (its checks against limits)
        and `gap` (the result of the search for missing effects).
        """
        where, arguments = _selected(selection)
        with self._reading() as connection:
            yield from documents(connection, where, arguments)

    def calibration(self, serial: str) -> Calibration:
        """The last calibration of a unit. Raises InputError if there is none."""
        found = [document for _, document in self.documents(serial=serial)]
        if not found:
            raise InputError(f"{os.fspath(self.path)} has no calibration of unit {serial!r}")
        return Calibration.from_dict(found[-1]["calibration"], f"unit {serial}")

    def _reading(self) -> closing[sqlite3.Connection]:
        try:
            return closing(connect_reading(self.path))
        except sqlite3.Error as error:
            raise disk_error(self.path, error) from None


def _jobs_of(what: Any, names: str | None) -> Iterable[Job]:
    if isinstance(what, (str, os.PathLike)):
        if is_manifest(what):
            return jobs_of_manifest(what)
        what = [what]
    items = list(what) if isinstance(what, Sequence) else what
    if isinstance(items, list) and items and not isinstance(items[0], Job):
        return naming_of(names).jobs(files_of([os.fspath(item) for item in items]))
    return items


def _selected(given: Mapping[str, str | None]) -> tuple[str, list[str]]:
    unknown = [name for name in given if name not in SELECTION]
    if unknown:
        raise TypeError(f"unknown selection {unknown[0]!r}: give one of {', '.join(SELECTION)}")
    used = dict(given)
    for name in ("since", "until"):
        if (date := used.get(name)) is not None:
            used[name] = as_date(date, name)
    return conditions(used)


SELECTION = ("serial", "role", "station", "operator", "batch", "verdict", "since", "until")
