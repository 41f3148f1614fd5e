"""Writes the rows of a table in JSON as a text table, whose header states the units of the columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from imucal.document.source import File
from imucal.errors import FormatError
from imucal.io.column_words import is_time, words_of
from imucal.io.header import header_of
from imucal.io.interleaved import MOST_UNITS
from imucal.io.json_members import AXES, UNIT, Row
from imucal.io.layout import Layout, is_value, layout_of, split_line
from imucal.io.text import Text
from imucal.io.unit_words import split_unit, split_unread, unit_of
from imucal.units import UNIT_TEXT

__all__ = ["text_of_table"]


def text_of_table(file: File, label: str, rows: Sequence[Row]) -> Text:
    """The text table of rows without the columns of text; cells that a row lacks are empty.

    Raises FormatError if a member states several units, or another unit than the name of a column.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    units = _units(file.name, names, rows)
    names = [name for name in names if _is_read(name, rows)]
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    # A line feed in a name would end the line.
    header = [" ".join(name.split()) for name in names]
    writer.writerow(header)
    start = len(written.getvalue().encode(errors="replace"))
    writer.writerows([row.get(name) for name in names] for row in rows)
    content = written.getvalue().encode(errors="replace")
    name = f"{file.name} ({label})" if label else file.name
    found = layout_of(name, content)
    layout = Layout(
        header,
        [units.get(name, "") for name in names] if units else None,
        [],
        ",",
        found.decimal if found.separator == "," else ".",
        start,
        2,
        len(names),
        split_line(content[start:].partition(b"\n")[0].decode(), ","),
    )
    return Text(name, content, layout, (file.source,), label=label or None)


def _is_read(name: str, rows: Sequence[Row]) -> bool:
    """Whether a column is a time, has few labels, or at least half of its cells are numbers or dates."""
    cells = [cell for row in rows if (cell := row.get(name)) is not None and cell != ""]
    others = [cell for cell in cells if not _is_number(cell)]
    # A column with few different texts may show that the rows are those of several units.
    are_labels = all(isinstance(cell, str) and cell.isprintable() for cell in others)
    are_labels = are_labels and len(set(others)) <= MOST_UNITS
    return 2 * len(others) <= len(cells) or is_time(words_of(name), None) or are_labels


def _is_number(cell: object) -> bool:
    """Whether a cell is a number or a date, or a text with one."""
    return is_value(cell.strip(), ",") if isinstance(cell, str) else isinstance(cell, (int, float))


def _units(file: str, names: Sequence[str], rows: Sequence[Row]) -> dict[str, str]:
    """The unit of each column that its name itself does not state.

    It is the unit in the name of the outer member, as in `gyro_dps.x`, or the text of a member `unit`.
    """
    units: dict[str, str] = {}
    for name in names:
        outer, _, axis = name.rpartition(".")
        unit = split_unit(outer)[1]
        if axis in AXES and outer and split_unit(name)[1] is None:
            stated = UNIT_TEXT.get(unit[1], "") if unit is not None else split_unread(outer)[1]
            units |= {name: stated} if stated else {}
    for member in filter(UNIT.search, names):
        stated_units = {own: None for row in rows if isinstance(own := row.get(member), str) and own.strip()}
        if len(stated_units) > 1:
            raise FormatError(
                f"{file}: the member {member!r} states several units ({', '.join(stated_units)[:60]}): "
                "convert the samples to one unit"
            )
        stated = next(iter(stated_units), "")
        for name in _columns_with_unit(names, UNIT.sub("", member), stated) if stated else ():
            known = unit_of(units[name]) if name in units else split_unit(name)[1]
            if known is not None and known != unit_of(stated):
                raise FormatError(
                    f"{file}: the column {name} has the unit {UNIT_TEXT.get(known[1], known[1])}, and the "
                    f"member {member!r} states {stated}: correct one of them"
                )
            if known is None:
                units[name] = stated
    return units


def _columns_with_unit(names: Sequence[str], outer: str, stated: str) -> Sequence[str]:
    """The columns whose unit a member beside them states: the axes in its object, or those of a sensor."""
    bare = {name: split_unit(name)[0] for name in names if name.startswith(outer)}
    axes = [name for name in bare if bare[name].removeprefix(outer).strip("._ ").lower() in tuple(AXES)]
    if axes:
        return axes
    header, unit = header_of(names), unit_of(stated)
    triads = {"accel": header.accel, "gyro": header.gyro}.get(unit[0], []) if unit is not None else []
    return triads[0].columns if len(triads) == 1 else []
