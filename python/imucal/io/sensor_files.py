"""Recordings in one text file per sensor, as phone apps and some loggers write: two files, folder, or zip.

Each file has its own time stamps; both are resampled to one clock as described in `streams`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from imucal.document.source import File, Source, is_folder, open_file, open_large
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.arrow_values import numpy_of
from imucal.io.headed import Head, layout_header, recording_of_text, time_of
from imucal.io.header import Header, Triad
from imucal.io.names import SKIP
from imucal.io.packed import TEXT_ENDINGS, ZIP, Archive
from imucal.io.remarks import remark
from imucal.io.scale import NO_GRAVITY_G, accel_reading, gravity_g, gyro_reading, time_reading
from imucal.io.streams import Stream, recording_from_streams
from imucal.io.table import Table
from imucal.io.text import Text, head_of, open_text, read_rows
from imucal.io.vocabulary import float64, recording_from_table
from imucal.recording.recording import Recording
from imucal.units import COLUMN_UNITS, TICKS_PER_S

__all__ = ["are_pair", "read_folder", "read_pair"]

# Units as options give them, and the endings of canonical names.
ACCEL_UNITS: Final = {"m/s^2": "mps2", "g": "g", "mg": "mg", "lsb": "lsb"}
GYRO_UNITS: Final = {"rad/s": "radps", "deg/s": "dps", "mdeg/s": "mdps", "lsb": "lsb"}
# File names of sensors whose columns are only called x, y, z.
GYRO_FILE: Final = re.compile(r"gyr|angular|rotation.?rate|omega", re.IGNORECASE)
ACCEL_FILE: Final = re.compile(r"acc|g-?force|specific", re.IGNORECASE)
OTHER_FILE: Final = re.compile(r"linear|gravity(?!.*acc)|user|mag|orient|baro|without", re.IGNORECASE)


@dataclass(frozen=True)
class _Sensor:
    """A text file with the samples of one sensor: "accel", "gyro", or "" if it does not say which."""

    text: Text
    header: Header
    triad: Triad
    what: str

    @property
    def head(self) -> Head:
        return Head(self.text)


@dataclass(frozen=True)
class _Units:
    """The units that the caller gives, as endings of canonical names, or None."""

    time: str | None
    accel: str | None
    gyro: str | None


def read_pair(
    first_path: str | os.PathLike[str],
    second_path: str | os.PathLike[str],
    *,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read two text files, one per sensor. Without a word on the sensor, the accelerometer is the first.

    time_unit   s, ms, us or ns
    accel_unit  m/s^2, g, mg or lsb
    gyro_unit   rad/s, deg/s, mdeg/s or lsb

    Units are needed only where the headers give none; a unit that a header contradicts is an InputError.
    """
    units = _units(time_unit, accel_unit, gyro_unit)
    sensors = [_sensor(open_text(open_file(path))) for path in (first_path, second_path)]
    return _joined(*_by_role(sensors), units, [sensor.text.sources[0] for sensor in sensors])


