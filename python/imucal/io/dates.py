"""Converts dates and times of day, in the forms that loggers write, to nanoseconds.

    2026-01-31 12:00:00.123   2026/01/31T12:00:00,123Z   20260131T120000.123   31.01.2026 12:00:00:123
    31-Jan-2026 12:00:00.123  Jan 31, 2026 12:00:00 PM   12:00:00.123  12:00:00:123  00:12.3 (minutes)
    0 days 00:00:12.3         2026_01_31_12_00_00.123

Times of day continue after midnight on the next day. In dates such as 01/02/2026, the order of day and month
is determined from the whole column.
"""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from imucal.io.arrow_values import numpy_of, truth_of

__all__ = ["FORMS", "is_date_column", "nanoseconds"]

FORMS: Final = "2026-01-31 12:00:00.123, 31-Jan-2026 12:00:00.123, 31.01.2026 12:00:00:123 or 12:00:00.123"
_CLOCK: Final = (
    r"(?P<hour>\d{1,2})[:\-_](?P<minute>\d{2})[:\-_](?P<second>\d{2})(?:[.,:_](?P<fraction>\d{1,9})\d*)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>[Zz]|UTC|GMT|[+\-]\d{2}:?\d{2})?$"
)
_MONTHS: Final = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_GAP: Final = r"(?:\s*[T_, /]\s*|-)"
PATTERNS: Final = (
    r"^(?P<year>\d{4})[-/._](?P<month>\d{1,2})[-/._](?P<day>\d{1,2})" + _GAP + _CLOCK,
    r"^(?P<day>\d{1,2})[-/. ](?P<name>[A-Za-z]{3})[a-z]*\.?[-/. ](?P<year>\d{4})" + _GAP + _CLOCK,
    r"^(?P<name>[A-Za-z]{3})[a-z]*\.?[-/ ](?P<day>\d{1,2})[,\-/ ]\s*(?P<year>\d{4})" + _GAP + _CLOCK,
    r"^(?P<first>\d{1,2})[-/.](?P<other>\d{1,2})[-/.](?P<year>\d{4})" + _GAP + _CLOCK,
    r"^(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})[T_ \-](?P<hour>\d{2})(?P<minute>\d{2})(?P<second>\d{2})"
    r"[.,_]?(?P<fraction>\d{1,9})?(?P<zone>[Zz])?$",
    r"^(?P<days>\d{1,5}) days?,?\s+" + _CLOCK,
    r"^" + _CLOCK,
    r"^(?P<minute>\d{1,2}):(?P<second>\d{2})[.,](?P<fraction>\d{1,9})$",
)
DAY_NS: Final = 86_400_000_000_000


def is_date_column(column: Any) -> Any | None:
    """Mask of the cells that match the date pattern of the column; None if no pattern is recognised."""
    from pyarrow import compute

    pattern = _pattern(column)
    if pattern is None:
        return None
    return compute.match_substring_regex(compute.utf8_trim_whitespace(column), _unnamed(pattern))


def _unnamed(pattern: str) -> str:
    return re.sub(r"\?P<\w+>", "", pattern)


def _pattern(column: Any) -> str | None:
    """The date or time pattern that the first recognised cell matches; only the first 50 cells are tried."""
    for cell in column.slice(0, 50).to_pylist():
        for pattern in PATTERNS:
            if cell is not None and re.match(pattern, str(cell).strip()):
                return pattern
    return None


