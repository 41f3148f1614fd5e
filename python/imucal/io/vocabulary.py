"""The canonical column names, and the conversion of named columns to a Recording.

    time_*        accel_{x,y,z}_*        gyro_{x,y,z}_*
    temp_*        stand_{1,2,3}_*        other numeric columns: auxiliary

The units at the ends of the names, such as accel_x_g, are listed in `imucal.units`.

Readers only assign canonical names to columns. This module converts units and checks the contents. Physical
units become SI (1 g = 9.80665 m/s^2 exactly). Time in s is unchanged. Time in ms, us or ns, usually a large
integer since some epoch, is counted from the first sample in integer arithmetic, so that no digit is lost.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.document.source import Source
from imucal.errors import FormatError, InputError
from imucal.io.copies import without_copies
from imucal.io.first_cells import TableCells, is_numeric
from imucal.io.header import names_sensor
from imucal.io.names import (
    AXES,
    RAW_TEMPERATURE,
    SKIP,
    is_canonical,
    temperature_unit,
    time_unit,
    triad_part,
)
from imucal.io.remarks import one_sensor
from imucal.io.requested_columns import Clock, RequestedColumns, date_ticks_per_s
from imucal.io.separate_rows import on_one_clock
from imucal.io.suggestion import columns_suggested, time_suggested
from imucal.io.table import Table
from imucal.recording.recording import Recording, Sensor
from imucal.units import COLUMN_UNITS, TEMPERATURE_UNITS, TICKS_PER_S, to_degc

__all__ = ["column_names", "recording_from_table"]


def column_names(recording: Recording) -> list[tuple[str, NDArray[Any]]]:
    """The columns of a recording with their canonical names, in the order of a written file."""
    accel = "lsb" if recording.accel_unit == "lsb" else "mps2"
    gyro = "lsb" if recording.gyro_unit == "lsb" else "radps"
    columns: list[tuple[str, NDArray[Any]]] = [("time_s", recording.time_s)]
    for what, unit, samples in (
        ("accel", accel, recording.specific_force),
        ("gyro", gyro, recording.angular_rate),
    ):
        if samples is not None:
            columns += [(f"{what}_{axis}_{unit}", samples[:, i]) for i, axis in enumerate("xyz")]
    if recording.temperature_degc is not None:
        columns.append(("temp_degc", recording.temperature_degc))
    if recording.stand_rad is not None:
        columns += [(f"stand_{motor}_rad", recording.stand_rad[:, i]) for i, motor in enumerate("123")]
    for name, values in recording.auxiliary.items():
        is_taken = is_canonical(name) and name != RAW_TEMPERATURE
        if is_taken or not name.strip() or any(mark in name for mark in ',;"\r\n'):
            raise InputError(
                f"{recording.name}: the auxiliary input {name!r} cannot be a column name: it is a canonical "
                "name, is blank, or contains a comma, semicolon, quote or line break; rename it"
            )
        columns.append((name, values))
    return columns


def recording_from_table(
    table: Table, sources: Sequence[Source], rate_hz: float | None = None, clock: Clock | None = None
) -> Recording:
    """A Recording from columns with canonical names.

    rate_hz  sampling rate, Hz, if there is no time column; the first sample is then at 0 s
    clock    shared by all pieces of a recording; None if the table is the whole recording

    If the table has no column of one sensor, the result is a recording of the other sensor alone, with a
    warning. Raises FormatError if a column is missing, given twice, has an unknown unit, or contains text.
    """
    _refuse_duplicates(table)
    used: set[str] = set()
    requested = RequestedColumns(table, Clock() if clock is None else clock)
    alone = _alone(table)
    accel, accel_unit = (None, None) if alone == "gyroscope" else _triad(requested, "accel", used)
    gyro, gyro_unit = (None, None) if alone == "accelerometer" else _triad(requested, "gyro", used)
    time_s = _time(requested, used, rate_hz)
    stand = None
    if any(name.startswith("stand_") and triad_part(name) for name in table.names):
        stand, _ = _triad(requested, "stand", used)
    temperature, scale = _temperature(requested, used)
    auxiliary = {
        name: requested.numbers(name)
        for name, column in zip(table.names, table.columns, strict=True)
        if name not in used and name not in SKIP and name and is_numeric(column)
    }
    requested.read()
    findings = table.findings
    if alone is not None:
        findings = (*findings, one_sensor(table.file, alone, list(auxiliary)))
    recording = Recording(
        time_s,
        accel,
        gyro,
        temperature_degc=None if temperature is None else to_degc(temperature, scale),
        stand_rad=stand,
        auxiliary=auxiliary,
        accel_unit="lsb" if accel_unit == "lsb" else "m/s^2",
        gyro_unit="lsb" if gyro_unit == "lsb" else "rad/s",
        name=table.file,
        sources=sources,
        findings=findings,
        column_units=(accel_unit, gyro_unit),
    )
    if rate_hz is not None or clock is not None:
        return recording
    return without_copies(on_one_clock(recording))


def _alone(table: Table) -> Sensor | None:
    """The only sensor of the table; None if it has columns of both sensors or of neither.

    The result is also None if the name of another column suggests the second sensor. The message about
    missing columns then proposes this column.
    """
    triads = {part[0] for name in table.names if (part := triad_part(name)) is not None}
    others = [name for name in table.names if name not in SKIP and name and not is_canonical(name)]
    if len(triads & {"accel", "gyro"}) != 1 or names_sensor(others, "gyro" if "accel" in triads else "accel"):
        return None
    return "accelerometer" if "accel" in triads else "gyroscope"


def _refuse_duplicates(table: Table) -> None:
    counts = Counter(name for name in table.names if name not in SKIP)
    twice = sorted(name for name, count in counts.items() if count > 1)
    if twice:
        raise FormatError(f"{table.file}: the column {twice[0]} is given twice: rename or remove one")


def _triad(requested: RequestedColumns, triad: str, used: set[str]) -> tuple[NDArray[Any], str]:
    """The three columns of a triad, (N, 3) in SI units or counts, and the unit in their names."""
    table = requested.table
    found: dict[str, list[tuple[str, str]]] = {axis: [] for axis in AXES[triad]}
    for name in table.names:
        part = triad_part(name)
        if part is not None and part[0] == triad:
            found[part[1]].append((name, part[2]))
    for axis, names in found.items():
        if len(names) > 1:
            raise FormatError(
                f"{table.file}: {triad}_{axis} is given twice ({', '.join(name for name, _ in names)}): "
                "remove one"
            )
        if not names:
            raise FormatError(
                f"{table.file}: the column {triad}_{axis}_* is missing "
                f"(* is one of {', '.join(COLUMN_UNITS[triad])}); {_found(table).rstrip('. ')}"
            )
    columns = [found[axis][0] for axis in AXES[triad]]
    units = {unit for _, unit in columns}
    if len(units) > 1:
        raise FormatError(
            f"{table.file}: the units of {', '.join(name for name, _ in columns)} are mixed: "
            "give all three axes in one unit"
        )
    unit = units.pop()
    used.update(name for name, _ in columns)
    factor = COLUMN_UNITS[triad][unit]
    is_small = factor == 1.0 and all(_fits_float32(table.column(name)) for name, _ in columns)
    values = np.empty((requested.rows, 3), np.float32 if is_small else np.float64)
    for column, (name, _) in enumerate(columns):
        requested.numbers(name, values[:, column], factor)
    return values, unit


def _fits_float32(column: Any) -> bool:
    """Whether float32 can represent every number of the column's type. Empty cells are NaN in float32."""
    if isinstance(column, np.ndarray):
        return column.itemsize <= (2 if column.dtype.kind == "i" else 4)
    import pyarrow as pa

    kind = column.type
    most_bits = 16 if pa.types.is_integer(kind) else 32 if pa.types.is_floating(kind) else 0
    return bool(most_bits and kind.bit_width <= most_bits)