def read_folder(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read the text files in a folder or a zip archive: one with both sensors, or one for each sensor.

    The other arguments are those of `read_csv` and `read_pair`.
    """
    units = _units(time_unit, accel_unit, gyro_unit)
    texts, name = list(_texts(path)), Path(path).name
    if len(texts) == 1:
        return recording_of_text(texts[0], columns, rate_hz)
    both = [text for text in texts if _has_both(text)]
    if len(both) == 1:
        return recording_of_text(both[0], columns, rate_hz)
    if len(both) > 1:
        raise InputError(
            f"{name}: {len(both)} files hold a recording ({_listed(both)}): give one of them, unpacked"
        )
    sensors = []
    for text in texts:
        try:
            sensors.append(_sensor(text))
        except FormatError:
            continue
    accel = _chosen(name, [s for s in sensors if s.what == "accel"], "accelerometer", texts)
    gyro = _chosen(name, [s for s in sensors if s.what == "gyro"], "gyroscope", texts)
    sources = list(dict.fromkeys([*accel.text.sources, *gyro.text.sources]))
    return _joined(accel, gyro, units, sources)


def are_pair(paths: Sequence[str | os.PathLike[str]]) -> bool:
    """Whether two files are the accelerometer and the gyroscope of one recording, by their headers."""
    roles = []
    for path in paths:
        try:
            head, layout = head_of(path)
            sensor = _sensor(Text(Path(path).name, head, layout, ()))
        except (FormatError, InputError):
            return False
        roles.append(sensor.what)
    return sorted(roles) == ["accel", "gyro"]


def _units(time_unit: str | None, accel_unit: str | None, gyro_unit: str | None) -> _Units:
    for what, unit, known in (
        ("time_unit", time_unit, list(TICKS_PER_S)),
        ("accel_unit", accel_unit, list(ACCEL_UNITS)),
        ("gyro_unit", gyro_unit, list(GYRO_UNITS)),
    ):
        if unit is not None and unit not in known:
            raise InputError(f"{what} is {unit!r}: give one of {', '.join(known)}")
    return _Units(time_unit, ACCEL_UNITS.get(accel_unit or ""), GYRO_UNITS.get(gyro_unit or ""))


def _texts(path: str | os.PathLike[str]) -> Iterator[Text]:
    """The text files in a folder or an archive that have rows of numbers."""
    files: Iterator[File]
    source = None if is_folder(path) else open_large(path)
    if source is None:
        inside = sorted(p for p in Path(path).iterdir() if p.is_file() and not p.name.startswith("."))
        files = (open_file(p) for p in inside if p.name.lower().endswith(TEXT_ENDINGS) and p.stat().st_size)
    else:
        archive = Archive(path)
        files = (File(Path(member).name, archive.read(member), source) for member in archive.texts())
    for file in files:
        if not file.content.startswith(ZIP) and file.content.strip():
            try:
                yield open_text(file)
            except FormatError:
                continue


def _has_both(text: Text) -> bool:
    header = layout_header(text.layout)
    return bool(text.layout.first and header.accel and header.gyro)


def _sensor(text: Text) -> _Sensor:
    """The sensor in a text file. Raises FormatError if it has no three columns of one."""
    layout, header = text.layout, layout_header(text.layout)
    if layout.names is None:
        if len(layout.first) != 4:
            raise FormatError(
                f"{text.name}: {len(layout.first)} columns without a header, four are needed: time, x, y, z"
            )
        names = ("1", "2", "3")
        return _Sensor(text, Header(times=[("0", None)]), Triad(names, None), "")
    for what, triads in (("accel", header.accel), ("gyro", header.gyro)):
        if triads and not (header.accel and header.gyro):
            return _Sensor(text, header, triads[0], what)
    if header.plain:
        triad, what = header.plain[0]
        if OTHER_FILE.search(text.name):
            what = "linear"
        elif not what:
            is_gyro, is_accel = GYRO_FILE.search(text.name), ACCEL_FILE.search(text.name)
            what = "gyro" if is_gyro else "accel" if is_accel else ""
        return _Sensor(text, header, triad, what)
    linear = " (its acceleration is without gravity)" if header.linear else ""
    raise FormatError(
        f"{text.name}: no three columns x, y, z of an accelerometer or a gyroscope{linear}; found: "
        f"{', '.join(layout.names)}: give the files of these sensors"
    )


def _by_role(sensors: Sequence[_Sensor]) -> tuple[_Sensor, _Sensor]:
    first, second = sensors
    roles = (first.what, second.what)
    if roles in (("gyro", "accel"), ("gyro", ""), ("", "accel")):
        return second, first
    if first.what in ("accel", "") and second.what in ("gyro", ""):
        return first, second
    raise FormatError(
        f"{first.text.name} holds {_sensor_name(first.what)}, {second.text.name} "
        f"{_sensor_name(second.what)}: give an accelerometer with gravity and a gyroscope"
    )


def _sensor_name(what: str) -> str:
    known = {"accel": "an accelerometer", "gyro": "a gyroscope", "linear": "acceleration without gravity"}
    return known.get(what, "an unnamed sensor")


def _chosen(name: str, sensors: list[_Sensor], what: str, texts: Sequence[Text]) -> _Sensor:
    """The file of a sensor: of several accelerometers those with gravity, and not "uncalibrated" ones."""
    if what == "accelerometer" and len(sensors) > 1:
        with_gravity = [sensor for sensor in sensors if _has_gravity(sensor)]
        sensors = with_gravity or sensors
    if len(sensors) > 1:
        named = [s for s in sensors if "uncal" not in s.text.name.lower()]
        total = [s for s in named if "total" in s.text.name.lower()]
        sensors = total or named or sensors
    if len(sensors) == 1:
        return sensors[0]
    if not sensors:
        raise FormatError(f"{name}: no file with the {what}; found: {_listed(texts)}: export it too")
    listed = ", ".join(sensor.text.name for sensor in sensors)
    raise InputError(f"{name}: {len(sensors)} files hold the {what} ({listed}): give two files, unpacked")


def _listed(texts: Sequence[Text]) -> str:
    return ", ".join(text.name for text in texts) or "no text files"


def _has_gravity(sensor: _Sensor) -> bool:
    values = sensor.head.triad(sensor.triad)
    unit = sensor.triad.unit or accel_reading(values).likely
    return unit is not None and (unit == "lsb" or gravity_g(values, unit) > NO_GRAVITY_G)


def _joined(accel: _Sensor, gyro: _Sensor, units: _Units, sources: Sequence[Source]) -> Recording:
    """One recording of both sensors, on one clock if their time stamps differ."""
    accel_unit, gyro_unit = _unit(accel, "accel", units), _unit(gyro, "gyro", units)
    _require_gravity(accel, accel_unit)
    tables = []
    for sensor, what, unit in ((accel, "accel", accel_unit), (gyro, "gyro", gyro_unit)):
        time, ticks = _time(sensor, units.time)
        names = [SKIP[0]] * max(sensor.text.layout.width, len(sensor.text.layout.first))
        known = sensor.text.layout.names or [str(index) for index in range(len(names))]
        names[known.index(time[0])] = time[1]
        for axis, column in zip("xyz", sensor.triad.columns, strict=True):
            names[known.index(column)] = f"{what}_{axis}_{unit}"
        table = read_rows(sensor.text, names)
        tables.append(Table(table.file, table.names, table.columns, table.place, table.findings, ticks))
    file = f"{accel.text.name} + {gyro.text.name}"
    findings = [finding for table in tables for finding in table.findings]
    is_headed = accel.text.layout.names is not None
    if is_headed:
        findings.append(_as_read(file, accel, gyro, tables))
    stamps = [_nanoseconds(table) for table in tables]
    if len(stamps[0]) == len(stamps[1]) and np.array_equal(stamps[0], stamps[1]):
        accel_table, gyro_table = tables
        rest = [(n, c) for n, c in zip(gyro_table.names, gyro_table.columns, strict=True) if n[:4] != "time"]
        both = Table(
            file,
            accel_table.names + [name for name, _ in rest],
            accel_table.columns + [column for _, column in rest],
            accel_table.place,
            tuple(findings),
            accel_table.ticks_per_s,
        )
        return recording_from_table(both, sources)
    streams = [
        _stream(table, ns, what) for table, ns, what in zip(tables, stamps, ("accel", "gyro"), strict=True)
    ]
    return recording_from_streams(
        file,
        streams[0],
        streams[1],
        sources,
        findings,
        accel_unit="lsb" if accel_unit == "lsb" else "m/s^2",
        gyro_unit="lsb" if gyro_unit == "lsb" else "rad/s",
    )


def _unit(sensor: _Sensor, what: str, units: _Units) -> str:
    """The unit of a sensor: of the header, of the caller, or for an accelerometer that of gravity's size."""
    given = units.accel if what == "accel" else units.gyro
    of_header = sensor.triad.unit
    program = sensor.header.program
    if of_header is None and program == "Sensor Logger" and what == "gyro":
        of_header = "radps"
    if given is not None and of_header is not None and given != of_header:
        raise InputError(
            f"{sensor.text.name}: the header contradicts the given unit: it says {of_header}, --{what}-unit "
            f"is {given}: leave the option out, or correct it"
        )
    if of_header is not None or given is not None:
        return of_header or given or ""
    if sensor.text.layout.names is None:
        return "lsb"
    values = sensor.head.triad(sensor.triad)
    reading = accel_reading(values) if what == "accel" else gyro_reading(values)
    if what == "accel" and reading.likely in ("mps2", "g"):
        return reading.likely
    if what == "accel" and gravity_g(values, "g") < NO_GRAVITY_G:
        raise _without_gravity(sensor, gravity_g(values, "g"))
    options = " | ".join(ACCEL_UNITS if what == "accel" else GYRO_UNITS)
    likely = {v: k for k, v in (ACCEL_UNITS if what == "accel" else GYRO_UNITS).items()}.get(
        reading.likely or ""
    )
    shown = f", probably --{what}-unit {likely}" if likely else ""
    raise FormatError(
        f"{sensor.text.name}: the header gives no unit ({reading.text}): give --{what}-unit {options}{shown}"
    )


def _require_gravity(sensor: _Sensor, unit: str) -> None:
    gravity = gravity_g(sensor.head.triad(sensor.triad), unit)
    if not np.isfinite(gravity) or sensor.text.layout.names is None:
        return
    if gravity < NO_GRAVITY_G:
        raise _without_gravity(sensor, gravity)
    if gravity > 1 / NO_GRAVITY_G:
        raise FormatError(
            f"{sensor.text.name}: the median acceleration is {gravity:.3g} g in the unit {unit}: correct "
            "the unit (--accel-unit), or the header"
        )


def _without_gravity(sensor: _Sensor, gravity: float) -> FormatError:
    hint = (
        "Sensor Logger writes acceleration with gravity to TotalAcceleration.csv"
        if sensor.header.program == "Sensor Logger"
        else "choose the accelerometer with gravity in the app"
    )
    return FormatError(
        f"{sensor.text.name}: the acceleration is without gravity (median {gravity:.2g} g), which a "
        f"calibration needs: {hint}"
    )


def _time(sensor: _Sensor, given: str | None) -> tuple[tuple[str, str], float | None]:
    """(name, canonical name) of the time column, and its ticks per second if the name cannot say them."""
    if not sensor.header.times:
        raise FormatError(
            f"{sensor.text.name}: there is no time column: two files need their own time stamps"
        )
    head = sensor.head
    if sensor.text.layout.names is None:
        return ("0", f"time_{given or 's'}"), None
    found = None if given is not None and _plain_stamps(sensor) else time_of(sensor.header, head)
    if found is not None:
        unit = found[0][1].removeprefix("time_")
        of_date = head.is_date(found[0][0])
        if given is not None and given != unit and not of_date:
            raise InputError(
                f"{sensor.text.name}: the header contradicts the given unit: {found[0][0]} is in {unit}, "
                f"--time-unit is {given}: leave the option out, or correct it"
            )
        return found
    name = (_plain_stamps(sensor) or [sensor.header.times[0][0]])[0]
    reading = time_reading(head.numbers(name))
    unit_known = given or reading.likely
    if unit_known is None:
        raise FormatError(
            f"{sensor.text.name}: the header gives no unit of {name} ({reading.text}): give --time-unit s, "
            "ms, us or ns"
        )
    return (name, f"time_{unit_known}"), None


def _plain_stamps(sensor: _Sensor) -> list[str]:
    """Time columns of numbers without a unit; that of the sensor node before that of the host."""
    head = sensor.head
    plain = [name for name, unit in sensor.header.times if unit is None and not head.is_date(name)]
    return sorted(plain, key=lambda name: "node" not in name.lower())


def _nanoseconds(table: Table) -> NDArray[np.int64]:
    """The time stamps of a table, ns; exact for integers."""
    import pyarrow as pa

    name = next(name for name in table.names if name.startswith("time_"))
    column = table.column(name)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if pa.types.is_timestamp(column.type):
        factor = 1e9 / TICKS_PER_S[column.type.unit]
        return np.asarray(numpy_of(column.view(pa.int64()).fill_null(0))) * int(factor)
    ticks = table.ticks_per_s or TICKS_PER_S[name.removeprefix("time_")]
    if pa.types.is_integer(column.type) and not column.null_count:
        return np.asarray(numpy_of(column), dtype=np.int64) * int(1e9 / ticks)
    values = float64(column)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise FormatError(
            f"{table.file}: {table.place(int(bad[0]))}: the time stamp is not a number: remove the line"
        )
    if ticks == 1.0 and np.abs(values).max(initial=0.0) > 9e9:
        raise FormatError(f"{table.file}: time stamps of {values[-1]:.6g} s are no times: check their unit")
    return np.asarray(np.round(values * (1e9 / ticks)), dtype=np.int64)


def _stream(table: Table, time_ns: NDArray[np.int64], what: str) -> Stream:
    names = [name for name in table.names if name.startswith(what)]
    factor = COLUMN_UNITS[what][names[0].rpartition("_")[2]]
    by_axis = sorted(names)
    values: Any = np.column_stack([float64(_whole(table.column(name))) for name in by_axis]) * factor
    return Stream(table.file, time_ns, values)


def _whole(column: Any) -> Any:
    import pyarrow as pa

    return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column


def _as_read(file: str, accel: _Sensor, gyro: _Sensor, tables: Sequence[Table]) -> Finding:
    shown = []
    for sensor, table, what in ((accel, tables[0], "accel"), (gyro, tables[1], "gyro")):
        names = [name for name in table.names if name.startswith(what)]
        time = next(name for name in table.names if name.startswith("time_"))
        shown.append(f"{', '.join(sorted(names))} from {', '.join(sensor.triad.columns)} by {time}")
    return remark(
        file,
        "read_by_header",
        f"columns and units were read from the headers: {'; '.join(shown)}",
        "if this is wrong, correct the headers, or give the files in the order accelerometer, gyroscope",
    )
