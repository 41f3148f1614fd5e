"""Identifies the sensor, its unit and its time column in a text file with the samples of one sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from imucal.errors import FormatError, InputError
from imucal.io.head import Head
from imucal.io.headed import time_of
from imucal.io.header import Header, Triad, layout_header
from imucal.io.scale import (
    NO_GRAVITY_G,
    accel_reading,
    epoch_unit,
    excludes_radps,
    gravity_g,
    gyro_reading,
    time_reading,
)
from imucal.io.sensor_labels import only_triple, sensor_of_file, sensor_of_label
from imucal.io.text import Text
from imucal.io.unit_words import split_unit
from imucal.units import COLUMN_UNITS, TICKS_PER_S, UNIT_TEXT

__all__ = [
    "Sensor",
    "Units",
    "has_gravity",
    "how_read",
    "require_gravity",
    "sensor_in_name",
    "sensor_of",
    "time_of_sensor",
    "unit_of_sensor",
    "units_given",
]

# Units in options, each with the suffix of canonical names.
ACCEL_UNITS: Final = {UNIT_TEXT[suffix]: suffix for suffix in COLUMN_UNITS["accel"]}
GYRO_UNITS: Final = {UNIT_TEXT[suffix]: suffix for suffix in COLUMN_UNITS["gyro"]}


class Sensor:
    """A text file with the samples of one sensor.

    what  "accel", "gyro", "other" for another quantity, or "" if the sensor is not identified
    head  the first cells of the file, if they are known
    """

    def __init__(self, text: Text, header: Header, triad: Triad, what: str, head: Head | None = None) -> None:
        self.text, self.header, self.triad, self.what = text, header, triad, what
        self._head = head

    @property
    def unread(self) -> list[str]:
        """The units that the header states for the columns of this sensor and that are not supported."""
        return self.header.unread_in(self.triad.columns)

    @property
    def head(self) -> Head:
        """The first cells of the file."""
        if self._head is None:
            self._head = Head(self.text)
        return self._head


class Units(NamedTuple):
    """The units given by the caller, as suffixes of canonical names, or None."""

    time: str | None
    accel: str | None
    gyro: str | None


def units_given(
    time_unit: str | None, accel_unit: str | None, gyro_unit: str | None, rate_hz: float | None = None
) -> Units:
    """The units given by the options of the caller.

    Raises InputError for an unknown unit, and for a unit of time if a sampling rate replaces the time stamps.
    """
    if time_unit is not None and rate_hz is not None:
        raise InputError(
            "time_unit and rate_hz are both given, but the sampling rate replaces the time stamps: leave one "
            "of the options out"
        )
    for what, unit, known in (
        ("time_unit", time_unit, list(TICKS_PER_S)),
        ("accel_unit", accel_unit, list(ACCEL_UNITS)),
        ("gyro_unit", gyro_unit, list(GYRO_UNITS)),
    ):
        if unit is not None and unit not in known:
            raise InputError(f"{what} is {unit!r}: give one of {', '.join(known)}")
    return Units(time_unit, ACCEL_UNITS.get(accel_unit or ""), GYRO_UNITS.get(gyro_unit or ""))


def sensor_of(text: Text) -> Sensor:
    """The sensor in a text file. Raises FormatError if the file has no three columns of one sensor."""
    layout, header = text.layout, layout_header(text.layout)
    if layout.names is None:
        if len(layout.first) != 4:
            raise FormatError(
                f"{text.name}: {len(layout.first)} columns without a header, four are needed: time, x, y, z: "
                "leave the others out, or write a line with the names of all columns above the rows"
            )
        head = Head(text)
        time, *axes = _time_first_or_last(head)
        triad = Triad((axes[0], axes[1], axes[2]), None)
        return Sensor(text, Header(times=[(time, None)]), triad, "", head)
    named = sensor_in_name(text)
    for role, triads in (("accel", header.accel), ("gyro", header.gyro)):
        if triads and not (header.accel and header.gyro):
            if text.label != text.name and named in ("accel", "gyro") and named != role:
                raise InputError(
                    f"{text.name}: the header names the columns {', '.join(triads[0].columns)}, but the rows "
                    "are those of another sensor: write the rows of each sensor, with their own header, to a "
                    "separate file, and give both files"
                )
            return Sensor(text, header, triads[0], role)
    if header.plain:
        triad, of_unit = header.plain[0]
        if named == "other":
            return Sensor(text, header, triad, "other")
        if text.label == text.name:
            return Sensor(text, header, triad, of_unit or named)
        if named and of_unit not in ("", named):
            # One header gives the unit of the rows of all sensors, so it is not that of this sensor.
            triad = triad._replace(unit=None)
        return Sensor(text, header, triad, named or of_unit)
    if named in ("accel", "gyro") and (columns := only_triple(layout.names)) is not None:
        stated = [split_unit(layout.described[layout.names.index(name)])[1] for name in columns]
        unit = stated[0][1] if stated[0] is not None and stated.count(stated[0]) == 3 else None
        return Sensor(text, header, Triad(columns, unit), named)
    if text.label != text.name:
        raise FormatError(
            f"{text.name}: the columns {', '.join(layout.names)} do not state which three are the axes x, y "
            "and z: write one row per sample, with the axes in the columns x, y, z"
        )
    linear = " (its acceleration is without gravity)" if header.linear else ""
    raise FormatError(
        f"{text.name}: no three columns x, y, z of an accelerometer or a gyroscope{linear}; found: "
        f"{', '.join(layout.names)}: give the files of these sensors"
    )


def sensor_in_name(text: Text) -> str:
    """The sensor that the name of a file, or the label of a table in a file, names, as in `Sensor`."""
    return sensor_of_file(text.name) if text.label == text.name else sensor_of_label(text.label)


def _time_first_or_last(head: Head) -> tuple[str, str, str, str]:
    """The columns time, x, y, z of a file without a header. The time may be the first or the last column."""

    def increases(column: str) -> bool:
        steps = np.diff(head.numbers(column))
        return bool(len(steps)) and bool((steps >= 0).all()) and bool((steps > 0).any())

    if increases("3") and not increases("0"):
        return "3", "0", "1", "2"
    return "0", "1", "2", "3"


def _unit_given(what: str, units: Units) -> str | None:
    """The unit of a sensor that the caller gives, or None."""
    return units.accel if what == "accel" else units.gyro


def _unit_in_header(sensor: Sensor) -> str | None:
    """The unit that the header itself states, or None."""
    return sensor.triad.unit if sensor.triad.source == "header" else None


def _unit_of_manual(sensor: Sensor, what: str) -> str | None:
    """The unit that the manual of the program states, or None.

    The manual is not used if the samples exclude its unit, because some programs can be set to other units.
    """
    program = sensor.header.program
    if program is None or sensor.unread:
        return None
    if what == "accel":
        return program.accel or None
    if program.gyro == "radps" and excludes_radps(sensor.head.triad(sensor.triad)):
        return None
    return program.gyro or None


def unit_of_sensor(sensor: Sensor, what: str, units: Units) -> str:
    """The unit of a sensor ("accel" or "gyro") as a suffix of canonical names, such as mps2.

    The unit is stated by the header or the caller. If neither states it, it is that of the manual of the
    program, or is inferred from the size of gravity.
    """
    of_header, given = _unit_in_header(sensor), _unit_given(what, units)
    if given is not None and of_header is not None and given != of_header:
        raise InputError(
            f"{sensor.text.name}: the header contradicts the given unit: it says {of_header}, --{what}-unit "
            f"is {given}: leave the option out, or correct it"
        )
    stated = given or of_header or _unit_of_manual(sensor, what)
    if stated is not None:
        return stated
    if sensor.text.layout.names is None:
        return "lsb"
    if sensor.unread:
        raise FormatError(
            f"{sensor.text.name}: the header gives a unit that is not read ({', '.join(sensor.unread)}): "
            f"convert the columns, or if this is no unit, give --{what}-unit"
        )
    if unusable := sensor.header.unusable_units():
        raise FormatError(f"{sensor.text.name}: {unusable}")
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


def how_read(read: Sequence[tuple[Sensor, str, str]], units: Units, source: str) -> str:
    """The start of a message on columns and units, with the origin of each unit that the header omits.

    read    each sensor, with "accel" or "gyro", and its unit as a suffix of canonical names
    source  the headers from which the columns were read
    """
    origins = [
        f"the unit {unit} {_origin(sensor, what, units)}"
        for sensor, what, unit in read
        if _unit_in_header(sensor) is None
    ]
    return "; ".join([f"columns {'' if origins else 'and units '}were read from {source}", *origins])


def _origin(sensor: Sensor, what: str, units: Units) -> str:
    """The end of a sentence on the origin of a unit that the header does not state."""
    if _unit_given(what, units) is not None:
        return f"is that of --{what}-unit"
    program = sensor.header.program
    if program is not None and _unit_of_manual(sensor, what) is not None:
        return f"is assumed, because {program.name} writes it by default"
    return "follows from the size of gravity"


def has_gravity(sensor: Sensor) -> bool:
    """Whether the first samples of an accelerometer include gravity.

    The samples are evaluated in the stated unit, or in the likely unit if none is stated.
    """
    values = sensor.head.triad(sensor.triad)
    unit = sensor.triad.unit or accel_reading(values).likely
    return unit is not None and (unit == "lsb" or gravity_g(values, unit) > NO_GRAVITY_G)


def require_gravity(sensor: Sensor, unit: str) -> None:
    """Raises FormatError for acceleration without gravity, or far from 1 g in this unit."""
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


def _without_gravity(sensor: Sensor, gravity: float) -> FormatError:
    program = sensor.header.program
    hint = (
        "Sensor Logger writes acceleration with gravity as TotalAcceleration"
        if program is not None and program.name == "Sensor Logger"
        else "choose the accelerometer with gravity in the app"
    )
    return FormatError(
        f"{sensor.text.name}: the acceleration is without gravity (median {gravity:.2g} g), which a "
        f"calibration needs: {hint}"
    )


def time_of_sensor(sensor: Sensor, given: str | None) -> tuple[tuple[str, str], float | None]:
    """(name, canonical name) of the time column, and its ticks per second.

    The ticks per second are None if the canonical name ends with the unit of time, as in time_us.

    given   unit of time that the caller gives, or None
    """
    if not sensor.header.times:
        raise FormatError(
            f"{sensor.text.name}: there is no time column: two files need their own time stamps; if the "
            "samples of both are taken together, give the sampling rate with --rate-hz"
        )
    head = sensor.head
    if sensor.text.layout.names is None:
        name = sensor.header.times[0][0]
        return (name, f"time_{given or epoch_unit(head.numbers(name)) or 's'}"), None
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
    unread = sensor.header.unread_in([name])
    if unread and given is None and epoch_unit(head.numbers(name)) is None:
        raise FormatError(
            f"{sensor.text.name}: the header gives a unit of time that is not read ({unread[0]}): convert "
            f"the column {name} to s, ms, us or ns"
        )
    unit_known = given or reading.likely
    if unit_known is None:
        raise FormatError(
            f"{sensor.text.name}: the header gives no unit of {name} ({reading.text}): give --time-unit s, "
            "ms, us or ns"
        )
    return (name, f"time_{unit_known}"), None


def _plain_stamps(sensor: Sensor) -> list[str]:
    """Time columns of numbers without a unit.

    The time of the sensor node takes precedence over the time of the host.
    """
    head = sensor.head
    plain = [name for name, unit in sensor.header.times if unit is None and not head.is_date(name)]
    return sorted(plain, key=lambda name: "node" not in name.lower())
