"""Handling of text tables that Arrow refuses because of text lines, incomplete lines, or rows without values.

Such lines are skipped with a warning that reports their number. If there are too many, the text is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from imucal.errors import FormatError
from imucal.io.arrow_values import arrow_of, truth_of
from imucal.io.dates import FORMS, is_date_column, nanoseconds
from imucal.io.last_line import LastLine
from imucal.io.layout import DATE, Layout, is_number, split_line
from imucal.io.names import SKIP, is_canonical, time_unit
from imucal.io.remarks import lines_left_out
from imucal.io.table import Table

__all__ = ["cleaned_columns", "without_blank_rows"]

# Rows with a wrong number of fields or with a field that is not a number, for example after an error on a
# serial line, are skipped. The file is refused if the number of rows with either error, divided by the number
# of valid rows, exceeds this ratio.
MOST_GARBLED: Final = 0.01
# Lines of text between the rows are skipped. The file is refused if their number, divided by the number of
# valid rows, exceeds this ratio.
MOST_TEXT: Final = 1.0
# Arrow's maximum block size, bytes. With this size Arrow infers the column types from the whole file.
LARGEST_BLOCK: Final = 2**31 - 1
# Regular expression of a number, for RE2; {point} is the decimal point.
NUMBER: Final = r"^\s*[-+]?(\d+{point}?\d*|{point}\d+)([eE][-+]?\d+)?\s*$|^\s*[-+]?(?i:nan|inf|infinity)\s*$"
COMMENTS: Final = ("#", "%", "//")


def without_blank_rows(table: Table) -> Table:
    """The table without rows that have no values, such as `,,,,,,`, with a warning if there are any."""
    import numpy as np
    import pyarrow as pa

    if not table.columns or not all(column.null_count for column in table.columns):
        return table
    rows = pa.table(list(table.columns), names=[str(i) for i in range(len(table.columns))])
    kept = _filled(rows)
    count = rows.num_rows - np.count_nonzero(truth_of(kept))
    if not count:
        return table
    warning = lines_left_out(table.file, [f"{count} rows without values"], int(count))
    return replace(table, columns=rows.filter(kept).columns, findings=(*table.findings, warning))


def _filled(rows: Any) -> Any:
    """The mask of the rows that have any value."""
    from pyarrow import compute

    filled = rows.column(0).is_valid()
    for column in rows.columns[1:]:
        filled = compute.or_(filled, column.is_valid())
    return filled


@dataclass
class _LeftOut:
    """The skipped lines with a wrong number of fields.

    lines   for each skipped line: its index among all lines, its content, and whether it is a line of text
    width   number of fields of a valid row
    """

    lines: list[tuple[int, str, bool]]
    width: int

    def note(self, row: Any) -> str:
        fields = [field.strip() for field in (row.text or "").replace(";", ",").replace("\t", ",").split(",")]
        text = (row.text or "").strip()
        numbers = sum(is_number(field) or re.match(DATE, field) is not None for field in fields)
        is_text = text.startswith(COMMENTS) or 2 * numbers < len(fields)
        self.lines.append((row.number - 1, text, is_text))
        return "skip"


def cleaned_columns(
    file: str, buffer: Any, layout: Layout, names: list[str], place: Callable[[int], str], last: LastLine
) -> Table:
    """The table of a text in which lines that are not rows are skipped with a warning.

    Raises FormatError with the position of the first such line if there are too many.

    buffer  the text from its first row on, without an incomplete last line
    place   function that returns the position in the file of the line with a given index, for messages
    last    the last line of the text, for the warning if it is incomplete
    """
    import numpy as np
    import pyarrow as pa
    from pyarrow import csv

    used = [index for index, name in enumerate(names) if name not in SKIP]
    buffer = _valid_text(buffer)
    left = _LeftOut([], len(names))
    try:
        rows = csv.read_csv(
            pa.BufferReader(buffer),
            # Arrow uses one thread, because otherwise it does not report the number of an invalid row.
            csv.ReadOptions(
                column_names=[str(index) for index in range(len(names))],
                block_size=min(max(buffer.size, 1), LARGEST_BLOCK),
                use_threads=False,
            ),
            csv.ParseOptions(delimiter=layout.separator, invalid_row_handler=left.note),
            csv.ConvertOptions(
                include_columns=[str(index) for index in used],
                column_types={str(index): pa.string() for index in used if is_canonical(names[index])},
                strings_can_be_null=True,
                check_utf8=False,
                decimal_point=layout.decimal,
            ),
        )
    except pa.ArrowException as error:
        reason = str(error).splitlines()[0]
        raise FormatError(f"{file} cannot be read as a table of numbers: {reason}") from None
    numbers = [row for row, _, _ in left.lines]

    def place_of(row: int) -> str:
        """The position in the file of a row of the table. The table lacks the lines that were skipped."""
        at = row
        for skipped in numbers:
            at += skipped <= at
        return place(at)

    columns, bad = [], {}
    for index, column in zip(used, rows.columns, strict=True):
        name = names[index]
        if is_canonical(name):
            column, bad[name] = _numbers(name, column, layout.decimal)
        columns.append(column)
    filled = [truth_of(column.is_valid()) for column in rows.columns]
    in_rows = np.array(list(bad.values())) if bad else np.zeros((0, rows.num_rows), bool)
    count_bad = in_rows.sum(axis=0) if len(in_rows) else np.zeros(rows.num_rows, int)
    given = np.array([filled[i] for i, index in enumerate(used) if is_canonical(names[index])])
    is_text = (count_bad > 0) & (2 * count_bad > given.sum(axis=0))
    is_garbled = (count_bad > 0) & ~is_text
    is_blank = ~np.any(filled, axis=0)
    kept = ~(is_text | is_garbled | is_blank)
    _refuse_too_many(file, names, rows, used, bad, kept, is_text, is_garbled, left, place_of, place, layout)
    parts = []
    text_lines = [text for _, text, of_text in left.lines if of_text]
    short = [(row, text) for row, text, of_text in left.lines if not of_text]
    if text_lines or is_text.any():
        first = text_lines[0] if text_lines else _row_text(rows, int(is_text.argmax()))
        parts.append(f"{len(text_lines) + int(is_text.sum())} lines of text (the first: {first[:40]!r})")
    if short:
        row, first = short[0]
        parts.append(
            f"{len(short)} lines with too few or too many values (the first: {place(row)}, {first[:40]!r})"
        )
    if is_garbled.any():
        at = int(is_garbled.argmax())
        parts.append(f"{int(is_garbled.sum())} lines with text among the numbers (the first: {place_of(at)})")
    if is_blank.any():
        parts.append(f"{int(is_blank.sum())} rows without values")
    if last.cut:
        parts.append(f"an incomplete last line ({last.cut[:40]!r})")
    out = len(left.lines) + int((~kept).sum()) + bool(last.cut)
    findings = (lines_left_out(file, parts, out),) if parts else ()
    table = pa.table(columns, names=[str(index) for index in used]).filter(_mask(kept))
    return Table(file, [names[index] for index in used], table.columns, place_of, findings)


def _valid_text(buffer: Any) -> Any:
    """Replace invalid UTF-8 by U+FFFD, because Arrow does not report invalid UTF-8 as an invalid row."""
    import pyarrow as pa

    content = buffer.to_pybytes()
    try:
        content.decode()
    except UnicodeDecodeError:
        return pa.py_buffer(content.decode(errors="replace").encode())
    return buffer


def _numbers(name: str, column: Any, decimal: str) -> tuple[Any, Any]:
    """A text column as numbers, or as time stamps if it contains dates, and the mask of invalid cells."""
    import numpy as np
    import pyarrow as pa
    from pyarrow import compute

    pattern = NUMBER.replace("{point}", "[.,]" if decimal == "," else r"\.")
    good = compute.fill_null(compute.match_substring_regex(column, pattern), True)
    bad = ~truth_of(good)
    if time_unit(name) is not None and 2 * bad.sum() > len(bad):
        is_date = is_date_column(column)
        if is_date is not None:
            dates = compute.if_else(is_date, column, pa.scalar(None, column.type))
            ns = nanoseconds(dates)
            if ns is not None:
                stamps = compute.if_else(
                    dates.combine_chunks().is_valid(), arrow_of(ns), pa.scalar(None, pa.int64())
                ).view(pa.timestamp("ns"))
                return pa.chunked_array([stamps]), ~truth_of(compute.fill_null(is_date, True))
    text = compute.if_else(good, column, pa.scalar(None, column.type))
    text = compute.utf8_trim_whitespace(text)
    text = compute.replace_substring_regex(text, r"^\+", "")
    if decimal == ",":
        text = compute.replace_substring(text, ",", ".")
    is_whole = not compute.any(compute.match_substring_regex(text, r"[.eEnN]")).as_py()
    try:
        return compute.cast(text, pa.int64() if is_whole else pa.float64()), bad
    except pa.ArrowException:
        values = [float(cell) if cell else np.nan for cell in text.to_pylist()]
        return pa.chunked_array([pa.array(values, pa.float64())]), bad


def _refuse_too_many(
    file: str,
    names: list[str],
    rows: Any,
    used: list[int],
    bad: dict[str, Any],
    kept: Any,
    is_text: Any,
    is_garbled: Any,
    left: _LeftOut,
    place_of: Callable[[int], str],
    place: Callable[[int], str],
    layout: Layout,
) -> None:
    """Raises FormatError for too many lines of text (`MOST_TEXT`) or damaged rows (`MOST_GARBLED`)."""
    good = int(kept.sum())
    short = [line for line in left.lines if not line[2]]
    text_lines = int(is_text.sum()) + len(left.lines) - len(short)
    if len(short) > MOST_GARBLED * good:
        row, text, _ = short[0]
        actual = len(split_line(text, layout.separator))
        hint = ""
        if layout.separator == "," and actual >= 2 * left.width - 1:
            hint = " (if commas are decimal points here, export it with another separator)"
        raise FormatError(
            f"{file}: {place(row)} has {actual} values, {left.width} are needed{hint}: complete or remove it"
        )
    too_much_text = text_lines > MOST_TEXT * good
    if too_much_text or int(is_garbled.sum()) > MOST_GARBLED * good:
        which = is_text | is_garbled if too_much_text else is_garbled
        if not which.any():
            row, text, _ = next(line for line in left.lines if line[2])
            raise FormatError(
                f"{file}: {text_lines} lines of text among {good} rows of numbers, the first is {place(row)} "
                f"{text[:40]!r}: check that it is the right file, or remove them"
            )
        row = int(which.argmax())
        name = next(name for name, cells in bad.items() if cells[row])
        cell = rows.column(str(next(i for i in used if names[i] == name)))[row].as_py()
        forms = f" (dates are read in forms such as {FORMS})" if time_unit(name) is not None else ""
        raise FormatError(
            f"{file}: {place_of(row)}, column {name}: {str(cell)[:40]!r} is not a number{forms}: "
            "correct it or leave the cell empty"
        )


def _mask(kept: Any) -> Any:
    import numpy as np
    import pyarrow as pa

    bits = np.packbits(kept, bitorder="little")
    return pa.Array.from_buffers(pa.bool_(), len(kept), [None, pa.py_buffer(bits)])


def _row_text(rows: Any, row: int) -> str:
    return " ".join(str(cell) for column in rows.columns if (cell := column[row].as_py()) is not None)
