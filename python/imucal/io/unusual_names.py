"""Sensors in a header whose column names do not name the sensor or the axes in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

from imucal.io.column_words import is_of_other, role_of, words_of
from imucal.io.unit_words import split_unit

__all__ = ["Groups", "add_numbered_axes", "add_sensors_by_unit", "is_complete"]

# Columns grouped by quantity ("accel", ...) and by the part of their names that does not depend on the axis.
# A group maps each axis to the name of its column and the unit of this column, or None for an unknown unit.
Groups: TypeAlias = dict[tuple[str, str], dict[str, tuple[str, str | None]]]


def is_complete(groups: Groups, what: str) -> bool:
    """Whether the columns of all three axes of the sensor `what` have been found."""
    return any(of.endswith(what) and len(found) == 3 for (of, _), found in groups.items())


def add_sensors_by_unit(names: Sequence[str], described: Sequence[str], groups: Groups) -> None:
    """Add a sensor that is identified only by the unit in its column names, such as AsX(°/s), to `groups`.

    This includes three columns of which only the first states sensor and unit, as in GoPro's telemetry
    without names of axes: `Gyroscope [rad/s]`, `1`, `2`.
    """
    for what in ("accel", "gyro"):
        if is_complete(groups, what):
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


def add_numbered_axes(names: Sequence[str], described: Sequence[str], groups: Groups) -> None:
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
