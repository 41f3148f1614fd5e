"""Advice for a header without canonical names: the likely units, and a value for the option --columns."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.io.column_words import words_of, words_of_unit
from imucal.io.dates import is_date_column
from imucal.io.header import Header, Triad, header_of, sensor_column
from imucal.io.names import is_canonical
from imucal.io.scale import (
    Reading,
    accel_reading,
    gyro_reading,
    is_still,
    time_reading,
)
from imucal.io.sensor_labels import sensor_of_label
from imucal.io.time_column import time_column
from imucal.io.unit_words import split_unit

__all__ = ["columns_suggested", "rows_of_several_sensors", "suggestion", "time_suggested"]

# A sampling rate in a line before the header: "Update Rate: 100.0Hz", "data_rate = 100 Hz", "#sps,100",
# "Frecuencia (Hz);100".
RATE: Final = (
    r"(?i)(?:(?<![a-z])(?<!baud )(?<!baud_)(?:rate|sps)|(?:^\W*|sampl\w*[ _])fr[eé][qck]\w*)"
    r"(?: *[(\[]hz[)\]])?[\W_]{0,4}(\d+(?:\.\d+)?)"
)
# Matches the name of a temperature column. Its values are probably in degC if their median is in the range
# PLAUSIBLE_DEGC.
TEMPERATURE: Final = r"(?i)temp(?:erature)?(?![a-z])"
PLAUSIBLE_DEGC: Final = (-60.0, 130.0)
# Words in names of angular rates, each with the axis.
AXES_OF_RATES: Final = {"p": "x", "roll": "x", "q": "y", "pitch": "y", "r": "z", "yaw": "z"}


def suggestion(
    header: Header,
    cells: Mapping[str, Sequence[str]],
    works: Callable[[str], bool],
    numbers: Callable[[str], Any],
    preamble: Sequence[str] = (),
    rate_hz: float | None = None,
) -> str:
    """Sentences on the columns of a file whose header is ambiguous; empty if the columns are unknown.

    cells     the first cells of each column
    works     function that tests whether the file can be read with a value of --columns
    numbers   function that returns the first numbers of a column
    preamble  lines before the header
    rate_hz   sampling rate that the caller gives, Hz; no time column is then proposed
    """
    header = _likely_first(_with_rates(_with_gravity(header, numbers), list(cells)), numbers)
    of_one_unit = _of_one_unit(header)
    if of_one_unit is None:
        return (
            "There are several accelerometers and gyroscopes, and their names do not tell which are of one "
            "unit (IMU): choose the columns of one unit. "
        )
    header = of_one_unit
    lead = ""
    if not (header.accel and header.gyro):
        several = rows_of_several_sensors(cells)
        if several or not (header.accel or header.gyro) or (header.linear and not header.accel):
            return several or _without_a_sensor(header)
        if unknown := _unknown_axes(header, cells):
            return unknown
        lead = _alone(header)
    # No unit of measurement is proposed for a column whose header states another unit.
    if unusable := header.unusable_units():
        return f"{unusable[0].upper()}{unusable[1:]}. "
    sentences: list[str] = []
    # For each triad: the sensor, and the units of measurement that are compatible with its numbers.
    guessed: list[tuple[Triad, str, tuple[str, ...]]] = []
    is_moving = False
    for triad in header.accel[:1]:
        values = _values(triad, numbers)
        units, sentence = _units(triad, accel_reading(values))
        is_moving = not is_still(values, units[0] if len(units) == 1 else None)
        sentences += sentence
        guessed.append((triad, "accel", units))
    for triad in header.gyro[:1]:
        units, sentence = _units(triad, gyro_reading(_values(triad, numbers), is_moving=is_moving))
        sentences += sentence
        guessed.append((triad, "gyro", units or (() if lead else ("dps", "radps"))))
    time, sentence = _time(header, cells, numbers) if rate_hz is None else (None, [])
    sentences += sentence
    if any(triad in header.linear for triad in header.accel[:1]):
        sentences.append("linear acceleration is without gravity in most apps, but these values include it")
    temperature, sentence = _temperature(header, cells, numbers)
    sentences += sentence
    others = [t.columns[0] for t in (*header.accel[1:], *header.gyro[1:])]
    if others:
        sentences.append(f"there are further sensors ({', '.join(others)}, ...): choose one")
    if any("includinggravity" in triad.columns[0].lower() for triad in header.accel[:1]):
        sentences.append(
            "Safari on iOS writes this acceleration with the reversed sign: if the recording is from there, "
            "also give --axes accel=-x,-y,-z"
        )
    shown = f"{lead}No unit is assumed: {'; '.join(sentences)}. " if sentences else lead
    pairs = [time] if time and not is_canonical(time.partition("=")[2]) else []
    lines = []
    for chosen in product(*(units for _, _, units in guessed)):
        names = [
            f"{what}_{axis}_{unit}={name}"
            for (triad, what, _), unit in zip(guessed, chosen, strict=True)
            for axis, name in zip("xyz", triad.columns, strict=True)
            if not is_canonical(name)
        ]
        columns = ",".join([*pairs, *names, *temperature])
        if (pairs or names) and works(columns):
            rate = _rate_in(preamble) if rate_hz is None else f"{rate_hz:.12g}"
            axes = f" --axes {header.axes}" if header.axes else ""
            lines.append(f"{'' if time else f'--rate-hz {rate} '}--columns '{columns}'{axes}")
    if not lines:
        return shown
    if len(lines) > 1:
        return f"{shown}Give the one that is right: {' or '.join(lines)}. "
    return f"{shown}If these are the columns and their units: {lines[0]}. "


def _with_gravity(header: Header, numbers: Callable[[str], Any]) -> Header:
    """The header, in which "linear" acceleration that includes gravity is assigned to the accelerometer."""
    if header.accel or not header.linear:
        return header
    triad = header.linear[0]
    likely = accel_reading(_values(triad, numbers)).likely
    if likely not in ("mps2", "g", "mg") or triad.unit not in (None, likely):
        return header
    return replace(header, accel=[triad])


def _likely_first(header: Header, numbers: Callable[[str], Any]) -> Header:
    """The header with its accelerometers in another order.

    Accelerometers whose samples include gravity come first, and those whose samples are all zero come last.
    """
    if len(header.accel) < 2:
        return header
    samples = [_values(triad, numbers) for triad in header.accel]
    ranks = [
        2 if not np.nanmedian(np.abs(values).max(axis=1)) > 0 else accel_reading(values).likely is None
        for values in samples
    ]
    return replace(
        header, accel=[header.accel[at] for at in sorted(range(len(ranks)), key=ranks.__getitem__)]
    )


def _with_rates(header: Header, names: Sequence[str]) -> Header:
    """Add a gyroscope that consists of the three columns in a unit of angular rate, such as p, q, r in deg/s.

    The header is unchanged if there are not three such columns, if their names do not state the axes, or if
    it already has a gyroscope.
    """
    units = {name: unit for name in names if (unit := split_unit(name)[1]) is not None and unit[0] == "gyro"}
    axes = {
        AXES_OF_RATES[word]: name
        for name in units
        for word in words_of(split_unit(name)[0])
        if word in AXES_OF_RATES
    }
    if header.gyro or len(units) != 3 or len(axes) != 3 or len(set(units.values())) > 1:
        return header
    return replace(header, gyro=[Triad((axes["x"], axes["y"], axes["z"]), units[axes["x"]][1])])


def _of_one_unit(header: Header) -> Header | None:
    """The header whose first accelerometer and first gyroscope are those of one unit (IMU).

    If there are several, the names must have the same words besides those of the sensor and the axis, as
    left_acc_x and left_gyro_x. The result is None if there are several of both and no such names.
    """
    for accel in header.accel:
        for gyro in header.gyro:
            if words_of_unit(accel.columns[0]) == words_of_unit(gyro.columns[0]):
                return replace(
                    header,
                    accel=[accel, *(other for other in header.accel if other != accel)],
                    gyro=[gyro, *(other for other in header.gyro if other != gyro)],
                )
    return None if len(header.accel) > 1 and len(header.gyro) > 1 else header


def _rate_in(preamble: Sequence[str]) -> str:
    """The only sampling rate in the lines before the header, Hz; a placeholder if there is none."""
    rates = {float(found) for line in preamble for found in re.findall(RATE, line)}
    return f"{rates.pop():g}" if len(rates) == 1 else "HZ"


def columns_suggested(
    names: Sequence[str], cells: Mapping[str, Sequence[str]], numbers: Callable[[str], Any]
) -> str:
    """A sentence that proposes a value of --columns for these columns; empty if the columns are unknown.

    cells    the first cells of each column
    numbers  function that returns the first numbers of a column
    """
    return suggestion(header_of(names), cells, lambda _: True, numbers)


def time_suggested(
    names: Sequence[str], cells: Mapping[str, Sequence[str]], numbers: Callable[[str], Any]
) -> str:
    """A sentence that proposes the time column of these columns; empty if no column has the name of a time.

    Arguments as for `columns_suggested`.
    """
    pair, sentences = _time(header_of(names), cells, numbers)
    if pair is None:
        return ""
    shown = f"{'; '.join(sentences)}. " if sentences else ""
    return f"{shown}If this is the time: --columns '{pair}'. "


def rows_of_several_sensors(cells: Mapping[str, Sequence[str]]) -> str:
    """A sentence for a table with one sensor per row; empty for any other table.

    Such a table has a column with the name of a sensor in each row, such as `acc` or `gyro`.
    """
    name = sensor_column(cells)
    if name is None:
        return ""
    words = list(dict.fromkeys(cells[name]))[:10]
    return (
        f"Each row contains one sensor, named in the column {name!r} ({', '.join(words)}): write the rows of "
        "each sensor to a separate file, and give both files. "
    )


def _without_a_sensor(header: Header) -> str:
    if header.linear and not header.accel:
        return (
            "Its acceleration is without gravity (linear acceleration), which a calibration needs: export "
            "the accelerometer with gravity. "
        )
    if header.plain:
        return (
            f"The columns {', '.join(header.plain[0][0].columns)} name no sensor: if all rows are of one "
            "sensor, give both files of the recording with --format pair; if they are of several sensors, "
            "write the rows of each sensor to a separate file first. "
        )
    return ""


def _unknown_axes(header: Header, names: Iterable[str]) -> str:
    """A sentence on three or more columns that name the other sensor but no axes; empty for fewer columns."""
    sensor, other = ("gyro", "gyroscope") if header.accel else ("accel", "accelerometer")
    unknown = [name for name in names if sensor_of_label(name) == sensor]
    if len(unknown) < 3:
        return ""
    return (
        f"The columns {', '.join(unknown)} name the {other}, but not the axes x, y and z: find out the axis "
        "of each column. "
    )


def _alone(header: Header) -> str:
    """A sentence on a header in which the columns of only one sensor are recognised by their names."""
    names = ", ".join((header.accel or header.gyro)[0].columns)
    found, other = ("accelerometer", "gyroscope") if header.accel else ("gyroscope", "accelerometer")
    return (
        f"The names are known only for the columns of the {found} ({names}): if there are columns of the "
        f"{other}, name them too; if they are in a second file, give both files (--format pair); else the "
        f"recording is of the {found} alone. "
    )


def _values(triad: Triad, numbers: Callable[[str], Any]) -> FloatArray:
    return np.column_stack([numbers(name) for name in triad.columns])


def _units(triad: Triad, reading: Reading) -> tuple[tuple[str, ...], list[str]]:
    """The units of a triad that its header or its numbers allow, and a sentence on the numbers."""
    if triad.unit is not None:
        return (triad.unit,), []
    return (reading.likely,) if reading.likely is not None else reading.either, [reading.text]


def _time(
    header: Header, cells: Mapping[str, Sequence[str]], numbers: Callable[[str], Any]
) -> tuple[str | None, list[str]]:
    """The text canonical=name for the time column, or None, and sentences that explain the unit."""
    import pyarrow as pa

    def is_date(name: str) -> bool:
        return is_date_column(pa.array([str(cell) for cell in cells[name]])) is not None

    chosen = time_column(header.times, numbers, is_date)
    readings = [(name, time_reading(numbers(name))) for name, _ in header.times]
    if chosen is not None and chosen.unit == "100us":
        # No canonical name has this unit of time, so `suggestion` proposes --rate-hz instead.
        return None, []
    if chosen is not None:
        sentences = [reading.text for name, reading in readings if chosen.is_epoch and name == chosen.name]
        return f"{chosen.canonical}={chosen.name}", sentences
    for name, reading in readings:
        if reading.likely is not None and name not in header.unread:
            return f"time_{reading.likely}={name}", [reading.text]
    if unread := header.unread_in(name for name, _ in header.times):
        sentence = (
            f"the header gives a unit of time that is not read ({', '.join(unread)}): give the sampling rate "
            "(rate_hz, --rate-hz), or convert the column to s, ms, us or ns"
        )
        return None, [sentence]
    return None, [reading.text for _, reading in readings[:1]]


def _temperature(
    header: Header, cells: Mapping[str, Sequence[str]], numbers: Callable[[str], Any]
) -> tuple[list[str], list[str]]:
    """The text canonical=name for the temperature column, and a sentence on its unit, if there are any."""
    if header.temperature is not None:
        name, canonical = header.temperature
        return [] if is_canonical(name) else [f"{canonical}={name}"], []
    named = [name for name in cells if re.search(TEMPERATURE, name) and not is_canonical(name)]
    if len(named) != 1 or not cells[named[0]]:
        return [], []
    median = float(np.median(numbers(named[0])))
    if not PLAUSIBLE_DEGC[0] <= median <= PLAUSIBLE_DEGC[1]:
        return [], []
    return [f"temp_degc={named[0]}"], [f"temperature: median {median:.3g}, probably degC"]
