"""Tables of numbers as text, separated by comma, semicolon, tab or spaces, with or without a header.

A text of plain numbers is parsed in blocks while it is read and hashed, so that a file is never in memory as
a whole. Any other text is read by Arrow in one pass. If Arrow fails, the file is read a second time, and
lines that are not rows of numbers are skipped (see `rows`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

import imucal._core as _core
from imucal.document.source import File, Source, first_bytes, hashed_blocks, open_file
from imucal.errors import FormatError
from imucal.io.last_line import LastLine
from imucal.io.layout import HEAD, Layout, layout_of, plain_text
from imucal.io.names import SKIP, is_canonical, time_unit
from imucal.io.packed import GZIP, unpacked, unpacked_start
from imucal.io.table import Table

__all__ = [
    "NotInPartsError",
    "Text",
    "head_of",
    "headed_parts",
    "layout_of_start",
    "open_path",
    "open_text",
    "read_rows",
]

# Size of the parts in which a file is read, bytes.
PART: Final = 1 << 22
# A text larger than this number of bytes is parsed by several threads. For a smaller text, one thread is
# faster.
WORTH_THREADS: Final = 1 << 24


# Size of the blocks in which texts of plain numbers are parsed, bytes. A block is large enough to be parsed
# by several threads.
BLOCK: Final = 1 << 22
# Size of the end of a file that is searched for an incomplete last line, bytes.
TAIL: Final = 1 << 16


class Text:
    """A text table in memory: its bytes in UTF-8, and its layout.

    label  text that names the sensor if the columns do not: the name of the file, if not given
    """

    def __init__(
        self,
        name: str,
        content: bytes,
        layout: Layout,
        sources: tuple[Source, ...],
        label: str | None = None,
    ) -> None:
        self.name, self.layout, self.label = name, layout, label or name
        self._content, self._sources = content, sources

    @property
    def content(self) -> bytes:
        """The whole text."""
        return self._content

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files that contain the text."""
        return self._sources

    def first_rows(self, size: int) -> tuple[bytes, bool]:
        """The start of the rows, at most `size` bytes, and whether these are all rows."""
        part = self.content[self.layout.start : self.layout.start + size]
        return part, self.layout.start + len(part) == len(self.content)

    def numbers(self, used: list[bool]) -> list[Any] | None:
        """The used columns as arrays if all rows consist of plain numbers; otherwise None."""
        start = self.layout.start
        if LastLine(self.content, self.layout).cut:
            return None
        blocks = (self.content[at : at + BLOCK] for at in range(start, len(self.content), BLOCK))
        return _parsed(self.layout, used, blocks)


class _StoredText(Text):
    """A text table in a file, which is loaded only if it does not consist of plain numbers."""

    def __init__(self, path: str | os.PathLike[str], head: bytes, layout: Layout) -> None:
        super().__init__(Path(path).name, head, layout, ())
        self._path = path

    @cached_property
    def content(self) -> bytes:
        file = open_file(self._path)
        self._sources = (file.source,)
        return content_of(file)

    @property
    def sources(self) -> tuple[Source, ...]:
        return self._sources or (open_file(self._path).source,)

    def first_rows(self, size: int) -> tuple[bytes, bool]:
        with Path(self._path).open("rb") as file:
            file.seek(self.layout.start)
            part = file.read(size)
            return part, not file.read(1)

    def numbers(self, used: list[bool]) -> list[Any] | None:
        if self._is_cut():
            return None
        sources: list[Source] = []
        blocks = hashed_blocks(self._path, self.layout.start, BLOCK, sources)
        if next(blocks) != self._content[: self.layout.start]:
            return None
        columns = _parsed(self.layout, used, blocks)
        if columns is not None:
            self._sources = tuple(sources)
        return columns

    def _is_cut(self) -> bool:
        """Whether the last line of the file is incomplete."""
        with Path(self._path).open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(self.layout.start, size - TAIL))
            return bool(LastLine(file.read(), self.layout._replace(start=0)).cut)


