"""The columns of a table that a recording needs, converted to arrays in one pass over the table."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.errors import FormatError
from imucal.io.arrow_values import numpy_of, present_of, ticks_of
from imucal.io.first_cells import is_numeric
from imucal.io.names import time_unit
from imucal.io.table import Table, parts
from imucal.units import TICKS_PER_S

__all__ = ["Clock", "RequestedColumns", "date_ticks_per_s", "float64"]


@dataclass
class Clock:
    """The time origin of a recording, shared by all of its pieces, and the number of rows read so far."""

    rows: int = 0
    # First time stamp of the recording, in the unit of the time column.
    first: Any = None


class RequestedColumns:
    """The columns of a table that a recording needs. One pass over the table fills all columns.

    The source columns are read in parts, so that source and result are never both completely in memory.
    """

    def __init__(self, table: Table, clock: Clock) -> None:
        self.table = table
        self.clock = clock
        self.rows = len(table.columns[0]) if table.columns else 0
        self._columns: list[Any] = []
        self._takers: list[Callable[[slice, Any], None]] = []

    def numbers(self, name: str, into: NDArray[Any] | None = None, factor: float = 1.0) -> NDArray[Any]:
        """An array for a column multiplied by `factor`, as float64 or as the type of `into`.

        The method `read` fills the array later. Empty cells become NaN.
        """
        out = np.empty(self.rows) if into is None else into

        def take(where: slice, part: Any) -> None:
            values = float64(part)
            out[where] = values if factor == 1.0 else values * factor

        self._request(name, take)
        return out

    def since_first(self, name: str, ticks_per_s: float) -> NDArray[np.float64]:
        """An array for a time column, in s since the first time stamp. The method `read` fills it later."""
        out, clock = np.empty(self.rows), self.clock

        def take(where: slice, part: Any) -> None:
            if date_ticks_per_s(part):
                import pyarrow as pa

                part = part.view(pa.int64())
            is_whole = _is_whole(part)
            present = np.ones(len(part), dtype=bool)
            if is_whole:
                # The first time stamp is subtracted before the conversion to float64, because a time stamp
                # such as 1.4e18 ns has more digits than a float64 can represent.
                present = present_of(part)
                values: NDArray[Any] = ticks_of(part).astype(np.int64)
            else:
                values = float64(part)
                present = np.isfinite(values)
            if clock.first is None and present.any():
                clock.first = values[present.argmax()]
            elapsed = values if clock.first is None else values - clock.first
            out[where] = np.where(present | (not is_whole), elapsed, math.nan) / ticks_per_s

        self._request(name, take)
        return out

    def read(self) -> None:
        """Fill all requested arrays."""
        if self._columns and isinstance(self._columns[0], np.ndarray):
            self._read_arrays()
        start = 0
        for part in parts(self._columns):
            where = slice(start, start + len(part[0]))
            for take, values in zip(self._takers, part, strict=True):
                take(where, values)
            start = where.stop
        self.clock.rows += self.rows

    def _read_arrays(self) -> None:
        """Convert the columns one after the other, and release the memory of each converted column."""
        self.table.columns.clear()
        self._columns.reverse()
        for take in self._takers:
            column, start, part = self._columns.pop(), 0, None
            for (part,) in parts([column]):
                take(slice(start, start + len(part)), part)
                start += len(part)
            del column, part

    def _request(self, name: str, take: Callable[[slice, Any], None]) -> None:
        column = self.table.column(name)
        if not is_numeric(column) and not (time_unit(name) and date_ticks_per_s(column)):
            _refuse_text(self.table, name, column)
        self._columns.append(column)
        self._takers.append(take)


def float64(part: Any) -> NDArray[np.float64]:
    """A numeric column, or a part of a column, as float64, with empty cells as NaN."""
    # NumPy converts the column, because loading Arrow's function library takes longer than reading a short
    # file.
    return np.asarray(numpy_of(part), dtype=np.float64)


def date_ticks_per_s(column: Any) -> float | None:
    """The ticks per second of a time stamp column (date with time of day); None for other types."""
    if isinstance(column, np.ndarray):
        return None
    import pyarrow as pa

    return TICKS_PER_S[column.type.unit] if pa.types.is_timestamp(column.type) else None


def _is_whole(column: Any) -> bool:
    if isinstance(column, np.ndarray):
        return bool(column.dtype.kind == "i")
    import pyarrow as pa

    return bool(pa.types.is_integer(column.type))


def _refuse_text(table: Table, name: str, column: Any) -> None:
    """Raises FormatError with the location of the first cell that is not a number."""
    cells = (cell for (part,) in parts([column]) for cell in part.to_pylist())
    for row, cell in enumerate(cells):
        try:
            float(cell if cell is not None else "nan")
        except (TypeError, ValueError):
            text = repr(cell) if isinstance(cell, str) else str(cell)
            raise FormatError(
                f"{table.file}: {table.place(row)}, column {name}: {text[:40]} is not a number: "
                "correct it or leave the cell empty"
            ) from None
    raise FormatError(f"{table.file}: the column {name} has the type {column.type}, expected numbers")
