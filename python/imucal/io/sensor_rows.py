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
from typing import NamedTuple

from imucal.errors import FormatError
from imucal.finding import Finding
from imucal.io.header import header_of, sensor_column
from imucal.io.last_line import LastLine
from imucal.io.layout import Layout, layout_of, split_line
from imucal.io.remarks import lines_left_out
from imucal.io.sensor import units_given
from imucal.io.sensor_files import recording_of_texts
from imucal.io.sensor_labels import MOST_SENSORS
from imucal.io.text import Text, open_path
from imucal.recording.recording import Recording

__all__ = ["SensorRows", "read_sensor_rows", "rows_by_sensor", "texts_of_rows"]


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
    layout = text.layout
    last = LastLine(text.content, layout)
    lines = text.content[layout.start : last.end].decode(errors="replace").split("\n")
    rows = [split_line(line, layout.separator) for line in lines if line.strip()]
    apart = rows_by_sensor(layout.described, rows)
    if apart is None:
        raise FormatError(
            f"{text.name}: no column names the sensor of each row, such as accelerometer and gyroscope; "
            f"found: {', '.join(layout.names or [])}"
        )
    texts = texts_of_rows(text, apart.tables, layout.separator)
    recording = recording_of_texts(texts, text.name, None, rate_hz, units)
    findings = (*recording.findings, *last.findings(text.name), *apart.findings(text.name))
    return replace(recording, findings=findings)


class SensorRows(NamedTuple):
    """A table that was split by the names of sensors in one of its columns.

    tables   the header and the rows of each sensor, without the column that names it
    without  number of rows that do not name a sensor; they are in no table
    """

    tables: dict[str, list[Sequence[object]]]
    without: int

    def findings(self, file: str) -> tuple[Finding, ...]:
        """A warning if rows do not name a sensor."""
        left = [f"{self.without} rows without the name of a sensor"]
        return (lines_left_out(file, left, self.without),) if self.without else ()


def rows_by_sensor(names: Sequence[str], rows: Sequence[Sequence[object]]) -> SensorRows | None:
    """The rows of each sensor if a column names the sensor of each row; otherwise None.

    A sensor has only those columns in which it has a value. A column `unit` gives the unit of its axes.
    Raises FormatError if the rows of a sensor have several units.
    """
    column = sensor_column({name: _words(rows, at) for at, name in enumerate(names)})
    if column is None or _have_both(names, rows):
        return None
    at = list(names).index(column)
    of_sensor: dict[str, list[Sequence[object]]] = {}
    labels: dict[str, str] = {}
    for row in rows:
        if len(row) > at and isinstance(row[at], str) and row[at]:
            # Labels such as acc and ACC name one sensor.
            label = labels.setdefault(str(row[at]).strip().casefold(), str(row[at]).strip())
            of_sensor.setdefault(label, []).append(row)
    tables: dict[str, list[Sequence[object]]] = {}
    for sensor, own in of_sensor.items():
        used = {i for row in own for i, cell in enumerate(row) if cell not in (None, "")} - {at}
        kept = [i for i in range(len(names)) if i in used]
        # A row with too many or too few cells stays so, because the reader of texts reports its line.
        unit = _unit(sensor, names, own)
        tables[sensor] = [[_with_unit(names[i], unit) for i in kept]]
        tables[sensor] += [[row[i] for i in kept if i < len(row)] + list(row[len(names) :]) for row in own]
    return SensorRows(tables, len(rows) - sum(map(len, of_sensor.values())))


def _have_both(names: Sequence[str], rows: Sequence[Sequence[object]]) -> bool:
    """Whether every row has samples of both sensors, so that a column with words for sensors is a state."""
    header = header_of(names)
    if not (header.accel and header.gyro) or header.plain:
        return False
    at = [list(names).index(triads[0].columns[0]) for triads in (header.accel, header.gyro)]
    return all(i < len(row) and row[i] not in (None, "") for row in rows for i in at)


def _unit(sensor: str, names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """The unit of a sensor from a column `unit`; empty if there is no such column."""
    at = [i for i, name in enumerate(names) if name.strip().lower() in ("unit", "units")]
    stated = dict.fromkeys(str(row[i]).strip() for i in at for row in rows if i < len(row) and row[i])
    if len(stated) > 1:
        raise FormatError(
            f"the rows of the sensor {sensor} have several units ({', '.join(stated)[:60]}): convert them to "
            "one unit"
        )
    return next(iter(stated), "")


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit and name.strip().lower() in ("x", "y", "z") else name


def _words(rows: Sequence[Sequence[object]], at: int) -> list[str]:
    """The different texts in a column, up to a number that is too large for names of sensors."""
    words: dict[str, None] = {}
    for row in rows:
        if len(row) > at and isinstance(word := row[at], str) and word:
            words[word] = None
            if len(words) > MOST_SENSORS:
                break
    return list(words)


def texts_of_rows(
    whole: Text, tables: Mapping[str, Iterable[Sequence[object]]], separator: str = ","
) -> list[Text]:
    """The text of each table; a table is a header and rows. The keys of `tables` name the sensors."""
    texts = []
    for sensor, table in tables.items():
        written = io.StringIO()
        writer = csv.writer(written, delimiter=separator, lineterminator="\n")
        rows = ([_in_one_line(cell) for cell in row] for row in table)
        names = [str(name) for name in next(rows)]
        writer.writerow(names)
        start = len(written.getvalue().encode(errors="replace"))
        writer.writerows(rows)
        content = written.getvalue().encode(errors="replace")
        name = f"{whole.name} ({sensor})" if sensor else whole.name
        # The position of the header is known, and only the decimal mark must be found. A search for the first
        # row would skip rows with many texts.
        decimal = layout_of(name, content, width=len(names)).decimal
        first = (
            split_line(content[start:].partition(b"\n")[0].decode(), separator)
            if start < len(content)
            else []
        )
        layout = Layout(names, None, [], separator, decimal, start, 2, len(names), first)
        texts.append(Text(name, content, layout, whole.sources, label=sensor or None))
    return texts


def _in_one_line(cell: object) -> object:
    """The cell without line breaks, because a line of the text is a row."""
    return " ".join(cell.split()) if isinstance(cell, str) and ("\n" in cell or "\r" in cell) else cell
