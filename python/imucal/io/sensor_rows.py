"""Reads text tables in which each row holds the sample of one sensor, and a column names this sensor.

    sensor,timestamp,x,y,z
    accelerometer,1000000,0.03,0.11,9.79
    gyroscope,1002000,0.001,-0.002,0.000

The rows of each sensor are read as a separate text, as if the sensor had a file of its own.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from imucal.errors import FormatError
from imucal.io.head import Head
from imucal.io.header import sensor_column
from imucal.io.layout import layout_of, split_line
from imucal.io.remarks import lines_left_out
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.text import Text, open_path
from imucal.recording.recording import Recording

__all__ = ["read_sensor_rows", "texts_of_rows"]


def read_sensor_rows(
    path: str | os.PathLike[str],
    *,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read a text table with the sample of one sensor in each row; arguments as for `read_pair`."""
    units = units_given(time_unit, accel_unit, gyro_unit, rate_hz)
    text = open_path(path)
    names = text.layout.names or []
    column = sensor_column(Head(text).cells)
    if column is None:
        raise FormatError(
            f"{text.name}: no column names the sensor of each row, such as accelerometer and gyroscope; "
            f"found: {', '.join(names)}"
        )
    layout, at = text.layout, names.index(column)
    lines = text.content[layout.start :].decode(errors="replace").split("\n")
    fields = [split_line(line, layout.separator) for line in lines if line.strip()]
    rows: dict[str, list[list[str]]] = {}
    for row in fields:
        if len(row) > at and row[at]:
            rows.setdefault(row[at], []).append(row[:at] + row[at + 1 :])
    heads = [each[:at] + each[at + 1 :] for each in (names, layout.units) if each]
    recording = recording_of_texts(
        texts_of_rows(text, {sensor: [*heads, *own] for sensor, own in rows.items()}, layout.separator),
        text.name,
        None,
        rate_hz,
        units,
    )
    out = len(fields) - sum(map(len, rows.values()))
    if not out:
        return recording
    warning = lines_left_out(text.name, [f"{out} rows without the name of a sensor"], out)
    return replace(recording, findings=(*recording.findings, warning))


def texts_of_rows(
    whole: Text, tables: Mapping[str, Iterable[Sequence[object]]], separator: str = ","
) -> list[Text]:
    """The text of each table; a table is a header and rows. The keys of `tables` name the sensors."""
    texts = []
    for sensor, table in tables.items():
        written = io.StringIO()
        csv.writer(written, delimiter=separator, lineterminator="\n").writerows(table)
        content = written.getvalue().encode()
        name = f"{whole.name} ({sensor})" if sensor else whole.name
        texts.append(Text(name, content, layout_of(name, content), whole.sources, label=sensor or None))
    return texts