def _parsed(layout: Layout, used: list[bool], blocks: Iterator[bytes]) -> list[Any] | None:
    table = _core.NumberColumns(ord(layout.separator), ord(layout.decimal), used)
    if not all(map(table.add, blocks)):
        return None
    columns = table.finish()
    return columns if columns and len(columns[0]) else None


class NotInPartsError(FormatError):
    """The text can only be read as a whole, for example because column types change in a later part."""

    def __init__(self, file: str) -> None:
        super().__init__(
            f"{file} cannot be read in pieces because its column types change: read it as a whole"
        )


def content_of(file: File) -> bytes:
    """The content of a text file, decompressed and in UTF-8."""
    return plain_text(file.name, unpacked(file.name, file.content))


def open_text(file: File, *, width: int | None = None, used: Sequence[int] = (), skip_rows: int = 0) -> Text:
    """The text of a file, decompressed and in UTF-8, with its layout; arguments as for `layout_of`."""
    content = content_of(file)
    layout = layout_of(file.name, content, width=width, used=used, skip_rows=skip_rows)
    return Text(file.name, content, layout, (file.source,))


def open_path(
    path: str | os.PathLike[str], *, width: int | None = None, used: Sequence[int] = (), skip_rows: int = 0
) -> Text:
    """The text of a file as in `open_text`, but not loaded into memory if it consists of plain numbers."""
    head, name = first_bytes(path, HEAD), Path(path).name
    if not head.startswith(GZIP) and b"\n" in head and plain_text(name, head) is head:
        layout = _layout_of_head(name, head, width, tuple(used), skip_rows)
        if layout.first:
            return _StoredText(path, head, layout)
    return open_text(open_file(path), width=width, used=used, skip_rows=skip_rows)


def head_of(path: str | os.PathLike[str]) -> tuple[bytes, Layout]:
    """The start of a text file in UTF-8, and its layout. Raises FormatError for a binary file."""
    name = Path(path).name
    return layout_of_start(name, unpacked_start(name, first_bytes(path, HEAD), HEAD))


def layout_of_start(name: str, start: bytes) -> tuple[bytes, Layout]:
    """The decompressed start of a text file in UTF-8, and its layout. Raises the error of `head_of`."""
    head = plain_text(name, start)
    return head, _layout_of_head(name, head, None, (), 0)


@lru_cache(maxsize=2)
def _layout_of_head(
    name: str, head: bytes, width: int | None, used: tuple[int, ...], skip_rows: int
) -> Layout:
    # The layout is cached, because it is needed twice: to recognise the format of a file, and to read the
    # file.
    return layout_of(name, head, width=width, used=used, skip_rows=skip_rows)


def headed_parts(path: str | os.PathLike[str], names_of: Any) -> Iterator[Table]:
    """The table of a text with a header, in parts; `names_of` returns the column names for a layout.

    Raises NotInPartsError if the column types, or the cause of an error, can only be determined from the
    whole file.
    """
    import pyarrow as pa
    from pyarrow import csv

    name = Path(path).name
    start = first_bytes(path, HEAD)
    if start[:1] in (b"\x1f", b"\xff", b"\xfe") or b"\0" in start or (b"\r" in start and b"\n" not in start):
        raise NotInPartsError(name)
    layout = layout_of(name, start)
    # A text whose fields are separated by spaces can only be read as a whole. For a text shorter
    # than HEAD, reading in parts would save no memory.
    if layout.separator == " " or layout.decimal != "." or layout.names is None or len(start) < HEAD:
        raise NotInPartsError(name)
    names = names_of(layout)
    options = _read_options(len(names), block_size=PART, use_threads=False)
    used = [index for index, column in enumerate(names) if column not in SKIP]
    try:
        with Path(path).open("rb") as file:
            file.seek(layout.start)
            for batch in csv.open_csv(
                file,
                options,
                csv.ParseOptions(delimiter=layout.separator),
                csv.ConvertOptions(include_columns=[str(index) for index in used]),
            ):
                columns = [batch.column(str(index)) for index in used]
                table = Table(name, [names[index] for index in used], columns, lambda row: f"row {row + 1}")
                if _is_doubtful(table):
                    raise NotInPartsError(name)
                yield table
    except (pa.ArrowException, OSError):
        raise NotInPartsError(name) from None


