"""Choice of the column of a table that contains its time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from imucal.io.scale import epoch_unit, is_constant

__all__ = ["TimeColumn", "time_column"]


class TimeColumn(NamedTuple):
    """The time column of a table.

    unit      "s", "ms", "us", "ns" or "100us"; "date" for dates and times of day
    is_epoch  whether the values are times since 1970
    """

    name: str
    unit: str
    is_epoch: bool

    @property
    def canonical(self) -> str:
        """The column's name in a canonical table, such as time_ms; dates are read as seconds."""
        return "time_s" if self.unit == "date" else f"time_{self.unit}"


def time_column(
    times: Sequence[tuple[str, str | None]], numbers: Callable[[str], Any], is_date: Callable[[str], bool]
) -> TimeColumn | None:
    """The column that contains the time, if its unit is known; None otherwise.

    times    name of each column that may contain the time, and its unit, or None if the name gives no unit
    numbers  function that returns the first numbers of a column
    is_date  function that tests whether a column contains dates or times of day

    Time stamps since 1970 take precedence over a time since the start, because only they are comparable
    between two files. A column whose first time stamps are all equal, such as zeros, is not used.
    """
    usable = [(name, unit) for name, unit in times if not is_constant(numbers(name))]
    for name, _ in usable:
        if (epoch := epoch_unit(numbers(name))) is not None:
            return TimeColumn(name, epoch, is_epoch=True)
    for name, unit in usable:
        if unit is not None and (unit == "100us" or not is_date(name)):
            return TimeColumn(name, unit, is_epoch=False)
    dates = (name for name, _ in usable if is_date(name))
    return next((TimeColumn(name, "date", is_epoch=False) for name in dates), None)
