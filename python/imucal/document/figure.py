"""A number with a unit, such as a datasheet gives, and its conversion to SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.json_document import Node
from imucal.errors import FormatError
from imucal.units import COUNTS, units_of

__all__ = ["Figure"]


@dataclass(frozen=True, eq=False)
class Figure:
    """A number, or an array of numbers, with its unit."""

    value: float | FloatArray
    unit: str

    @staticmethod
    def optional(
        node: Node, name: str, si_unit: str, shape: tuple[int, ...] = (), *, per_axis: bool = False
    ) -> Any:
        """The field `name` in SI units: a float or an array of `shape`; None if null or missing.

        per_axis  also accept a list of three numbers, one per axis

        Raises FormatError with the name of the field for any other value and for a unit of another quantity.
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
