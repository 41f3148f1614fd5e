"""Reads a text file with the samples of one sensor as a recording without the other sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucal.errors import FormatError, InputError
from imucal.io.headed import recording_of_text
from imucal.io.header import layout_header
from imucal.io.interleaved import refuse_interleaved
from imucal.io.names import NAMES, SKIP, is_canonical
from imucal.io.remarks import remark
from imucal.io.sensor import (
    Sensor,
    Units,
    how_read,
    require_gravity,
    sensor_of,
    time_of_sensor,
    unit_of_sensor,
)
from imucal.io.text import Text, read_rows
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["alone", "recording_of_any_text"]

# If a file has at least this number of unrecognised columns, they may be the three axes of a second sensor.
SECOND_SENSOR = 3
NO_UNITS = Units(None, None, None)


def recording_of_any_text(
    text: Text, columns: str | Sequence[str] | None, rate_hz: float | None, units: Units = NO_UNITS
) -> Recording:
    """The recording in a text table with a header. The table may contain both sensors or only one.

    Arguments as for `read_csv`. Raises InputError if `units` are given for a table that states the units in
    the names of its columns.
    """
    layout = text.layout
    is_named = columns is not None or layout.names is None or any(map(is_canonical, layout.names))
    sensor = None if is_named else _only_sensor(text, needs_time=rate_hz is None)
    if sensor is not None:
        return alone(sensor, units, rate_hz)
    if unused := [name for name, unit in units._asdict().items() if unit is not None]:
        raise InputError(
            f"{text.name} is read as one table, for which there is no option {unused[0]}_unit: name the "
            f"columns with their units (columns=..., --columns): {NAMES}"
        )
    return recording_of_text(text, columns, rate_hz)


def _only_sensor(text: Text, *, needs_time: bool) -> Sensor | None:
    """The only sensor of a file.

    None if the file has no sensor, both sensors, or columns that may belong to another sensor, and if the
    caller must give `axes`. Also None if it has a time column although `needs_time` is false, or no time
    column although `needs_time` is true.
    """
    header = layout_header(text.layout)
    try:
        sensor = sensor_of(text)
    except FormatError:
        return None
    used = {*sensor.triad.columns, *(name for name, _ in header.times)}
    others = [name for name in text.layout.names or [] if name and name not in used]
    is_other = (header.accel and header.gyro) or header.linear or len(others) >= SECOND_SENSOR
    is_unclear = is_other or bool(header.times) != needs_time or header.axes is not None
    return sensor if sensor.what in ("accel", "gyro") and not is_unclear else None


def alone(sensor: Sensor, units: Units, rate_hz: float | None = None) -> Recording:
    """The recording of one sensor alone; `rate_hz` is needed if there is no time column."""
    what, text = sensor.what, sensor.text
    other = "gyro" if what == "accel" else "accel"
    if getattr(units, other) is not None:
        raise InputError(
            f"{text.name} contains one sensor, and {other}_unit is the unit of the other one: leave the "
            "option out, or give the file of the other sensor, too"
        )
    unit = unit_of_sensor(sensor, what, units)
    if what == "accel":
        require_gravity(sensor, unit)
    known = text.layout.names or []
    names = [SKIP[0]] * max(text.layout.width, len(text.layout.first))
    shown, ticks = [], None
    if rate_hz is None:
        time, ticks = time_of_sensor(sensor, units.time)
        names[known.index(time[0])] = time[1]
        shown.append(f"{time[1]}={time[0]}")
    for axis, column in zip("xyz", sensor.triad.columns, strict=True):
        names[known.index(column)] = f"{what}_{axis}_{unit}"
        shown.append(f"{what}_{axis}_{unit}={column}")
    refuse_interleaved(text, names, sensor.head)
    table = read_rows(text, names)
    as_read = remark(
        text.name,
        "read_by_header",
        f"{how_read([(sensor, what, unit)], units, 'the header')}: {', '.join(shown)}",
        "if they are wrong, give the right columns and units with --columns",
    )
    table = replace(table, ticks_per_s=ticks, findings=(*table.findings, as_read))
    return recording_from_table(table, text.sources, rate_hz)