def read_rows(text: Text, names: Sequence[str]) -> Table:
    """The table of a text with these names, one per column. Columns named `-` are omitted.

    Columns with canonical names must contain numbers; a time column may also contain dates.
    """
    layout = text.layout
    used = [index for index, name in enumerate(names) if name not in SKIP]
    kept = [names[index] for index in used]

    def place(row: int) -> str:
        return f"line {_line_of_row(text.content, layout.start, row) + layout.line - 1}"

    if layout.first:
        numbers = text.numbers([name not in SKIP for name in names])
        if numbers is not None:
            return Table(text.name, kept, numbers, place)
    import pyarrow as pa
    from pyarrow import csv

    from imucal.io.rows import cleaned_columns, without_blank_rows

    if not layout.first:
        if below := text.content[layout.start :].strip():
            shown = below.partition(b"\n")[0].decode(errors="replace").strip()
            raise FormatError(
                f"{text.name}: no line below the header is a row of numbers; the first line is "
                f"{shown[:60]!r}: check that it is the right file, or leave out columns of text"
            )
        empty = pa.chunked_array([pa.array([], pa.float64())])
        return Table(text.name, kept, [empty] * len(kept), place)

    last = LastLine(text.content, layout)
    buffer = pa.py_buffer(text.content).slice(layout.start, last.end - layout.start)
    if layout.separator == " ":
        buffer = pa.py_buffer(_with_single_spaces(buffer.to_pybytes()))
    options = _read_options(len(names), use_threads=buffer.size > WORTH_THREADS)
    parse = csv.ParseOptions(delimiter=layout.separator)
    convert = csv.ConvertOptions(include_columns=[str(index) for index in used], decimal_point=layout.decimal)
    try:
        # In this first attempt Arrow infers the column types from the first block of the text. The attempt
        # fails if later blocks have other types.
        columns = csv.read_csv(pa.BufferReader(buffer), options, parse, convert).columns
    except pa.ArrowException:
        columns = None
    table = None if columns is None else Table(text.name, kept, columns, place, last.findings(text.name))
    if table is None or any(
        not _is_read(name, column) for name, column in zip(kept, table.columns, strict=True)
    ):
        return cleaned_columns(text.name, buffer, layout, list(names), place, last)
    return without_blank_rows(table)


def _is_read(name: str, column: Any) -> bool:
    """Whether Arrow converted a column to a suitable type; True for a column without a canonical name."""
    import pyarrow as pa

    kind = column.type
    if (
        not is_canonical(name)
        or pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_null(kind)
    ):
        return True
    return time_unit(name) is not None and pa.types.is_timestamp(kind)


def _is_doubtful(table: Table) -> bool:
    """Whether a part of a text may contain rows that must be skipped.

    Such a text is read again as a whole, because only the reader of whole texts can skip rows.
    """
    if any(not _is_read(name, column) for name, column in zip(table.names, table.columns, strict=True)):
        return True
    return bool(table.columns) and all(column.null_count for column in table.columns)


def _read_options(width: int, **more: Any) -> Any:
    from pyarrow import csv

    return csv.ReadOptions(column_names=[str(index) for index in range(width)], **more)


def _with_single_spaces(text: bytes) -> bytes:
    """The text with fields separated by one space, without spaces at the ends of lines."""
    # Spaces are replaced pair by pair, because a regular expression would take 20 times as long.
    text = text.replace(b"\r", b"").replace(b"\t", b" ")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b" \n", b"\n").replace(b"\n ", b"\n").strip(b" ")


def _line_of_row(content: bytes, start: int, row: int) -> int:
    """The line number, from 1 at `start`, of the nonblank line with index `row`."""
    filled = (number for number, line in enumerate(content[start:].split(b"\n"), start=1) if line.strip())
    return next((number for index, number in enumerate(filled) if index == row), row + 1)
