"""A figure with its unit, as datasheets print it, and its value in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.json_document import Node
from imucal.errors import FormatError
from imucal.recording.recording import STANDARD_GRAVITY_MPS2

__all__ = ["Figure", "units_of"]

_G: Final = STANDARD_GRAVITY_MPS2
_DEG: Final = math.pi / 180.0

# SI unit -> the units in which a figure of it may be given, and how many SI units one of them is.
UNITS: Final[dict[str, dict[str, float]]] = {
    "1": {"1": 1.0, "%": 1e-2, "ppm": 1e-6, "rad": 1.0, "deg": _DEG},
    "bit": {"bit": 1.0},
    "Hz": {"Hz": 1.0},
    "m/s^2": {"m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G, "ug": 1e-6 * _G},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEG, "deg/h": _DEG / 3600.0},
    "m/s^2/sqrt(Hz)": {"m/s^2/sqrt(Hz)": 1.0, "mg/sqrt(Hz)": 1e-3 * _G, "ug/sqrt(Hz)": 1e-6 * _G},
    "rad/s/sqrt(Hz)": {"rad/s/sqrt(Hz)": 1.0, "deg/s/sqrt(Hz)": _DEG, "mdeg/s/sqrt(Hz)": 1e-3 * _DEG},
    "m/s^2/s/sqrt(Hz)": {"m/s^2/s/sqrt(Hz)": 1.0},
    "rad/s/s/sqrt(Hz)": {"rad/s/s/sqrt(Hz)": 1.0},
    "m/s^2/lsb": {"m/s^2/lsb": 1.0, "mg/lsb": 1e-3 * _G},
    "rad/s/lsb": {"rad/s/lsb": 1.0, "deg/s/lsb": _DEG, "mdeg/s/lsb": 1e-3 * _DEG},
    "1/K": {"1/K": 1.0, "%/K": 1e-2, "ppm/K": 1e-6},
    "m/s^2/K": {"m/s^2/K": 1.0, "mg/K": 1e-3 * _G},
    "rad/s/K": {"rad/s/K": 1.0, "deg/s/K": _DEG},
    "rad/s/(m/s^2)": {"rad/s/(m/s^2)": 1.0, "deg/s/g": _DEG / _G},
    "rad/s/(m/s^2)^2": {"rad/s/(m/s^2)^2": 1.0, "deg/s/g^2": _DEG / _G**2},
}
# The same the other way round: counts per unit.
COUNTS: Final[dict[str, dict[str, float]]] = {
    "m/s^2/lsb": {"lsb/g": _G},
    "rad/s/lsb": {"lsb/(deg/s)": _DEG},
}


def units_of(si_unit: str) -> dict[str, float]:
    """The units in which a figure of this SI unit may be given, and how many SI units one of them is."""
    return UNITS.get(si_unit, {si_unit: 1.0})


@dataclass(frozen=True, eq=False)
class Figure:
    """A number, or an array of numbers, with its unit."""

    value: float | FloatArray
    unit: str

    @staticmethod
    def optional(
        node: Node, name: str, si_unit: str, shape: tuple[int, ...] = (), *, per_axis: bool = False
    ) -> Any:
        """The field `name` in SI units: a float, or an array of `shape`; None if it is null or not there.

        per_axis  a list of three numbers may stand for one number

        Raises FormatError, naming the field, for anything else and for a unit of another kind.
        """
        if node.mapping().get(name) is None:
            return None
        figure = node.get(name)
        value, unit = figure.get("value"), figure.get("unit").text()
        if per_axis and isinstance(value.value, list):
            shape = (3,)
        number = value.array(*shape) if shape else value.number()
        units = units_of(si_unit)
        if unit in units:
            return number * units[unit]
        if unit in COUNTS.get(si_unit, {}):
            if np.any(np.asarray(number) == 0):
                raise FormatError(f"{value.file}: {value.path} is 0 {unit}: another number is needed")
            return COUNTS[si_unit][unit] / number
        known = (*units, *COUNTS.get(si_unit, {}))
        raise FormatError(f"{figure.file}: {figure.path}.unit is {unit!r}: give one of {', '.join(known)}")
