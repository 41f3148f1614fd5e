"""Interpretation of the column names of a text file.

The role of a column is inferred from the words of its name (`column_words`). Its unit is taken only from the
header, or from the documentation of the program if the header identifies the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias

from imucal.io.column_words import (
    NOT_TIME,
    is_counted,
    is_of_other,
    is_time,
    role_of,
    time_unit_in,
    words_of,
)
from imucal.io.programs import Program, program_of
from imucal.io.unit_words import split_unit, split_unread

__all__ = ["Header", "Triad", "header_of", "names_sensor", "sensor_column"]

# Descriptor of a quantity in column names of MicroStrain, such as `X Accel [x8004]`.
DESCRIPTOR: Final = r"\s*\[x[0-9A-Fa-f]{4}\]"
# Matches a multiple of a unit of time, as in `Time [10ms]`, `Timestamp (100 ns)` or `t (ms x10)`. No
# canonical name states such a unit.
_TIMES: Final = r"(?:[mnuµ]?s(?:ecs?)?|seconds?|(?:milli|micro|nano)(?:s|seconds?))"
MULTIPLE: Final = (
    rf"(?i)(?<![A-Za-z\d])(?!1 ?[a-zµ])(?:\d+/)?[\d.]+ ?{_TIMES}(?![A-Za-z])|"
    rf"(?<![A-Za-z]){_TIMES} ?[x*/·] ?\d+"
)

# Maximum number of different words in a column that names the sensor of each row.
MOST_SENSORS: Final = 40


class Triad(NamedTuple):
    """Three columns of one sensor.

    columns  names in the file, in the order x, y, z
    unit     suffix of the canonical names, such as mps2, g or dps; None if the unit is not known
    source   source of the unit: "header", or the name of the program that writes such files
    """

    columns: tuple[str, str, str]
    unit: str | None
    source: str = "header"


@dataclass(frozen=True)
class Header:
    """The columns of a text file by role.

    accel, gyro  triads of the sensor, in the order in which they were found
    linear       triads of acceleration without gravity
    plain        triads whose column names are only x, y, z, each with the sensor that its unit implies, or
                 "" if the unit implies no sensor
    times        name and unit of each time column; None for an unknown unit
    stamp        names of two columns with the seconds and the nanoseconds of a time stamp of ROS, or None
    temperature  name of a column of temperature and its canonical name, or None
    program      the program or app that writes such files, with the units of its manual, or None
    unread       for each column whose name states a unit that is not supported: the text of this unit
    mixed        the triads whose columns state different units
    """

    accel: list[Triad] = field(default_factory=list)
    gyro: list[Triad] = field(default_factory=list)
    linear: list[Triad] = field(default_factory=list)
    plain: list[tuple[Triad, str]] = field(default_factory=list)
    times: list[tuple[str, str | None]] = field(default_factory=list)
    stamp: tuple[str, str] | None = None
    temperature: tuple[str, str] | None = None
    program: Program | None = None
    unread: dict[str, str] = field(default_factory=dict)
    mixed: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def axes(self) -> str | None:
        """The value of the option `axes` that corrects the signs of the samples; None if they are right."""
        return None if self.program is None else self.program.axes

    def unread_in(self, columns: Iterable[str]) -> list[str]:
        """The units that the names of these columns state and that are not supported."""
        return list(dict.fromkeys(self.unread[name] for name in columns if name in self.unread))

    def unusable_units(self) -> str:
        """A sentence on units of the sensors that are stated but cannot be used; empty if there are none."""
        used = [triad.columns for triad in (*self.accel[:1], *self.gyro[:1])]
        unread = self.unread_in(name for columns in used for name in columns)
        if unread:
            return (
                f"the header gives units that are not read ({', '.join(unread)}): convert the columns to "
                "m/s^2, g or mg, and to rad/s, deg/s or mdeg/s; if a word is no unit, or another word for a "
                "known unit, name each column with its unit (columns=NAME=COLUMN,..., --columns)"
            )
        mixed = next((columns for columns in used if columns in self.mixed), None)
        if mixed is not None:
            return (
                f"the header gives different units for the axes of one sensor ({', '.join(mixed)}): convert "
                "the columns to one unit"
            )
        return ""


# Columns grouped by quantity ("accel", ...) and by the part of their names that does not depend on the axis.
# A group maps each axis to the name of its column and the unit of this column, or None for an unknown unit.
_Groups: TypeAlias = dict[tuple[str, str], dict[str, tuple[str, str | None]]]


def header_of(
    names: Sequence[str], described: Sequence[str] | None = None, preamble: Sequence[str] = ()
) -> Header:
    """Infer the role (sensor, axis and unit) of each column from its name.

    described  the names, each with the unit from a line of units, if there is one
    preamble   lines before the header
    """
    described = names if described is None else described
    program = program_of(names, preamble)
    groups: _Groups = {}
    times: list[tuple[str, str | None]] = []
    temperature: tuple[str, str] | None = None
    stamp = _stamp(names)
    unread: dict[str, str] = {}
    # A common prefix of all names, such as the name of the device, is ignored.
    prefix = _shared_start([name for name in names if name])
    only_time = None
    if program is not None and program.time in [name.lower() for name in names]:
        only_time = program.time
    for name, text in zip(names, described, strict=True):
        if program is not None and program.unused and name.lower().startswith(program.unused):
            continue
        bare, unit = split_unit(text)
        stated = bare.removeprefix(prefix)
        bare, unknown = split_unread(stated) if unit is None else (stated, "")
        bare = re.sub(r"_CAL$|_cal$", "", re.sub(DESCRIPTOR, "", bare))
        words = words_of(bare)
        if is_time(words, unit) or name.lower() == only_time:
            if (stamp is not None and name in stamp) or (only_time and name.lower() != only_time):
                continue
            known = unit[1] if unit and unit[0] == "time" else time_unit_in(words_of(stated))
            multiple = re.search(MULTIPLE, text)
            if multiple is not None:
                known, unknown = None, unknown or multiple[0]
            elif is_counted(words_of(stated)):
                unknown = unknown or words_of(stated)[-1]
            if known is None and program is not None:
                known = program.times.get(name.strip().lower())
            if known is None and unknown:
                unread[name] = unknown
            times.append((name, known))
            continue
        if unknown:
            unread[name] = unknown
        if unit is not None and unit[0] == "temp" and temperature is None:
            temperature = (name, f"temp_{unit[1]}")
            continue
        role = role_of(words, bare, unit)
        if role is not None:
            what, axis, key = role
            groups.setdefault((what, key), {}).setdefault(axis, (name, unit[1] if unit else None))
    _sensors_by_unit(names, described, groups)
    header = Header(times=times, stamp=stamp, temperature=temperature, program=program, unread=unread)
    if not _has(groups, "gyro"):
        _index_axes(names, described, groups)
    # Triads without any unit in their names. Only these triads get the units in the manual of the program
    # that wrote the file.
    without_units = set()
    for (what, _), found in groups.items():
        if len(found) != 3:
            continue
        units = {found[axis][1] for axis in "xyz"}
        columns = (found["x"][0], found["y"][0], found["z"][0])
        if len(units - {None}) > 1:
            header.mixed.append(columns)
        unit_name = next(iter(units)) if len(units) == 1 else None
        if what.startswith("plain") and _is_quaternion(columns[0], names):
            continue
        of = {"plain-accel": "accel", "plain-gyro": "gyro"}.get(what, what)
        source = "header"
        if units == {None} and not header.unread_in(columns):
            without_units.add(columns)
        if columns in without_units and program is not None and of in ("accel", "gyro"):
            unit_name, source = (program.accel if of == "accel" else program.gyro), program.name
        if (
            program is not None
            and program.name == "Physics Toolbox"
            and of == "accel"
            and found["x"][0] == "ax"
        ):
            what = "linear"
        triad = Triad(columns, unit_name or None, source)
        if what.startswith("plain"):
            header.plain.append((triad, what.partition("-")[2]))
        else:
            {"accel": header.accel, "gyro": header.gyro, "linear": header.linear}[what].append(triad)
    if program is not None and program.name == "ROS" and not header.accel:
        # In sensor_msgs/Imu the field linear_acceleration includes gravity, so it is the accelerometer.
        header.accel.extend(
            Triad(t.columns, program.accel, program.name) if t.columns in without_units else t
            for t in header.linear
        )
        header.linear.clear()
    return header


def names_sensor(names: Sequence[str], what: str) -> bool:
    """Whether the words of any column name identify an axis of the sensor `what`, "accel" or "gyro"."""

    def of(name: str) -> str | None:
        bare, unit = split_unit(name)
        bare = bare if unit is not None else split_unread(bare)[0]
        role = role_of(words_of(bare), bare, unit)
        return None if role is None else role[0].removeprefix("plain-")

    return any(of(name) == what for name in names)


def sensor_column(cells: Mapping[str, Sequence[str]]) -> str | None:
    """The column whose cells name the sensor of each row, such as `acc` or `gyro`; None if there is none.

    Both sensors must be named, or one of them in a column whose name starts with "sensor".
    """
    for name, column in cells.items():
        words = [f"{word} x" for word in dict.fromkeys(column)]
        if len(words) <= MOST_SENSORS:
            named = [names_sensor(words, what) for what in ("accel", "gyro")]
            if all(named) or (any(named) and name.strip().lower().startswith("sensor")):
                return name
    return None


def _is_quaternion(x: str, names: Sequence[str]) -> bool:
    """Whether the column `x` is a component of a quaternion.

    A quaternion also has a column whose name differs only by the letter w in the place of x. The result is
    False if several columns have the name of the given column.
    """
    w = re.sub(r"x(?=[^x]*$)", "w", x.lower())
    return list(names).count(x) == 1 and any(name.lower() == w for name in names)


def _shared_start(names: Sequence[str]) -> str:
    """The common prefix of all names, up to a separator."""
    least, most = min(names, default=""), max(names, default="")
    end = next((i for i, (a, b) in enumerate(zip(least, most, strict=False)) if a != b), 0)
    return least[: max(least.rfind(mark, 0, end) for mark in "_./:") + 1]


def _has(groups: _Groups, what: str) -> bool:
    """Whether the columns of all three axes of the sensor `what` have been found."""
    return any(of.endswith(what) and len(found) == 3 for (of, _), found in groups.items())


def _sensors_by_unit(names: Sequence[str], described: Sequence[str], groups: _Groups) -> None:
    """Add a sensor that is identified only by the unit in its column names, such as AsX(°/s), to `groups`.

    This includes three columns of which only the first states sensor and unit, as in GoPro's telemetry
    without names of axes: `Gyroscope [rad/s]`, `1`, `2`.
    """
    for what in ("accel", "gyro"):
        if _has(groups, what):
            continue
        for at, (name, text) in enumerate(zip(names, described, strict=True)):
            bare, unit = split_unit(text)
            words = words_of(bare)
            if unit is None or unit[0] != what or is_of_other(words):
                continue
            if list(names[at + 1 : at + 3]) == ["1", "2"]:
                for axis, column in zip("xyz", names[at : at + 3], strict=True):
                    groups.setdefault((what, name), {})[axis] = (column, unit[1])
            ending = re.fullmatch(r"(.*?[a-z_ ])([XYZxyz])", bare.strip())
            if ending is not None:
                axis = ending[2].lower()
                groups.setdefault((what, f"unit {ending[1]}"), {}).setdefault(axis, (name, unit[1]))


def _index_axes(names: Sequence[str], described: Sequence[str], groups: _Groups) -> None:
    """Add sensors whose column names number the axes, such as gyroADC[0], gyroADC[1], gyroADC[2].

    Names without brackets, such as acc0, acc1, acc2, are also those of the three axes, unless there is an
    acc3.
    """
    low = {text.lower() for text in described}
    for name, text in zip(names, described, strict=True):
        match = re.search(r"^\s*(\w+)\[([012])\]", text)
        if match is None:
            plain = re.match(r"\s*([A-Za-z]+)_?([012])(?=\W|$)", text)
            if plain is None or any(f"{plain[1]}{mark}3".lower() in low for mark in ("", "_")):
                continue
            _, unit = split_unit(text)
            role = role_of(["x", *words_of(plain[1])], plain[1], unit)
            if role is not None and role[0] in ("accel", "gyro"):
                axis = "xyz"[int(plain[2])]
                groups.setdefault((role[0], plain[1]), {}).setdefault(axis, (name, unit[1] if unit else None))
            continue
        _, unit = split_unit(text.replace(match[0], match[1]))
        stem = match[1].lower()
        what = (
            "gyro"
            if stem in ("gyroadc", "gyro", "gyro_rad")
            else "accel"
            if stem in ("accsmooth", "acc", "accadc", "accelerometer_m_s2")
            else None
        )
        if what is not None:
            axis = "xyz"[int(match[2])]
            groups.setdefault((what, stem), {}).setdefault(axis, (name, unit[1] if unit else None))


def _stamp(names: Sequence[str]) -> tuple[str, str] | None:
    """The columns with the seconds and the nanoseconds of one time stamp, as in header.stamp of ROS."""
    pairs = []
    for seconds, nanoseconds in (("secs", "nsecs"), ("sec", "nanosec")):
        for name in names:
            # In a file with several time stamps, a source name follows: stamp_sec_imu, stamp_nanosec_imu.
            match = re.fullmatch(rf"((?:.*[._/])?){nanoseconds}((?:[._/].*)?)", name)
            if match is not None and f"{match[1]}{seconds}{match[2]}" in names:
                pairs.append((f"{match[1]}{seconds}{match[2]}", name))
    return min(pairs, key=lambda pair: len(NOT_TIME.intersection(words_of(pair[1]))), default=None)
