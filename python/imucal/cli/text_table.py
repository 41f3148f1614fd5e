"""Tables of text for a terminal or a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

__all__ = ["table_lines"]

# Text between two columns.
GAP = "  "


def table_lines(
    headings: Sequence[str], rows: Sequence[Sequence[str]], heading_style: Callable[[str], str]
) -> Iterator[str]:
    """The lines of a table. The first column is aligned left, and all other columns are aligned right.

    heading_style   function that adds the terminal codes of a style to a heading
    """
    widths = [max(map(_width, cells)) for cells in zip(headings, *rows, strict=True)]
    yield _line(headings, widths, heading_style)
    for row in rows:
        yield _line(row, widths, str)


def _line(cells: Sequence[str], widths: Sequence[int], style: Callable[[str], str]) -> str:
    padded = []
    for index, (cell, width) in enumerate(zip(cells, widths, strict=True)):
        space = " " * (width - _width(cell))
        padded.append(f"{style(cell)}{space}" if index == 0 else f"{space}{style(cell)}")
    return GAP.join(padded).rstrip()


def _width(text: str) -> int:
    """The number of columns that a text takes in a terminal: two for wide characters."""
    if text.isascii():
        return len(text)
    from unicodedata import combining, east_asian_width

    return sum(2 if east_asian_width(sign) in "WF" else not combining(sign) for sign in text)
