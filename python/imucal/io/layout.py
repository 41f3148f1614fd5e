"""The layout of a text table, determined from the start of the file.

The header may be in any of the first lines, after comments (`#`, `%`, `//`), a `sep=` line and free text. A
second line with the unit of each column may follow the header. Rows of data are recognised by their numbers.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from imucal.errors import FormatError
from imucal.io.names import is_canonical
from imucal.io.unit_words import unit_of

__all__ = ["HEAD", "Layout", "is_number", "is_value", "layout_of", "plain_text", "split_line"]

# Most patterns in this module are strings. The module `re` compiles a pattern at its first use, so that only
# the few patterns that a file needs are compiled.

# Size of the start of a file in which header and first row are searched, bytes.
HEAD: Final = 1 << 16
# The header is searched in this number of lines before the first row.
HEADER_LINES: Final = 50
# Number of lines from which the separator and the number of columns are determined. They are the last lines
# of the first `HEAD` bytes.
SAMPLE_LINES: Final = 60
# Minimum number of numeric fields in a line for a separator to be accepted. A line with more numeric fields,
# such as a time and three axes, is a row, even if most of its fields are text.
LEAST_NUMBERS: Final = 3
NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
DECIMAL_COMMA: Final = r"[-+]?\d*,\d+([eE][-+]?\d+)?"
# A whole number with a thousands separator, which can also be a number with a decimal comma.
THOUSANDS: Final = r"[-+]?[1-9]\d{0,2},\d{3}"
# Matches the start of a date or a time of day, which `imucal.io.dates` parses.
DATE: Final = (
    r"(?a)(\d{1,4}[-/.]\w{1,9}[-/.]\d{1,4}|\d{4}_\d{1,2}_\d{1,2}_|\d{8}[T_ ]\d{4,}|\d{1,2}:\d{2}|"
    r"\w{3,9}\.? \d{1,2}, \d{4}|\d+ days? )"
)
COMMENT: Final = r"^\s*(#|%|//)+\s*"
# The time stamp that the Arduino serial monitor writes before each line.
ARRIVAL: Final = rb"\d\d:\d\d:\d\d\.\d{3} -> "
SEPARATORS: Final = ("\t", ";", ",", " ")
# Byte order marks and their encodings.
BOMS: Final = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


class Layout(NamedTuple):
    """The positions of the parts of a text table, and its column names.

    names      column names; None if there is no header
    units      text of a line with the unit of each column, or None
    preamble   lines before the header
    separator  text between two fields; " " stands for any number of spaces
    decimal    decimal point, "." or ","
    start      offset of the first row, bytes
    line       number of the line at `start`, from 1
    width      number of fields of a row
    first      fields of the first row; empty if there are no rows
    """

    names: list[str] | None
    units: list[str] | None
    preamble: list[str]
    separator: str
    decimal: str
    start: int
    line: int
    width: int
    first: list[str]

    @property
    def described(self) -> list[str]:
        """The column names, each with its unit if there is a line of units below the header."""
        names = self.names or []
        if self.units is None:
            return list(names)
        return [
            f"{name} [{unit.strip('()[]{}') if unit[0] in '([{' else unit}]" if unit else name
            for name, unit in zip(names, self.units, strict=True)
        ]


class _Line(NamedTuple):
    number: int
    text: str


def plain_text(name: str, content: bytes) -> bytes:
    """The text as UTF-8 with line feeds, copied only if necessary. Raises FormatError for binary data."""
    for mark, encoding in BOMS:
        if content.startswith(mark):
            try:
                return content[: len(content) // 2 * 2].decode(encoding).encode()
            except UnicodeDecodeError:
                raise FormatError(f"{name} is no valid UTF-16 text: export it again as UTF-8") from None
    start = content[:4096]
    if b"\0" in start:
        # Recognises UTF-16 without a byte order mark, in which every second byte of Latin text is zero.
        for zeros, encoding in ((start[1::2], "utf-16-le"), (start[0::2], "utf-16-be")):
            if zeros and zeros.count(0) == len(zeros) and len(zeros) > 20:
                return content[: len(content) // 2 * 2].decode(encoding, "replace").encode()
        raise FormatError(f"{name} is a binary file, not text: give the recording as CSV or Parquet")
    if re.match(ARRIVAL, content):
        content = _with_arrival_column(content)
    if b"\r" in content[:HEAD] and b"\n" not in content[: 16 * HEAD] and b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    return content


def _with_arrival_column(content: bytes) -> bytes:
    """The same text, in which the time stamps of the Arduino serial monitor are a column.

    The monitor puts a time stamp and an arrow before each line: `12:00:00.123 -> `. The arrow is replaced by
    the separator of the other columns.
    """
    head = content[:HEAD]
    separator = next((mark for mark in (b"\t", b";", b",") if mark in head), b" ")
    return content.replace(b" -> ", separator)


def layout_of(
    name: str, text: bytes, *, width: int | None = None, used: Sequence[int] = (), skip_rows: int = 0
) -> Layout:
    """The layout of a text; only the start of the text is needed.

    width      number of columns, if it is known
    used       the columns that must contain numbers or dates, if they are known
    skip_rows  number of lines at the start that contain neither the header nor a row

    Raises FormatError if the text contains only blank lines.
    """
    lines = list(_lines(text))
    if not lines:
        raise FormatError(f"{name} contains only blank lines: a header line and rows are needed")
    sought = [line for line in lines if line.number > skip_rows]
    separator = _separator(sought, lines[:3], width)
    decimal = _decimal(name, sought, separator)
    at = _first_row(sought, separator, decimal, width, used)
    if at is None:
        return _without_rows(lines, text)
    row = sought[at]
    first = split_line(row.text, separator)
    head = _header([line for line in lines if skip_rows < line.number < row.number], separator, first)
    names, units, preamble = head
    return Layout(
        names,
        units,
        preamble,
        separator,
        decimal,
        _offset(text, row.number),
        row.number,
        len(names or first),
        first,
    )


def _without_rows(lines: list[_Line], text: bytes) -> Layout:
    """The layout of a text without rows. Its header is the first line with canonical names, else line 1."""
    header = next((line for line in lines if any(map(is_canonical, _fields(line.text)))), lines[0])
    names = _fields(header.text)
    separator = next((mark for mark in SEPARATORS if mark in header.text), ",")
    after = next((line for line in lines if line.number > header.number), None)
    start, number = (
        (len(text), header.number + 1) if after is None else (_offset(text, after.number), after.number)
    )
    return Layout(names, None, [], separator, ".", start, number, len(names), [])


def _lines(text: bytes) -> Iterator[_Line]:
    """The nonblank lines of the first `HEAD` bytes, without a last line that is cut off there."""
    head = text[:HEAD].removeprefix(b"\xef\xbb\xbf")
    if len(text) >= HEAD and b"\n" in head:
        head = head[: head.rfind(b"\n")]
    try:
        decoded = head.decode()
    except UnicodeDecodeError:
        decoded = head.decode("cp1252", "replace")
    for number, line in enumerate(decoded.split("\n"), start=1):
        if line and not line.isspace():
            yield _Line(number, line)


def _offset(text: bytes, number: int) -> int:
    """The offset of the line with this number, bytes."""
    at = 3 if number == 1 and text.startswith(b"\xef\xbb\xbf") else 0
    for _ in range(number - 1):
        at = text.index(b"\n", at) + 1
    return at


def split_line(text: str, separator: str) -> list[str]:
    """The fields of a line, without quotes and spaces around them."""
    text = text.strip(" \r\n") if separator == "\t" else text.strip()
    if separator == " ":
        return [field.strip('"') for field in text.split()]
    if '"' in text:
        import csv

        try:
            quoted = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        except (csv.Error, StopIteration):
            quoted = text.replace('"', "").split(separator)
        return [field.strip() for field in quoted]
    return [field.strip() for field in text.split(separator)]


def _fields(text: str) -> list[str]:
    text = re.sub(COMMENT, "", text)
    separator = next((mark for mark in SEPARATORS if mark in text), ",")
    return split_line(text, separator)


def is_number(field: str) -> bool:
    """Whether a field is a number with a decimal point."""
    return NUMBER.fullmatch(field) is not None


def is_value(field: str, decimal: str = ".") -> bool:
    """Whether a field is a number or begins like a date."""
    if decimal == "," and re.fullmatch(DECIMAL_COMMA, field):
        return True
    return NUMBER.fullmatch(field) is not None or re.match(DATE, field) is not None


def _separator(lines: list[_Line], first: list[_Line], width: int | None) -> str:
    """The first of `SEPARATORS` that gives three or more numbers per line, on average over the last lines.

    If none does, the separator that gives the most numbers. Spaces are tried last, because they also occur
    within dates.
    """
    sample = lines[-SAMPLE_LINES:]
    best, most = ",", 0
    for mark in SEPARATORS:
        count = 0
        for line in sample:
            if mark != " " and mark not in line.text:
                continue
            fields = split_line(line.text, mark)
            if width is not None and len(fields) not in (width, width + 1):
                continue
            decimal = "." if mark == "," and '"' not in line.text else ","
            count += sum(is_value(field, decimal) for field in fields)
        if count >= LEAST_NUMBERS * len(sample):
            return mark
        if count > most:
            best, most = mark, count
    if not most:
        text = " ".join(line.text for line in first)
        return next((mark for mark in SEPARATORS if mark in text), ",")
    return best


def _decimal(name: str, lines: list[_Line], separator: str) -> str:
    """The decimal mark of the numbers, "." or ",". Raises FormatError if commas are thousands separators."""
    sample = lines[-SAMPLE_LINES:]
    if not any('"' in line.text if separator == "," else "," in line.text for line in sample):
        return "."
    fields = {field for line in sample for field in split_line(line.text, separator)}
    commas = [field for field in fields if re.fullmatch(DECIMAL_COMMA, field)]
    has_points = any("." in field and is_number(field) for field in fields)
    if commas and has_points and all(re.fullmatch(THOUSANDS, field) for field in commas):
        raise FormatError(
            f"{name}: some numbers have a decimal point, and others have a comma between thousands "
            f"({min(commas)!r}): export the numbers without thousands separators"
        )
    return "," if commas else "."


def _first_row(
    lines: list[_Line], separator: str, decimal: str, width: int | None, used: Sequence[int]
) -> int | None:
    """The index of the first row: the first line with numbers and the usual number of fields."""

    def is_row(fields: list[str]) -> bool:
        if used and len(fields) == width:
            return all(is_value(fields[column], decimal) or not fields[column] for column in used) and any(
                fields[column] for column in used
            )
        filled = [field for field in fields if field]
        numbers = sum(is_value(field, decimal) for field in filled)
        return numbers > LEAST_NUMBERS or (numbers > 0 and 2 * numbers >= len(filled))

    # The usual number of fields is determined from the last lines, because a header is at the start. Earlier
    # lines are split only until the first row of numbers is found.
    last = [split_line(line.text, separator) for line in lines[-SAMPLE_LINES:]]
    widths = Counter(len(fields) for fields in last if is_row(fields))
    if not widths:
        widths = Counter(
            len(fields) for fields in (split_line(line.text, separator) for line in lines) if is_row(fields)
        )
    if not widths:
        return None
    usual = width if width in widths else widths.most_common(1)[0][0]
    for index, line in enumerate(lines):
        fields = split_line(line.text, separator)
        if len(fields) == usual and is_row(fields):
            return index
    return None


def _header(
    above: list[_Line], separator: str, first: list[str]
) -> tuple[list[str] | None, list[str] | None, list[str]]:
    """Column names, units, and the lines before the names, found in the lines above the first row."""
    above = [line for line in above[-HEADER_LINES:] if not _are_states(line.text, separator)]
    for index in range(len(above) - 1, -1, -1):
        names = _names(above[index].text, separator, first)
        if names is None:
            continue
        units = None
        if index and _are_units(names):
            upper = _names(above[index - 1].text, separator, first)
            if upper is not None:
                names, units, index = upper, names, index - 1
        return names, units, [line.text for line in above[:index]]
    return None, None, [line.text for line in above]


def _names(text: str, separator: str, first: list[str]) -> list[str] | None:
    """The fields of a line if it can be the header of a row with the fields `first`."""
    text = re.sub(COMMENT, "", text)
    for mark in (separator, *(mark for mark in SEPARATORS if mark != separator)):
        if mark not in text:
            continue
        fields = split_line(text, mark)
        canonical = any(map(is_canonical, fields))
        width = len(first)
        while len(fields) > width and not fields[-1]:
            fields.pop()
        if len(fields) == width - 1 and not first[-1]:
            # Each row ends with a separator, and the header does not. The empty last field of the rows has no
            # name.
            fields.append("")
        named = sum(bool(field) and not is_value(field) for field in fields)
        if (len(fields) == width and 2 * named > width) or (canonical and mark != " "):
            return fields
    return None


def _are_states(text: str, separator: str) -> bool:
    """Whether each field of a line is only "calibrated" or "raw", as in a line of Shimmer's exports."""
    return {field.upper() for field in split_line(text, separator) if field} <= {"CAL", "RAW", "UNCAL"}


def _are_units(fields: list[str]) -> bool:
    return sum(unit_of(field) is not None for field in fields) >= 2 and not any(map(is_canonical, fields))
