"""Reads text tables with a header.

The column names in the header are canonical (such as `accel_x_g`), or the caller assigns canonical names, or
the names state all sensors, axes and units in other words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.agreement import require_agreement
from imucal.io.head import FirstCells, Head
from imucal.io.header import Header, layout_header
from imucal.io.interleaved import refuse_interleaved
from imucal.io.json_in_text import text_before_json
from imucal.io.layout import Layout
from imucal.io.mapping import mapping_of
from imucal.io.names import NAMES, SKIP, is_canonical, time_unit, triad_part
from imucal.io.programs import Program, program_of
from imucal.io.remarks import corrected_by_px4, remark
from imucal.io.scale import NO_GRAVITY_G, accel_reading, gravity_g, is_constant
from imucal.io.stamps import NANOSECONDS, joined_stamps
from imucal.io.suggestion import suggestion
from imucal.io.table import Table
from imucal.io.text import Text, read_rows
from imucal.io.time_column import time_column
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = [
    "as_read",
    "canonical_names",
    "certain_time",
    "names_given",
    "read_headed",
    "recording_of_text",
    "time_of",
    "with_corrections",
]

# Ticks per second of SampleTimeFine, the time column of Xsens MTi sensors, from the MT low-level
# communication protocol.
TICKS_100US: Final = 1e4


def recording_of_text(text: Text, columns: str | Sequence[str] | None, rate_hz: float | None) -> Recording:
    """The recording in a text table with a header; arguments as for `read_csv`."""
    return recording_from_table(read_headed(text, columns, rate_hz), text.sources, rate_hz)


def read_headed(text: Text, columns: str | Sequence[str] | None, rate_hz: float | None = None) -> Table:
    """Read the table below a header; its columns get the canonical names, such as `accel_x_g`."""
    layout = text.layout
    if layout.names is None:
        raise FormatError(
            f"{text.name}: there is no header line above the first row of numbers, line {layout.line}: name "
            "every column in its order (columns=..., --columns time_s,accel_x_g,...), '-' for a column to "
            "ignore"
        )
    header = layout_header(layout)
    found = {what for what, triads in (("accel", header.accel), ("gyro", header.gyro)) if triads}
    named = {part[0] for name in layout.names if (part := triad_part(name)) is not None}
    # If only the time column or one of two sensors has canonical names, such as time_us or gyro_x_dps, the
    # columns of the sensors are found by interpreting the header.
    by_names = named >= found if named else any(map(is_canonical, layout.names)) and not header.accel
    if columns is not None or by_names:
        given = names_given(text.name, layout, columns)
        refuse_interleaved(text, given)
        table = read_rows(text, given)
    else:
        table = _by_header(text, rate_hz)
    return with_corrections(table, program_of(layout.names, layout.preamble))


def with_corrections(table: Table, program: Program | None) -> Table:
    """The table with a warning if the program that wrote it has corrected the samples."""
    if program is None or not program.is_corrected:
        return table
    return replace(table, findings=(*table.findings, corrected_by_px4(table.file)))


def names_given(name: str, layout: Layout, columns: str | Sequence[str] | None) -> list[str]:
    """The canonical name of each column, from the header or from `columns`; `-` for columns not to read."""
    header = layout.names or []
    if columns is None:
        return [column or SKIP[0] for column in header]
    mapping = mapping_of(columns)
    if mapping is None:
        raise InputError(f"{name} has named columns: give canonical=name pairs, not a list of names")
    names = [SKIP[0]] * len(header)
    for ours, theirs in mapping.items():
        found = [i for i, column in enumerate(header) if column == theirs]
        found = found or [i for i, text in enumerate(layout.described) if text == theirs]
        found = found or [i for i, column in enumerate(header) if column == theirs.lstrip("#%/ ")]
        if not found:
            raise InputError(f"{name}: there is no column {theirs!r}; found: {', '.join(header)}")
        if len(found) > 1:
            raise InputError(
                f"{name}: {len(found)} columns are called {theirs!r}: rename them, or name every column in "
                "its order (--columns time_s,accel_x_g,... --format columns)"
            )
        names[found[0]] = ours
    require_agreement(name, layout, names, check_axes=False)
    named = {ours.rpartition("_")[0] for ours in mapping}
    for i, column in enumerate(header):
        if names[i] in SKIP and is_canonical(column) and column.rpartition("_")[0] not in named:
            names[i] = column
    return names


def _by_header(text: Text, rate_hz: float | None) -> Table:
    """The table of a text whose header states all sensors, axes and units.

    Raises FormatError if the header does not state them.
    """
    layout = text.layout
    header, head = layout_header(layout), Head(text)
    certain = certain_time(header, head, rate_hz is not None)
    if certain is None:
        raise FormatError(_unsure(text, header, head, rate_hz))
    time, ticks = certain
    names = canonical_names(layout.names or [], header, time)
    refuse_interleaved(text, names, head)
    table = joined_stamps(replace(read_rows(text, names), ticks_per_s=ticks))
    return replace(table, findings=(*table.findings, as_read(text.name, header, time)))


def canonical_names(names: Sequence[str], header: Header, time: tuple[str, str] | None) -> list[str]:
    """The canonical name of each column; `-` for a column whose quantity is not known.

    time   (name, canonical name) of the time column, or None
    """
    canonical = [SKIP[0]] * len(names)
    known = {name: index for index, name in reversed(list(enumerate(names)))}
    for triad, what in ((header.accel[0], "accel"), (header.gyro[0], "gyro")):
        for axis, name in zip("xyz", triad.columns, strict=True):
            canonical[known[name]] = f"{what}_{axis}_{triad.unit}"
    if time is not None:
        canonical[known[time[0]]] = time[1]
        if header.stamp is not None and time[0] == header.stamp[0]:
            canonical[known[header.stamp[1]]] = NANOSECONDS
    if header.temperature is not None:
        canonical[known[header.temperature[0]]] = header.temperature[1]
    return canonical


def certain_time(
    header: Header, head: FirstCells, has_rate: bool
) -> tuple[tuple[str, str] | None, float | None] | None:
    """(name, canonical name) of the time column and its ticks per second, as from `time_of`.

    Both are None with `has_rate`, if the caller gives the sampling rate. The result is None if the header is
    ambiguous or contradicts the data. It is also None if the program that wrote the file reverses signs
    (`Header.axes`), because the caller must then give `axes`.
    """
    if len(header.accel) != 1 or len(header.gyro) != 1 or header.axes is not None:
        return None
    accel, gyro = header.accel[0], header.gyro[0]
    if accel.unit is None or gyro.unit is None:
        return None
    gravity = gravity_g(head.triad(accel), accel.unit)
    # The header is not used if the data contradict it, for example if the acceleration excludes gravity.
    if np.isfinite(gravity) and not NO_GRAVITY_G < gravity < 1 / NO_GRAVITY_G:
        return None
    if has_rate:
        return None, None
    if header.stamp is not None and np.any(head.numbers(header.stamp[0]) > 0):
        # The seconds and nanoseconds in the header of a ROS message are joined to one time stamp in ns. This
        # time stamp is used instead of the time at which the message was received.
        return (header.stamp[0], "time_ns"), None
    return time_of(header, head)


def time_of(header: Header, head: FirstCells) -> tuple[tuple[str, str], float | None] | None:
    """(name, canonical name) of the time column, and its ticks per second.

    The ticks per second are None if the canonical name ends with the unit of time, as in time_us.
    """
    chosen = time_column(header.times, head.numbers, head.is_date)
    if chosen is None:
        return None
    if chosen.unit == "100us":
        return (chosen.name, "time_us"), TICKS_100US
    return (chosen.name, chosen.canonical), None


def as_read(file: str, header: Header, time: tuple[str, str] | None) -> Finding:
    """A finding that lists the columns and units as read, and explains how to correct them.

    time   (name, canonical name) of the time column, or None
    """
    is_stamp = time is not None and header.stamp is not None and time[0] == header.stamp[0]
    shown = [] if time is None else [f"{time[1]}={' and '.join(header.stamp or ()) if is_stamp else time[0]}"]
    for triad, what in ((header.accel[0], "accel"), (header.gyro[0], "gyro")):
        shown += [f"{what}_{a}_{triad.unit}={n}" for a, n in zip("xyz", triad.columns, strict=True)]
    by = (
        f" (units of {header.program.name})"
        if header.program is not None and "header" not in (header.accel[0].source, header.gyro[0].source)
        else ""
    )
    return remark(
        file,
        "read_by_header",
        f"columns and units were read from the header{by}: {', '.join(shown)}",
        "if they are wrong, give the right columns and units with --columns",
    )


def _unsure(text: Text, header: Header, head: Head, rate_hz: float | None) -> str:
    """The error message for a header that does not give the sensor, axis and unit of all columns."""
    layout = text.layout

    def works(columns: str) -> bool:
        short = Text(text.name, text.content[: layout.start] + _whole_rows(text), layout, text.sources)
        proposed = [pair.partition("=")[0] for pair in columns.split(",")]
        has_time = any(time_unit(name) is not None for name in (*proposed, *(layout.names or [])))
        try:
            recording_of_text(short, columns, None if has_time else 100.0)
        except (FormatError, InputError):
            return False
        return True

    if header.accel and (unit := header.accel[0].unit) is not None:
        gravity = gravity_g(head.triad(header.accel[0]), unit)
        if np.isfinite(gravity) and not NO_GRAVITY_G < gravity < 1 / NO_GRAVITY_G:
            return (
                f"{text.name}: the header says {unit} for {header.accel[0].columns[0]}, ..., but the median "
                f"magnitude then is {gravity:.3g} g ({accel_reading(head.triad(header.accel[0])).text}): "
                "export the accelerometer with gravity, or correct the unit in the header"
            )
    if advice := text_before_json(_whole_rows(text)):
        return f"{text.name}: {advice}"
    shown = ", ".join(layout.names or [])
    plain = header.plain[0][0].columns if header.plain and not (header.accel or header.gyro) else ()
    if plain and all((layout.names or []).count(name) > 1 for name in plain):
        return (
            f"{text.name}: the columns {', '.join(plain)} occur more than once ({shown[:200]}): name every "
            "column in its order (--columns time_s,accel_x_g,... --format columns), '-' for a column to "
            f"ignore; names are {NAMES}"
        )
    unusable = header.unusable_units()
    if unusable:
        return f"{text.name}: {unusable}. Columns found: {shown[:200]}. Names are {NAMES}"
    is_known = (header.accel or header.linear) and header.gyro
    lead = "the format could not be determined; first line"
    if header.accel or header.gyro:
        has_several = max(len(header.accel), len(header.gyro)) > 1
        has_units = all(triad.unit is not None for triad in (*header.accel[:1], *header.gyro[:1]))
        times = [name for name, _ in header.times if name not in header.unread]
        is_timeless = all(is_constant(head.numbers(name)) for name in times)
        known = "does not give every unit"
        if has_units and (has_several or is_timeless):
            known = "names several sensors of a kind" if has_several else "gives no usable time"
        lead = f"the header {known if is_known else 'names the columns of one sensor only'}"
    if header.program is not None and header.axes is not None:
        lead = (
            f"{header.program.name} writes the acceleration with the sign of iOS, which is reversed (-1 g on "
            "the axis that points up)"
        )
    proposal = suggestion(header, head.cells, works, head.numbers, layout.preamble, rate_hz)
    name = "Otherwise name" if "--columns" in proposal else "Name"
    return (
        f"{text.name}: {lead}: {shown[:200]}. {proposal}{name} the columns (columns=..., --columns): {NAMES}"
    )


def _whole_rows(text: Text) -> bytes:
    part, is_all = text.first_rows(1 << 15)
    return part if is_all else part[: part.rfind(b"\n") + 1]
