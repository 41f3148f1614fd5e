"""Time stamps of ROS in two columns, the seconds and the nanoseconds, joined to one column."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imucal.errors import FormatError
from imucal.io.arrow_values import arrow_of, numpy_of
from imucal.io.table import Table

__all__ = ["NANOSECONDS", "joined_stamps"]

# Name of the column of nanoseconds until it is joined with the column of seconds, whose name is time_ns.
NANOSECONDS: Final = "stamp_nanoseconds"


def joined_stamps(table: Table) -> Table:
    """The table with seconds and nanoseconds as one column time_ns, if it has both.

    Raises FormatError with the place of a cell that is not a whole number.
    """
    if NANOSECONDS not in table.names:
        return table
    at, other = table.names.index("time_ns"), table.names.index(NANOSECONDS)
    stamps = _whole_numbers(table, at) * 1_000_000_000 + _whole_numbers(table, other)
    names, columns = list(table.names), list(table.columns)
    columns[at] = stamps if isinstance(columns[at], np.ndarray) else arrow_of(stamps)
    del names[other], columns[other]
    return replace(table, names=names, columns=columns)


def _whole_numbers(table: Table, index: int) -> NDArray[np.int64]:
    values = numpy_of(table.columns[index])
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.round(values))))
    if len(bad):
        raise FormatError(
            f"{table.file}: {table.place(int(bad[0]))}: the seconds and nanoseconds of a time stamp must be "
            "whole numbers: remove the line, or name another time column with --columns"
        )
    return values.astype(np.int64)
