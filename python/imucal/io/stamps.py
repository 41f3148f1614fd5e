"""Joins the two columns of a ROS time stamp, seconds and nanoseconds, to one column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from imucal.errors import FormatError
from imucal.io.arrow_values import arrow_of, numpy_of
from imucal.io.table import Stored, Table

__all__ = ["NANOSECONDS", "joined_stamps"]

# Temporary name of the column of nanoseconds. The column of seconds has the name time_ns from the start, and
# the joined time stamps replace its values.
NANOSECONDS: Final = "stamp_nanoseconds"


def joined_stamps(table: Table) -> Table:
    """The table with seconds and nanoseconds as one column time_ns, if it has both.

    Raises FormatError with the place of a cell that is not a whole number. If the columns are stored in a
    file, they are joined and checked later, when their values are read.
    """
    if NANOSECONDS not in table.names:
        return table
    at, other = table.names.index("time_ns"), table.names.index(NANOSECONDS)
    names, columns = list(table.names), list(table.columns)
    seconds, nanoseconds = columns[at], columns[other]
    if isinstance(seconds, Stored):
        columns = _joined_when_read(table, seconds, nanoseconds)
    else:
        stamps = _joined(table, 0, seconds, nanoseconds)
        columns[at] = stamps if isinstance(seconds, np.ndarray) else arrow_of(stamps)
    del names[other], columns[other]
    return replace(table, names=names, columns=columns)


def _joined_when_read(table: Table, seconds: Stored, nanoseconds: Stored) -> list[Stored]:
    """The columns of `table`, in which the column of seconds gives the joined time stamps when it is read."""
    import pyarrow as pa

    def batches(names: list[str]) -> Iterator[Any]:
        is_wanted = seconds.name in names
        needed = [*names, nanoseconds.name] if is_wanted else names
        first = 0
        for batch in seconds.batches(needed):
            values = {name: batch.column(name) for name in names}
            if is_wanted:
                stamps = _joined(table, first, values[seconds.name], batch.column(nanoseconds.name))
                values[seconds.name] = arrow_of(stamps)
            first += len(batch)
            yield pa.RecordBatch.from_arrays(list(values.values()), names=list(values))

    def stored(column: Stored) -> Stored:
        return Stored(column.name, pa.int64() if column is seconds else column.type, column.rows, batches)

    return [stored(column) for column in table.columns]


def _joined(table: Table, first: int, seconds: Any, nanoseconds: Any) -> NDArray[np.int64]:
    """The time stamps in ns of rows from row `first` on."""
    whole, part = (_whole_numbers(table, first, values) for values in (seconds, nanoseconds))
    return whole * 1_000_000_000 + part


def _whole_numbers(table: Table, first: int, column: Any) -> NDArray[np.int64]:
    values = numpy_of(column)
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.round(values))))
    if len(bad):
        raise FormatError(
            f"{table.file}: {table.place(first + int(bad[0]))}: the seconds and nanoseconds of a time stamp "
            "must be whole numbers: remove the line, or name another time column with --columns"
        )
    return values.astype(np.int64)
