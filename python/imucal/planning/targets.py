"""The groups of parameters that a plan is judged by, and what is wished of them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from imucal.effects.effect import find
from imucal.errors import InputError
from imucal.units import units_of

if TYPE_CHECKING:
    from imucal.planning.plan import PlannedParameter

__all__ = ["GROUPS", "sigma_of", "targets_of", "worst_of"]

# The group is the start of its parameters' names; its SI unit.
GROUPS: Final = {
    "accel_sensitivity": "1",
    "accel_bias": "m/s^2",
    "gyro_sensitivity": "1",
    "gyro_bias": "rad/s",
}
NUMBER: Final = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def targets_of(given: Mapping[str, float | str], effects: Sequence[str]) -> dict[str, float]:
    """Wishes by group in SI units; InputError for a group or a unit that there is not."""
    wishes = {}
    for group, wish in given.items():
        if group in GROUPS:
            unit = GROUPS[group]
        elif group in effects:
            unit = find(group).parameters[0].unit
        else:
            raise InputError(
                f"targets has {group!r}: give {', '.join(GROUPS)}, or an effect that is in effects, too"
            )
        value = _value(group, wish, unit)
        if not 0 < value < math.inf:
            raise InputError(f"the target of {group} is {wish}: a positive number is needed")
        wishes[group] = value
    return wishes


def _is_of(name: str, group: str) -> bool:
    """Whether a parameter is one of a group: effects may have names that begin as those of a group do."""
    if group in GROUPS:
        return re.fullmatch(f"{group}_[xyz]+", name) is not None
    return name.startswith(f"{group}_")


def _value(group: str, wish: float | str, unit: str) -> float:
    if not isinstance(wish, str):
        return float(wish)
    match = NUMBER.fullmatch(wish)
    units = units_of(unit)
    if match is None or (match[2] or unit) not in units:
        raise InputError(f"the target of {group} is {wish!r}: give a number and one of {', '.join(units)}")
    return float(match[1]) * units[match[2] or unit]


def sigma_of(wishes: Mapping[str, float], parameters: Sequence[tuple[str, str]]) -> list[float]:
    """The wish for each parameter; infinite where there is none."""
    return [
        next((wish for group, wish in wishes.items() if _is_of(name, group)), math.inf)
        for name, _ in parameters
    ]


def worst_of(
    parameters: Sequence[PlannedParameter], effects: Sequence[str]
) -> dict[str, dict[str, Any] | None]:
    """The largest standard deviation of each group; None where one of them is not determined."""
    worst: dict[str, dict[str, Any] | None] = {}
    for group in (*GROUPS, *effects):
        members = [p for p in parameters if _is_of(p.name, group)]
        sizes = [p.std for p in members if p.std is not None]
        complete = members and len(sizes) == len(members)
        worst[group] = {"value": max(sizes), "unit": members[0].unit} if complete else None
    return worst
