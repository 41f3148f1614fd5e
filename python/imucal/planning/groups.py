"""Groups of parameters. A plan reports, and can limit, the largest standard deviation in each group."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from imucal.effects.table import has_parameter

__all__ = ["GROUPS", "PlannedParameter", "Size", "is_of", "worst_of"]

# SI unit of the parameters in each group. The names of these parameters start with the name of the group.
GROUPS: Final = {
    "accel_sensitivity": "1",
    "accel_bias": "m/s^2",
    "gyro_sensitivity": "1",
    "gyro_bias": "rad/s",
}


@dataclass(frozen=True, slots=True)
class Size:
    """A standard deviation or the size of an effect, in an SI unit."""

    value: float
    unit: str


@dataclass(frozen=True)
class PlannedParameter:
    """Predicted standard deviation of a parameter, SI unit; None if the motion does not determine it."""

    name: str
    std: float | None
    unit: str


def is_of(name: str, group: str) -> bool:
    """Whether a parameter is in a group.

    It is not sufficient that the name of the parameter begins with the name of the group, because the name of
    an effect may also begin with the name of a group.
    """
    if group in GROUPS:
        return re.fullmatch(f"{group}_[xyz]+", name) is not None
    return has_parameter(group, name)


def worst_of(parameters: Sequence[PlannedParameter], effects: Sequence[str]) -> dict[str, Size | None]:
    """The largest standard deviation of each group; None if a parameter of the group is not determined."""
    worst: dict[str, Size | None] = {}
    for group in (*GROUPS, *effects):
        members = [p for p in parameters if is_of(p.name, group)]
        sizes = [p.std for p in members if p.std is not None]
        complete = members and len(sizes) == len(members)
        worst[group] = Size(max(sizes), members[0].unit) if complete else None
    return worst
