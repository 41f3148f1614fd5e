"""Tables of numbers as text, separated by comma, semicolon, tab or spaces, with or without a header."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from imucal.document.source import File, first_bytes
from imucal.errors import FormatError
from imucal.io.table import Table

__all__ = ["NotInPartsError", "first_fields", "headed_parts", "is_number", "read_headed", "read_headerless"]

# Block size that makes Arrow infer column types from the whole file, bytes; Arrow's maximum.
LARGEST_BLOCK = 2**31 - 1
# For a file that is read in parts: size of the start that is searched for the header and the first row, and
# size of one part, bytes.
HEAD, PART = 1 << 16, 1 << 22
# Size of a text above which multithreaded parsing is worth the time to start the threads, bytes.
WORTH_THREADS = 1 << 24
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def first_fields(name: str, start: bytes) -> list[str]:
    """The fields of the first line that is not blank; `start` is the beginning of the file."""
    lines = _lines(_text_of(name, start))
    _refuse_decimal_commas(name, lines[:1])
    return _split(lines[0][1]) if lines else []


def read_headed(file: File) -> Table:
    """A table whose first line contains the column names."""
    content = _text_of(file.name, file.content)
    lines = _lines(content, limit=1)
    if not lines:
        raise FormatError(f"{file.name} contains only blank lines: a header line and rows are needed")
    number, header = lines[0]
    if "," not in header:
        _refuse_decimal_commas(file.name, _lines(content)[1:2])
    return _read(file, content, skip=number, names=_split(header))


class NotInPartsError(FormatError):
    """The rows of a text do not match the column types inferred from its first part."""

    def __init__(self, file: str) -> None:
        super().__init__(
            f"{file} cannot be read in pieces because its column types change: read it as a whole"
        )


def headed_parts(path: str | os.PathLike[str]) -> Iterator[Table]:
    """The table that `read_headed` returns, in parts.

    Raises NotInPartsError if the column types, or the cause of an error, can only be determined from the
    whole file.
    """
    import pyarrow as pa
    from pyarrow import csv

    name = Path(path).name
    start = first_bytes(path, HEAD)
    if _has_old_ends(start):
        raise NotInPartsError(name)
    head = _text_of(name, start)
    lines = _lines(head)
    delimiter = _delimiter(lines[1][1].encode()) if len(lines) > 1 else b" "
    # Repeated spaces are only merged in a whole text, and a text shorter than HEAD needs no parts.
    if delimiter == b" " or len(head) < HEAD:
        raise NotInPartsError(name)
    number, header = lines[0]
    names = _split(header)
    options = csv.ReadOptions(
        column_names=[str(index) for index in range(len(names))], block_size=PART, use_threads=False
    )
    try:
        with Path(path).open("rb") as file:
            for _ in range(number):
                file.readline()
            for batch in csv.open_csv(file, options, csv.ParseOptions(delimiter=delimiter.decode())):
                yield Table(name, names, batch.columns, lambda row: f"row {row + 1}")
    except (pa.ArrowException, OSError):
        raise NotInPartsError(name) from None


def read_headerless(file: File, names: list[str], skip_rows: int) -> Table:
    """A table whose columns have no names in the file; text lines at the start are skipped.

    names      one per column
    skip_rows  number of lines to skip at the start, before the first row of numbers is searched
    """
    content = _text_of(file.name, file.content)
    for number, line in _lines(content):
        fields = _split(line)
        if number > skip_rows and all(is_number(field) for field in fields):
            break
    else:
        _refuse_decimal_commas(file.name, _lines(content))
        raise FormatError(
            f"{file.name}: no line consists of numbers only: check that it is the right file, and a text file"
        )
    if len(fields) != len(names):
        raise FormatError(
            f"{file.name}: line {number} has {len(fields)} values but {len(names)} columns are named "
            f"({', '.join(names)}): name every column, '-' for a column to ignore"
        )
    return _read(file, content, skip=number - 1, names=names)


def _read(file: File, content: bytes, skip: int, names: list[str]) -> Table:
    import pyarrow as pa
    from pyarrow import csv

    rest = content.split(b"\n", skip)[skip] if content.count(b"\n") >= skip else b""
    delimiter = _delimiter(rest.lstrip().split(b"\n", 1)[0])
    if delimiter == b" ":
        rest = _with_single_spaces(rest)

    def place(row: int) -> str:
        return f"line {_line_of_row(rest, row) + skip}"

    if not rest.strip():
        return Table(file.name, names, [pa.chunked_array([pa.array([], pa.float64())])] * len(names), place)

    parse_options = csv.ParseOptions(delimiter=delimiter.decode())
    column_names = [str(index) for index in range(len(names))]
    # Without threads for short texts: Arrow's starting threads can abort a process that ends at once.
    options = csv.ReadOptions(column_names=column_names, use_threads=len(rest) > WORTH_THREADS)
    try:
        # Fast path: column types are inferred from the first block. If later rows do not match them, or a row
        # is invalid, the text is parsed again below with types from the whole text.
        table = csv.read_csv(pa.BufferReader(rest), options, parse_options)
        return Table(file.name, names, table.columns, place)
    except pa.ArrowException:
        pass

    bad_rows: list[Any] = []

    def note(row: Any) -> str:
        bad_rows.append(row)
        return "error"

    try:
        table = csv.read_csv(
            pa.BufferReader(rest),
            # With one thread, Arrow reports the number of an invalid row.
            read_options=csv.ReadOptions(
                column_names=column_names,
                block_size=min(max(len(rest), 1), LARGEST_BLOCK),
                use_threads=False,
            ),
            parse_options=csv.ParseOptions(delimiter=delimiter.decode(), invalid_row_handler=note),
        )
    except pa.ArrowException as error:
        if bad_rows:
            row = bad_rows[0]
            where = place(row.number - 1) if row.number is not None else "a line"
            raise FormatError(
                f"{file.name}: {where} has {row.actual_columns} values, {row.expected_columns} are needed: "
                "complete or remove it"
            ) from None
        reason = str(error).splitlines()[0]
        raise FormatError(f"{file.name} cannot be read as a table of numbers: {reason}") from None
    return Table(file.name, names, table.columns, place)


def _with_single_spaces(text: bytes) -> bytes:
    """The text with fields separated by one space, without spaces at the ends of lines."""
    # A regular expression takes 20 times as long.
    text = text.replace(b"\r", b"").replace(b"\t", b" ")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b" \n", b"\n").replace(b"\n ", b"\n").strip(b" ")


def _text_of(name: str, content: bytes) -> bytes:
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\0" in content[:4096]:
        raise FormatError(f"{name} is a binary file, not text: give the recording as CSV or Parquet")
    # Old spreadsheet programs end lines with a carriage return only.
    return content.replace(b"\r", b"\n") if _has_old_ends(content) else content


def _has_old_ends(content: bytes) -> bool:
    return b"\r" in content[:HEAD] and b"\n" not in content


def _lines(content: bytes, limit: int = 1000) -> list[tuple[int, str]]:
    """Number (from 1) and text of each line that is not blank, among the first `limit` lines."""
    head = content.split(b"\n", limit)[:limit] if limit > 1 else content.lstrip().split(b"\n", 1)[:1]
    blank = content[: len(content) - len(content.lstrip())].count(b"\n") if limit == 1 else 0
    return [
        (number, line.decode(errors="replace").strip())
        for number, line in enumerate(head, start=1 + blank)
        if line.strip()
    ]


def _refuse_decimal_commas(name: str, lines: list[tuple[int, str]]) -> None:
    """Raises FormatError for decimal commas, which would otherwise be reported as too many values."""
    for number, line in lines:
        fields = [field.strip(' "') for field in re.split(r"[;\t]", line)]
        wrong = next((field for field in fields if DECIMAL_COMMA.fullmatch(field)), None)
        if wrong is not None and len(fields) > 1:
            raise FormatError(
                f"{name}: line {number} has decimal commas, {wrong}: write numbers with a decimal point, "
                f"{wrong.replace(',', '.')}, by exporting the file again or replacing each comma"
            )


def _line_of_row(content: bytes, row: int) -> int:
    """The line number (from 1) of the row-th line (from 0) that is not blank."""
    filled = (number for number, line in enumerate(content.split(b"\n"), start=1) if line.strip())
    return next((number for index, number in enumerate(filled) if index == row), row + 1)


def _delimiter(line: bytes) -> bytes:
    for candidate in (b",", b";"):
        if candidate in line:
            return candidate
    return b" "


def _split(line: str) -> list[str]:
    delimiter = _delimiter(line.encode()).decode()
    fields = line.split() if delimiter == " " else line.split(delimiter)
    return [field.strip().strip('"') for field in fields]


def is_number(field: str) -> bool:
    """Whether `float` accepts the field."""
    try:
        float(field)
    except ValueError:
        return False
    return True