def nanoseconds(column: Any) -> NDArray[np.int64] | None:
    """The times of a text column with dates, in ns; NaT (the least integer) for empty cells.

    Dates count from 1970, and times of day from midnight of the first day. The result is None if the form of
    the dates is not known or cells have different forms.
    """
    import pyarrow as pa
    from pyarrow import compute

    pattern = _pattern(column)
    if pattern is None:
        return None
    text = compute.utf8_trim_whitespace(column)
    if isinstance(text, pa.ChunkedArray):
        text = text.combine_chunks()
    empty = ~truth_of(text.is_valid())
    parts = compute.extract_regex(text, pattern)
    if not np.array_equal(~truth_of(parts.is_valid()), empty):
        return None
    found = {parts.type.field(i).name for i in range(parts.type.num_fields)}

    def number(name: str) -> NDArray[np.int64]:
        if name not in found:
            return np.zeros(len(text), np.int64)
        cells = parts.field(name)
        filled = compute.if_else(compute.equal(compute.binary_length(cells), 0), "0", cells)
        return numpy_of(compute.fill_null(compute.cast(filled, pa.int64()), 0))

    clock = (number("hour") * 60 + number("minute")) * 60 + number("second")
    if "half" in found:
        half = compute.fill_null(compute.utf8_lower(parts.field("half")), "")
        noon = number("hour") == 12
        is_pm = truth_of(compute.starts_with(half, "p"))
        is_am = truth_of(compute.starts_with(half, "a"))
        clock = clock + 43200 * ((is_pm & ~noon).astype(np.int64) - (is_am & noon))
    ns = clock * 1_000_000_000
    if "fraction" in found:
        digits = compute.fill_null(compute.utf8_rpad(parts.field("fraction"), 9, "0"), "0")
        ns = ns + numpy_of(compute.cast(digits, pa.int64()))
    ns = ns - _zone_ns(parts.field("zone")) if "zone" in found else ns
    if "days" in found:
        ns = ns + number("days") * DAY_NS
    elif "year" in found:
        ns = _with_days(ns, number, found, parts)
    else:
        ns = _past_midnight(ns, empty, DAY_NS if "hour" in found else DAY_NS // 24)
    ns[empty] = np.iinfo(np.int64).min
    return ns


def _zone_ns(zones: Any) -> NDArray[np.int64]:
    coded = zones.dictionary_encode()
    offsets = [0] * max(len(coded.dictionary), 1)
    for index, zone in enumerate(coded.dictionary.to_pylist()):
        match = re.fullmatch(r"([+\-])(\d{2}):?(\d{2})", zone or "")
        if match:
            offsets[index] = int(f"{match[1]}1") * (int(match[2]) * 60 + int(match[3])) * 60
    offsets_ns = np.array(offsets, dtype=np.int64) * 1_000_000_000
    return np.asarray(offsets_ns[numpy_of(coded.indices.fill_null(0))])


def _with_days(ns: NDArray[np.int64], number: Any, found: set[str], parts: Any) -> NDArray[np.int64]:
    from pyarrow import compute

    year = number("year")
    if "name" in found:
        coded = compute.utf8_lower(parts.field("name")).dictionary_encode()
        months = [_MONTHS.index(name) + 1 if name in _MONTHS else 1 for name in coded.dictionary.to_pylist()]
        month = np.array(months or [1], np.int64)[numpy_of(coded.indices.fill_null(0))]
        return _days(year, month, number("day")) * DAY_NS + ns
    if "first" not in found:
        return _days(year, number("month"), number("day")) * DAY_NS + ns
    first, other = number("first"), number("other")
    readings = []
    for day, month in ((first, other), (other, first)):
        if month.max(initial=1) <= 12:
            readings.append(_days(year, month, day) * DAY_NS + ns)
    # A date such as 03/04/2026 may have the day or the month first. If both readings are possible for all
    # dates, the reading with the shorter total time span is used.
    return min(readings or [ns], key=lambda each: np.ptp(each) if len(each) else 0)


def _days(year: NDArray[np.int64], month: NDArray[np.int64], day: NDArray[np.int64]) -> NDArray[np.int64]:
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    return months.astype("datetime64[D]").astype(np.int64) + day - 1


def _past_midnight(ns: NDArray[np.int64], empty: NDArray[np.bool_], turn_ns: int) -> NDArray[np.int64]:
    """Convert times of day to times that continue to increase after midnight.

    turn_ns   period after which the times start again, ns: a day, or an hour for times without hours

    A time that is earlier than the previous time by more than half a period belongs to the next period.
    """
    known = np.flatnonzero(~empty)
    turns = np.cumsum(np.diff(ns[known], prepend=ns[known[:1]]) < -turn_ns // 2)
    ns = ns.copy()
    ns[known] += turns * turn_ns
    return ns
