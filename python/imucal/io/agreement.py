"""Refusal of column names that contradict the header of a table, in its units, sensors or axes."""

from __future__ import annotations

from collections.abc import Sequence

from imucal.errors import InputError
from imucal.io.header import Header, header_of, layout_header
from imucal.io.layout import Layout
from imucal.io.names import time_unit, triad_part
from imucal.io.unit_words import split_unit
from imucal.units import UNIT_TEXT

__all__ = ["require_agreement", "require_agreement_of_names"]


def require_agreement(name: str, layout: Layout, names: Sequence[str], *, check_axes: bool) -> None:
    """Raises InputError if the header states another unit, sensor or (`check_axes`) axis than `names`."""
    if layout.names is None or len(layout.names) != len(names):
        return
    header = layout_header(layout)
    stated = list(zip(layout.names, layout.described, names, strict=True))
    _require_agreement(
        name,
        header,
        stated,
        "correct --columns, or leave the header out (--skip-rows, with a name for every column) if it is "
        "wrong",
        check_axes=check_axes,
    )


def require_agreement_of_names(name: str, pairs: Sequence[tuple[str, str]]) -> None:
    """Raises InputError if the name of a column states another unit or sensor than the assigned name.

    pairs  the name of each column in the table, and its canonical name
    """
    header = header_of([theirs for theirs, _ in pairs])
    stated = [(theirs, theirs, ours) for theirs, ours in pairs]
    _require_agreement(
        name, header, stated, "correct columns, or rename the column if it is wrong", check_axes=False
    )


def _require_agreement(
    name: str, header: Header, stated: Sequence[tuple[str, str, str]], way_out: str, *, check_axes: bool
) -> None:
    """Raises InputError as described in `require_agreement`.

    stated  for each column: its name in the file, this name with its unit, and the assigned canonical name
    """
    roles = {
        column: (what, axis)
        for what, triads in (("accel", header.accel), ("gyro", header.gyro))
        for triad in triads
        for axis, column in zip("xyz", triad.columns, strict=True)
    }
    for column, described, ours in stated:
        part, of_time = triad_part(ours), time_unit(ours)
        _, unit = split_unit(described)
        wrong = None
        if part is not None and part[0] in ("accel", "gyro"):
            if (unit is not None and unit[0] in ("accel", "gyro", "any") and unit[1] != part[2]) or (
                unit is not None and unit[0] in ("time", "temp", "other")
            ):
                wrong = _stated(unit)
            elif column in roles and roles[column][0] != part[0]:
                wrong = {"accel": "an accelerometer", "gyro": "a gyroscope"}[roles[column][0]]
            elif check_axes and column in roles and roles[column][1] != part[1]:
                wrong = f"the axis {roles[column][1]}"
        elif of_time is not None and unit is not None and unit[0] == "time" and unit[1] != of_time:
            wrong = _stated(unit)
        if wrong is not None:
            raise InputError(
                f"{name}: the header contradicts the given columns: {ours} is given for the column "
                f"{described!r}, which says {wrong}: {way_out}"
            )


def _stated(unit: tuple[str, str]) -> str:
    """The words by which a message names a unit that `split_unit` has found."""
    if unit[0] == "other":
        return "a unit of another quantity"
    return f"the unit {UNIT_TEXT.get(unit[1], unit[1])}"
