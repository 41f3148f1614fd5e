"""Conversion of sizes of effects to the units of datasheets."""

from __future__ import annotations

import re
from typing import Final

from imucal.effects.formula import INPUTS
from imucal.units import SHOWN

__all__ = ["for_people", "p_text"]

# Times up to this limit, in seconds, are shown in ms, and longer times in s.
DELAY_S: Final = 0.1
# A p-value smaller than this bound is shown only as "p below 1e-12".
LEAST_P: Final = 1e-12
# Unit of a parameter that multiplies an auxiliary column, such as rad/s/(supply_v - 3.3) or m/s^2/motor.
PER_COLUMN: Final = re.compile(r"(?P<of>rad/s|m/s\^2)/\(?(?P<column>[A-Za-z_]\w*)(?: [-+] [\d.e+-]+\))?")


def p_text(p_value: float) -> str:
    """A p-value as text, such as "p 0.013"; below `LEAST_P`, near its rounding error, only this bound."""
    return f"p {p_value:.2g}" if p_value > LEAST_P else f"p below {LEAST_P:g}"


def for_people(value: float, unit: str) -> tuple[float, str]:
    """A value converted from SI to the unit of datasheets, and the name of the unit."""
    if unit == "s":
        return (1e3 * value, "ms") if abs(value) < DELAY_S else (value, "s")
    of_column = PER_COLUMN.fullmatch(unit)
    # Inputs of formulas that are not columns, such as w_norm (norm of the angular rate), are in SI units.
    # Parameters that multiply these inputs are therefore shown in SI units, too.
    if of_column is not None and unit not in SHOWN and of_column["column"] not in INPUTS:
        factor, name = SHOWN[of_column["of"]]
        return factor * value, f"{name} per {of_column['column']}"
    factor, name = SHOWN.get(unit, (1.0, unit))
    return factor * value, name
