"""The columns that the reader of a format returns, before they are converted to a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.finding import Finding

__all__ = ["ROWS_AT_ONCE", "Stored", "Table", "parts"]

# Number of rows of a table that are processed at once. Their columns fit into the processor's cache.
ROWS_AT_ONCE: Final = 1 << 16


class Stored:
    """A column whose values are read when needed. `batches` reads columns of the file by their names."""

    def __init__(
        self, name: str, type: Any, rows: int, batches: Callable[[list[str]], Iterator[Any]]
    ) -> None:
        self.name, self.type, self.rows, self.batches = name, type, rows, batches

    def __len__(self) -> int:
        return self.rows


@dataclass(frozen=True)
class Table:
    """Named columns of equal length: all Arrow arrays, all NumPy arrays, or all `Stored` columns.

    place        function that returns the position of row i in the file, for messages: "line 12"
    findings     repairs and omissions of the reader
    ticks_per_s  ticks per second of the time column if its unit has no canonical name, such as 100 us;
                 otherwise None
    """

    file: str
    names: list[str]
    columns: list[Any]
    place: Callable[[int], str]
    findings: tuple[Finding, ...] = ()
    ticks_per_s: float | None = None

    def column(self, name: str) -> Any:
        """The column of this name."""
        return self.columns[self.names.index(name)]


def parts(columns: Sequence[Any]) -> Iterator[list[Any]]:
    """The columns of a table in parts of at most `ROWS_AT_ONCE` rows."""
    if columns and isinstance(columns[0], Stored):
        for batch in columns[0].batches([column.name for column in columns]):
            yield [batch.column(column.name) for column in columns]
    elif columns and isinstance(columns[0], np.ndarray):
        for start in range(0, len(columns[0]), ROWS_AT_ONCE):
            yield [column[start : start + ROWS_AT_ONCE] for column in columns]
    elif columns:
        import pyarrow as pa

        table = pa.table(list(columns), names=[str(index) for index in range(len(columns))])
        for batch in table.to_batches(max_chunksize=ROWS_AT_ONCE):
            yield batch.columns
