"""Conversion of sizes of effects to the units of datasheets."""

from __future__ import annotations

from typing import Final

from imucal.units import SHOWN

__all__ = ["for_people", "p_text"]

# Times up to this limit, in seconds, are shown in ms, and longer times in s.
DELAY_S: Final = 0.1
# For a smaller probability, a text states only that it is below this bound.
LEAST_P: Final = 1e-12


def p_text(p_value: float) -> str:
    """A probability as text; for a value near the rounding error of its computation, only an upper bound."""
    return f"p {p_value:.2g}" if p_value > LEAST_P else f"p below {LEAST_P:g}"


def for_people(value: float, unit: str) -> tuple[float, str]:
    """A value converted from SI to the unit of datasheets, and the name of the unit."""
    if unit == "s":
        return (1e3 * value, "ms") if abs(value) < DELAY_S else (value, "s")
    factor, name = SHOWN.get(unit, (1.0, unit))
    return factor * value, name
