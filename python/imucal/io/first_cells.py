"""The first cells of a table, from which units are inferred. Columns may be in memory or in a file."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.io.arrow_values import numpy_of
from imucal.io.header import Triad
from imucal.io.table import Table, parts

__all__ = ["HEAD_ROWS", "TableCells", "is_numeric"]

# Number of rows from which units are inferred.
HEAD_ROWS: Final = 1500


class TableCells:
    """The first cells of a table by column name."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._part = cache(self._first_part)

    def numbers(self, name: str) -> FloatArray:
        """The first numbers of a column; a single NaN if the column is not numeric."""
        part = self._part(name)
        if part is None or not is_numeric(self._table.column(name)):
            return np.array([math.nan])
        return np.asarray(numpy_of(part[:HEAD_ROWS]), dtype=np.float64)

    def texts(self, name: str) -> list[str]:
        """The first cells of a column as text, with dates in ISO form."""
        part = self._part(name)
        if part is None:
            return []
        return [str(cell) for cell in part[:50].tolist()]

    def triad(self, triad: Triad) -> FloatArray:
        """The first samples of three columns, (N, 3)."""
        return np.column_stack([self.numbers(name) for name in triad.columns])

    def is_date(self, name: str) -> bool:
        """Whether a column contains time stamps (date with time of day)."""
        column = self._table.column(name)
        if isinstance(column, np.ndarray):
            return False
        import pyarrow as pa

        return bool(pa.types.is_timestamp(column.type))

    def _first_part(self, name: str) -> Any:
        return next(parts([self._table.column(name)]), [None])[0]


def is_numeric(column: Any) -> bool:
    """Whether a column consists of numbers or of empty cells."""
    if isinstance(column, np.ndarray):
        return True
    import pyarrow as pa

    kind = column.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind))