def _time(requested: RequestedColumns, used: set[str], rate_hz: float | None) -> NDArray[np.float64]:
    table = requested.table
    names = [name for name in table.names if time_unit(name) is not None]
    if len(names) > 1:
        raise FormatError(
            f"{table.file}: there are {len(names)} time columns ({', '.join(names)}): remove one"
        )
    if rate_hz is not None:
        if names:
            raise InputError(
                f"{table.file}: rate_hz is given but there is a time column {names[0]}: leave one out"
            )
        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"{table.file}: rate_hz is {rate_hz}: give a positive number")
        first = requested.clock.rows
        return np.arange(first, first + requested.rows, dtype=np.float64) / rate_hz
    if not names:
        # A table with the columns of one sensor is a valid recording, so the proposal for --columns does not
        # contain columns of the other sensor.
        found = _found(table, columns_suggested if _alone(table) is None else time_suggested)
        raise FormatError(
            f"{table.file}: the column time_s (or time_ms, time_us, time_ns) is missing; {found}If there is "
            "none, give the sample rate (rate_hz, --rate-hz); if each row is the mean of a rest, give "
            "--means (imucal.read_means)"
        )
    name = names[0]
    used.add(name)
    unit = name.removeprefix("time_")
    of_date = date_ticks_per_s(table.column(name)) or table.ticks_per_s
    if unit == "s" and of_date is None:
        return requested.numbers(name)
    return requested.since_first(name, of_date or TICKS_PER_S[unit])


def _temperature(
    requested: RequestedColumns, used: set[str]
) -> tuple[NDArray[Any] | None, tuple[float, float]]:
    """The temperature column, or None, and the slope and offset that convert it to degC."""
    table = requested.table
    names = [name for name in table.names if temperature_unit(name) is not None]
    if len(names) > 1:
        raise FormatError(f"{table.file}: the temperature is given twice ({', '.join(names)}): remove one")
    if not names:
        return None, TEMPERATURE_UNITS["degc"]
    name = names[0]
    used.add(name)
    return requested.numbers(name), TEMPERATURE_UNITS[name.removeprefix("temp_")]


def _found(table: Table, suggested: Callable[..., str] = columns_suggested) -> str:
    """A list of the column names, with a proposal for --columns if they are not canonical."""
    cells = TableCells(table)
    texts = {name: cells.texts(name) for name in table.names}
    return f"found: {', '.join(table.names)}. {suggested(table.names, texts, cells.numbers)}"
