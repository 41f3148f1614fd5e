"""The first cells of a text table, from which the roles and units of its columns are inferred."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from imucal.io.dates import is_date_column
from imucal.io.first_cells import HEAD_ROWS
from imucal.io.header import Triad
from imucal.io.layout import is_number, split_line
from imucal.io.text import Text

__all__ = ["FirstCells", "Head"]


class FirstCells(Protocol):
    """The first cells of a table by column name."""

    def numbers(self, name: str) -> Any:
        """The first numbers of a column; NaN for cells that are not numbers."""

    def triad(self, triad: Triad) -> Any:
        """The first samples of three columns, (N, 3)."""

    def is_date(self, name: str) -> bool:
        """Whether a column contains dates or times of day."""


class Head:
    """The first cells of a text table by column name."""

    def __init__(self, text: Text) -> None:
        layout = text.layout
        start, is_all = text.first_rows(1 << 16)
        lines = start.decode(errors="replace").split("\n")
        if not is_all:
            lines = lines[:-1]
        rows = [split_line(line, layout.separator) for line in lines[:HEAD_ROWS] if line.strip()]
        names = layout.names or [str(index) for index in range(layout.width)]
        width = len(layout.first)
        rows = [row for row in rows if len(row) == width]
        columns = map(list, zip(*rows, strict=True))
        # A header may have more names than the rows have cells.
        self.cells: dict[str, list[str]] = {name: [] for name in names}
        self.cells |= zip(names, columns, strict=False)
        self._decimal = layout.decimal

    def numbers(self, name: str) -> Any:
        """The first numbers of a column; NaN for cells that are not numbers."""
        cells = self.cells.get(name, [])
        if all(map(is_number, cells)):
            return np.array(list(map(float, cells)))
        return np.array([_number(cell, self._decimal) for cell in cells])

    def triad(self, triad: Triad) -> Any:
        """The first samples of three columns, (N, 3)."""
        return np.column_stack([self.numbers(name) for name in triad.columns])

    def is_date(self, name: str) -> bool:
        """Whether a column contains dates or times of day."""
        cells = self.cells.get(name, [])[:50]
        if all(map(is_number, cells)):
            return False
        import pyarrow as pa

        return is_date_column(pa.array(cells, pa.string())) is not None


def _number(cell: str, decimal: str) -> float:
    try:
        # float() would accept the date 2026_01_31 as a number.
        return float("nan" if "_" in cell else cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return float("nan")
