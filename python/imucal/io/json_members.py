"""The members of JSON objects: the cells of a sample, and the members that describe the samples."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final, TypeAlias

from imucal.io.column_words import is_time, words_of
from imucal.io.names import is_canonical

__all__ = ["AXES", "IDENTITY", "TYPE", "UNIT", "Row", "described_by", "flat", "is_cell"]

# The cells of one object by column name.
Row: TypeAlias = dict[str, Any]
AXES: Final = "xyz"
# Matches the name of a member that identifies the device or the session of the samples.
IDENTITY: Final = re.compile(
    r"(?i)(?:^|[._ ])(device|session|serial|mac|node|board|imu|client|phone|watch)"
    r"([._ ]?(id|name|no|nr|num|number|uuid|uid|address|addr|serial))?$"
)
# Matches the name of a member that may name the sensor of an object.
TYPE: Final = re.compile(
    r"(?i)(?:^|[._ ])(sensor|type|kind|source|channel|topic|stream|name)([._ ]?(id|type|name))?$"
)
# Matches the name of a member that states a unit.
UNIT: Final = re.compile(r"(?:(?:^|[._ ])[Uu]|(?<=[a-z])U)nits?$|(?:^|[._ ])UNITS?$")


def is_cell(value: Any) -> bool:
    """Whether a value is a number, a text, or missing."""
    return value is None or isinstance(value, (str, int, float))


def flat(value: Mapping[str, Any], outer: str = "") -> Row:
    """The cells of an object; the names of members of members are joined by points.

    A list of three numbers is three cells, unless its name is already that of one axis. Other lists stay
    lists, and lists of objects are left out.
    """
    row: Row = {}
    for key, own in value.items():
        name = f"{outer}{key}"
        if isinstance(own, dict):
            row |= flat(own, f"{name}.")
        elif isinstance(own, bool):
            row[name] = int(own)
        elif is_cell(own):
            row[name] = own
        elif len(own) == len(AXES) and all(map(is_cell, own)) and not _is_axis(key):
            row |= {f"{name}.{axis}": number for axis, number in zip(AXES, own, strict=True)}
        elif own and not isinstance(own[0], dict):
            row[name] = own
    return row


@lru_cache(maxsize=1024)
def _is_axis(name: str) -> bool:
    return is_canonical(name) or name[-1:].lower() in tuple(AXES)


def described_by(value: Mapping[str, Any]) -> Row:
    """The members of an object that describe the samples in it: their device, sensor, or unit."""
    row: Row = {}
    for key, own in value.items():
        members = flat(own, f"{key}.") if isinstance(own, dict) and IDENTITY.search(key) else {key: own}
        for name, cell in members.items():
            is_code = isinstance(cell, int) and (IDENTITY.search(name) or TYPE.search(name))
            if is_code or (isinstance(cell, str) and not is_time(words_of(name), None)):
                row[name] = cell
    return row
