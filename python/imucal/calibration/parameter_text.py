"""Rows of a table of parameters: value and standard deviation in the units of datasheets or in SI units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

from imucal.calibration.triad import Parameter
from imucal.units import Scale, datasheet

__all__ = ["ParameterRow", "Units", "difference_text", "parameter_row", "sigma_text"]

# Function that returns the unit and scale in which a table shows a parameter, given its name and SI unit. It
# is `datasheet` or `si` of imucal.units.
Units: TypeAlias = Callable[[str, str], Scale]
# Number of significant digits of a printed standard deviation. The value of the parameter is printed with the
# same number of decimals. Further digits would not be reproducible, because rounding errors depend on the
# processor and change the result of a fit by a small part of the standard deviations.
SIGMA_DIGITS: Final = 2
# Number of significant digits of a printed value without a standard deviation.
VALUE_DIGITS: Final = 7
# A value is printed without an exponent if its standard deviation, in the printed unit, is in this range.
PLAIN: Final = (1e-6, 1e6)


class ParameterRow(NamedTuple):
    """A parameter as text.

    A diagonal entry of a sensitivity may be shown as its difference from 1. Its name then ends in " - 1".
    """

    name: str
    value: str
    sigma: str
    unit: str


def parameter_row(parameter: Parameter, units: Units = datasheet) -> ParameterRow:
    """The table row of a parameter. The value has as many decimals as the standard deviation."""
    scale = units(parameter.name, parameter.unit)
    value = scale.shown(parameter.value)
    std = None if parameter.std is None else scale.factor * parameter.std
    sigma = "-" if std is None else sigma_text(std)
    return ParameterRow(scale.named(parameter.name), difference_text(value, std), sigma, scale.unit)


def sigma_text(std: float) -> str:
    """Format a standard deviation with two significant digits."""
    decimals = _decimals(std)
    return f"{std:.{SIGMA_DIGITS - 1}e}" if decimals is None else f"{std:.{decimals}f}"


def difference_text(value: float, std: float | None) -> str:
    """Format a value with as many decimals as its standard deviation `std` has."""
    decimals = None if std is None else _decimals(std)
    return f"{value:.{VALUE_DIGITS}g}" if decimals is None else f"{value:.{decimals}f}"


def _decimals(std: float) -> int | None:
    """Number of decimals of a standard deviation, or None if it is written with an exponent."""
    if not PLAIN[0] <= std < PLAIN[1]:
        return None
    return max(0, SIGMA_DIGITS - 1 - math.floor(math.log10(std)))
