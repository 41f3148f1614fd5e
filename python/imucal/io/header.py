"""Interpretation of the column names of a text file.

The role of a column is inferred from the words of its name (`column_words`). Its unit is taken only from the
header, or from the documentation of the program if the header identifies the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from imucal.io.column_words import (
    NOT_TIME,
    is_counted,
    is_time,
    role_of,
    time_unit_in,
    without_gravity,
    words_of,
)
from imucal.io.layout import Layout
from imucal.io.programs import Program, program_of
from imucal.io.sensor_labels import may_name_sensors, sensor_of_label
from imucal.io.unit_words import split_unit, split_unread
from imucal.io.unusual_names import Groups, add_numbered_axes, add_sensors_by_unit, is_complete

__all__ = ["Header", "Triad", "header_of", "layout_header", "names_sensor", "sensor_column"]

# Descriptor of a quantity in column names of MicroStrain, such as `X Accel [x8004]`.
DESCRIPTOR: Final = r"\s*\[x[0-9A-Fa-f]{4}\]"
# Matches a multiple of a unit of time, as in `Time [10ms]`, `Timestamp (100 ns)` or `t (ms x10)`. No
# canonical name states such a unit.
_TIMES: Final = r"(?:[mnuµ]?s(?:ecs?)?|seconds?|(?:milli|micro|nano)(?:s|seconds?))"
MULTIPLE: Final = (
    rf"(?i)(?<![A-Za-z\d])(?!1 ?[a-zµ])(?:\d+/)?[\d.]+ ?{_TIMES}(?![A-Za-z])|"
    rf"(?<![A-Za-z]){_TIMES} ?[x*/·] ?\d+"
)


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


def header_of(
    names: Sequence[str], described: Sequence[str] | None = None, preamble: Sequence[str] = ()
) -> Header:
    """Infer the role (sensor, axis and unit) of each column from its name.

    described  the names, each with the unit from a line of units, if there is one
    preamble   lines before the header
    """
    described = names if described is None else described
    program = program_of(names, preamble)
    groups: Groups = {}
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
        member = name.lower().rpartition(".")[2]
        if program is not None and program.unused and member.startswith(program.unused):
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
    add_sensors_by_unit(names, described, groups)
    header = Header(times=times, stamp=stamp, temperature=temperature, program=program, unread=unread)
    if not is_complete(groups, "gyro"):
        add_numbered_axes(names, described, groups)
    # Triads without any unit in their names. Only these triads get the units in the manual of the program
    # that wrote the file.
    without_units = set()
    # If the name of a triad states that it includes gravity, the triad with the same name otherwise does not.
    # Browsers write both `accelerationIncludingGravity` and `acceleration`.
    bare_keys = {key: " ".join(without_gravity(key.split())) for _, key in groups}
    linear = {bare for key, bare in bare_keys.items() if bare != key}
    for (what, key), found in groups.items():
        if len(found) != 3:
            continue
        units = {found[axis][1] for axis in "xyz"}
        columns = (found["x"][0], found["y"][0], found["z"][0])
        if len(units - {None}) > 1:
            header.mixed.append(columns)
        unit_name = next(iter(units)) if len(units) == 1 else None
        if _is_quaternion(columns[0], names):
            continue
        if what == "accel" and key in linear:
            what = "linear"
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


def layout_header(layout: Layout) -> Header:
    """The role (sensor, axis and unit) of each column in the header of a text."""
    return header_of(layout.names or [], layout.described, layout.preamble)


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

    Both sensors must be named, or one of them in a column whose name starts with "sensor". If the names of
    the columns also name both sensors, each row may contain both, and the labels may be those of poses or
    movements. Then every label must be the word for a sensor, and no row may have samples of both.
    """
    header = header_of(list(cells))
    has_both = bool(header.accel and header.gyro) and not header.plain
    if has_both:
        first = [cells[header.accel[0].columns[0]], cells[header.gyro[0].columns[0]]]
        if all(column and all(cell.strip() for cell in column) for column in first):
            return None
    for name, column in cells.items():
        labels = [label for label in dict.fromkeys(column) if label.strip()]
        if not may_name_sensors(labels):
            continue
        sensors = set(map(sensor_of_label, labels))
        if has_both and ("" in sensors or any(len(label.strip()) == 1 for label in labels)):
            continue
        named = sensors & {"accel", "gyro"}
        if len(named) == 2 or (named and name.strip().lower().startswith("sensor")):
            return name
    return None


def _is_quaternion(x: str, names: Sequence[str]) -> bool:
    """Whether the column `x` is a component of a quaternion.

    A quaternion also has a column whose name differs only by the letter w in the place of x. The result is
    False if several columns have the name of the given column.
    """
    w = re.sub(r"x(?=[^x]*$)", "w", x.lower())
    return w != x.lower() and list(names).count(x) == 1 and any(name.lower() == w for name in names)


def _shared_start(names: Sequence[str]) -> str:
    """The common prefix of all names, up to a separator."""
    least, most = min(names, default=""), max(names, default="")
    end = next((i for i, (a, b) in enumerate(zip(least, most, strict=False)) if a != b), 0)
    return least[: max(least.rfind(mark, 0, end) for mark in "_./:") + 1]


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
