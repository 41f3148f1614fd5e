"""Targets: largest permitted standard deviations of groups of parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

from imucal.effects.table import find
from imucal.errors import InputError
from imucal.planning.groups import GROUPS, is_of
from imucal.units import units_of

__all__ = ["sigma_of", "targets_of"]

NUMBER: Final = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def targets_of(given: Mapping[str, float | str], effects: Sequence[str]) -> dict[str, float]:
    """Targets by group in SI units. Raises InputError for an unknown group or unit."""
    targets = {}
    for group, target in given.items():
        if group in GROUPS:
            unit = GROUPS[group]
        elif group in effects:
            unit = find(group).parameters[0].unit
        else:
            raise InputError(
                f"targets has {group!r}: give {', '.join(GROUPS)}, or an effect that `effects` also names"
            )
        value = _value(group, target, unit)
        if not 0 < value < math.inf:
            raise InputError(f"the target of {group} is {target}: a positive number is needed")
        targets[group] = value
    return targets


def _value(group: str, target: float | str, unit: str) -> float:
    if not isinstance(target, str):
        return float(target)
    match = NUMBER.fullmatch(target)
    units = units_of(unit)
    if match is None or (match[2] or unit) not in units:
        raise InputError(f"the target of {group} is {target!r}: give a number and one of {', '.join(units)}")
    return float(match[1]) * units[match[2] or unit]


def sigma_of(targets: Mapping[str, float], parameters: Sequence[tuple[str, str]]) -> list[float]:
    """The target of each parameter; infinite for a parameter without a target."""
    return [
        next((target for group, target in targets.items() if is_of(name, group)), math.inf)
        for name, _ in parameters
    ]
