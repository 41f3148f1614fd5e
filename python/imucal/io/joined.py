"""One recording from separate text files of two sensors, resampled to one clock if time stamps differ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.document.source import Source
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.arrow_values import numpy_of
from imucal.io.interleaved import refuse_interleaved
from imucal.io.names import SKIP
from imucal.io.remarks import remark
from imucal.io.requested_columns import float64
from imucal.io.scale import accel_reading, is_whole
from imucal.io.sensor import (
    Sensor,
    Units,
    how_read,
    require_gravity,
    time_of_sensor,
    unit_of_sensor,
)
from imucal.io.streams import Stream, recording_from_streams
from imucal.io.table import Table
from imucal.io.text import read_rows
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording
from imucal.units import COLUMN_UNITS, TICKS_PER_S

__all__ = ["joined"]


def joined(
    accel: Sensor,
    gyro: Sensor,
    units: Units,
    sources_of: Callable[[], Sequence[Source]],
    rate_hz: float | None = None,
) -> Recording:
    """One recording of both sensors, resampled to one clock if their time stamps differ.

    With `rate_hz` the time stamps are not read. Sample i of the accelerometer and sample i of the gyroscope
    then belong to the same instant.

    sources_of  function that returns the files with their hashes. It is called after both files were read,
                because the hashes are computed during reading
    """
    accel_unit, gyro_unit = unit_of_sensor(accel, "accel", units), unit_of_sensor(gyro, "gyro", units)
    require_gravity(accel, accel_unit)
    tables = []
    for sensor, what, unit in ((accel, "accel", accel_unit), (gyro, "gyro", gyro_unit)):
        names = [SKIP[0]] * max(sensor.text.layout.width, len(sensor.text.layout.first))
        known = sensor.text.layout.names or [str(index) for index in range(len(names))]
        ticks = None
        if rate_hz is None:
            time, ticks = time_of_sensor(sensor, units.time)
            names[known.index(time[0])] = time[1]
        for axis, column in zip("xyz", sensor.triad.columns, strict=True):
            names[known.index(column)] = f"{what}_{axis}_{unit}"
        refuse_interleaved(sensor.text, names, sensor.head)
        table = read_rows(sensor.text, names)
        tables.append(replace(table, ticks_per_s=ticks))
    sources = sources_of()
    file = f"{accel.text.name} + {gyro.text.name}"
    findings = [finding for table in tables for finding in table.findings]
    is_headed = accel.text.layout.names is not None
    if is_headed:
        how = how_read([(accel, "accel", accel_unit), (gyro, "gyro", gyro_unit)], units, "the headers")
        findings.append(_as_read(file, how, accel, gyro, tables))
    elif units.accel is None and units.gyro is None:
        first = accel.head.triad(accel.triad)
        findings += [] if is_whole(first) else [_counts_assumed(file, first)]
    if rate_hz is not None:
        _require_equal_counts(file, tables)
    stamps = [_nanoseconds(table) for table in tables if rate_hz is None]
    if rate_hz is not None or np.array_equal(stamps[0], stamps[1]):
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
        return recording_from_table(both, sources, rate_hz)
    streams = [
        _stream(table, ns, what) for table, ns, what in zip(tables, stamps, ("accel", "gyro"), strict=True)
    ]
    recording = recording_from_streams(
        file,
        streams[0],
        streams[1],
        sources,
        findings,
        accel_unit="lsb" if accel_unit == "lsb" else "m/s^2",
        gyro_unit="lsb" if gyro_unit == "lsb" else "rad/s",
    )
    return replace(recording, column_units=(accel_unit, gyro_unit))


def _require_equal_counts(file: str, tables: Sequence[Table]) -> None:
    accel, gyro = (len(table.columns[0]) for table in tables)
    if accel != gyro:
        raise InputError(
            f"{file}: {accel} samples of the accelerometer, {gyro} of the gyroscope: rate_hz (--rate-hz) "
            "takes the samples of both in their order, so both files need the same number: remove the "
            "samples that one sensor has alone, or leave the option out"
        )


def _nanoseconds(table: Table) -> NDArray[np.int64]:
    """The time stamps of a table in ns, without rounding if they are integers."""
    name = next(name for name in table.names if name.startswith("time_"))
    column = table.column(name)
    ticks = table.ticks_per_s or TICKS_PER_S[name.removeprefix("time_")]
    if isinstance(column, np.ndarray):
        if column.dtype.kind == "i":
            return np.asarray(column * int(1e9 / ticks))
        return _rounded(table, column, ticks)
    import pyarrow as pa

    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if pa.types.is_timestamp(column.type):
        factor = 1e9 / TICKS_PER_S[column.type.unit]
        return np.asarray(numpy_of(column.view(pa.int64()).fill_null(0))) * int(factor)
    if pa.types.is_integer(column.type) and not column.null_count:
        return np.asarray(numpy_of(column), dtype=np.int64) * int(1e9 / ticks)
    return _rounded(table, float64(column), ticks)


def _rounded(table: Table, values: NDArray[np.float64], ticks: float) -> NDArray[np.int64]:
    """Time stamps in ns, from floating-point numbers with `ticks` per second."""
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
    values: Any = np.column_stack([float64(table.column(name)) for name in by_axis]) * factor
    return Stream(table.file, time_ns, values)


def _counts_assumed(file: str, values: FloatArray) -> Finding:
    return remark(
        file,
        "counts_assumed",
        "the files have no header, so the numbers were taken as counts, but they are not whole "
        f"({accel_reading(values).text})",
        "if they have a unit, give it with --accel-unit m/s^2 --gyro-unit rad/s",
    )


def _as_read(file: str, how: str, accel: Sensor, gyro: Sensor, tables: Sequence[Table]) -> Finding:
    shown = []
    for sensor, table, what in ((accel, tables[0], "accel"), (gyro, tables[1], "gyro")):
        names = [name for name in table.names if name.startswith(what)]
        by = "".join(f" by {name}" for name in table.names if name.startswith("time_"))
        shown.append(f"{', '.join(sorted(names))} from {', '.join(sensor.triad.columns)}{by}")
    return remark(
        file,
        "read_by_header",
        f"{how}: {'; '.join(shown)}",
        "if a unit that no header states is wrong, give --accel-unit or --gyro-unit; if anything else is "
        "wrong, correct the headers, or give the files in the order accelerometer, gyroscope",
    )
