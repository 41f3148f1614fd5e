"""The tables of all units that imucal reads or shows, with their conversion to SI units.

value in SI units = value in the unit * UNITS[si_unit][unit]
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "COLUMN_UNITS",
    "COUNTS",
    "DEGREE_RAD",
    "SHOWN",
    "STANDARD_GRAVITY_MPS2",
    "TEMPERATURE_UNITS",
    "TICKS_PER_S",
    "UNITS",
    "UNIT_TEXT",
    "Scale",
    "datasheet",
    "si",
    "significant",
    "to_degc",
    "units_of",
]

# The unit g of datasheets, m/s^2: the conventional value of the 3rd CGPM (1901), exact by definition.
STANDARD_GRAVITY_MPS2: Final = 9.80665
DEGREE_RAD: Final = math.pi / 180.0

_G: Final = STANDARD_GRAVITY_MPS2
_DEG: Final = DEGREE_RAD

# For each SI unit, the units that files and options may use for a quantity. Each number is the size of the
# unit in the SI unit.
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
# Units of a sensitivity in counts, such as lsb/(deg/s). The outer key is the SI unit of the reciprocal of the
# sensitivity (the size of one count), such as rad/s/lsb. The number is the size of the denominator of the
# unit (here deg/s) in SI units.
COUNTS: Final[dict[str, dict[str, float]]] = {
    "m/s^2/lsb": {"lsb/g": _G},
    "rad/s/lsb": {"lsb/(deg/s)": _DEG},
}
# For each sensor, the suffixes of column names that state a unit (mg in accel_x_mg), each with the size of
# this unit in SI units. Counts (lsb) are not converted. cm/s^2 is also called Gal. A full circle has 400 gon.
COLUMN_UNITS: Final[dict[str, dict[str, float]]] = {
    "accel": {
        **{"mps2": 1.0, "cmps2": 1e-2, "mmps2": 1e-3, "ftps2": 0.3048},
        **{"g": _G, "mg": _G / 1000.0, "ug": _G / 1e6, "lsb": 1.0},
    },
    "gyro": {
        **{"radps": 1.0, "mradps": 1e-3, "dps": _DEG, "mdps": _DEG / 1000.0},
        **{"dpmin": _DEG / 60.0, "dph": _DEG / 3600.0, "rpm": 6.0 * _DEG, "gonps": 0.9 * _DEG, "lsb": 1.0},
    },
    "stand": {"rad": 1.0, "deg": _DEG},
}
# For each suffix of a sensor column, the unit as options and messages write it.
UNIT_TEXT: Final[dict[str, str]] = {
    **{"mps2": "m/s^2", "cmps2": "cm/s^2", "mmps2": "mm/s^2", "ftps2": "ft/s^2"},
    **{"g": "g", "mg": "mg", "ug": "ug", "lsb": "lsb"},
    **{"radps": "rad/s", "mradps": "mrad/s", "dps": "deg/s", "mdps": "mdeg/s"},
    **{"dpmin": "deg/min", "dph": "deg/h", "rpm": "rpm", "gonps": "gon/s"},
}
# Suffixes of temperature columns, such as temp_k, each with two numbers: the size of the unit in degC, and
# the temperature in degC at which a reading in this unit is zero. Raw counts (temp_lsb) are converted with
# the slope and offset of their sensor (`temp_scale`).
TEMPERATURE_UNITS: Final[dict[str, tuple[float, float]]] = {
    "degc": (1.0, 0.0),
    "k": (1.0, -273.15),
    "degf": (1.0 / 1.8, -32.0 / 1.8),
}
# Suffixes of time columns, such as time_us, each with the number of ticks of this unit in one second.
TICKS_PER_S: Final[dict[str, float]] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
# For each SI unit, the unit in which summaries and pages show an effect or a residual, as (factor, unit); the
# shown value is the factor times the SI value. The unit is chosen so that typical values of MEMS sensors are
# of the order of one.
SHOWN: Final[dict[str, tuple[float, str]]] = {
    "rad": (1.0 / _DEG, "deg"),
    "rad/s": (1.0 / _DEG, "deg/s"),
    "rad/s/s": (100.0 / _DEG, "deg/s per 100 s"),
    "rad/s/K": (1.0 / _DEG, "deg/s per K"),
    "rad/s/K^2": (1.0 / _DEG, "deg/s per K^2"),
    "rad/s/K^3": (1.0 / _DEG, "deg/s per K^3"),
    "rad/s/(K/s)": (1.0 / (60.0 * _DEG), "deg/s per K/min"),
    "rad/s/(m/s^2)": (_G / _DEG, "deg/s per g"),
    "rad/s/(m/s^2)^2": (_G**2 / _DEG, "deg/s per g^2"),
    "m/s^2": (1e3 / _G, "mg"),
    "m/s^2/s": (1e5 / _G, "mg per 100 s"),
    "m/s^2/K": (1e3 / _G, "mg per K"),
    "m/s^2/K^2": (1e3 / _G, "mg per K^2"),
    "m/s^2/K^3": (1e3 / _G, "mg per K^3"),
    "m/s^2/(K/s)": (1e3 / (60.0 * _G), "mg per K/min"),
    "1": (1e2, "%"),
    "1/s": (1e8, "ppm per 100 s"),
    "1/K": (1e6, "ppm per K"),
    "1/(m/s^2)": (1e2 * _G, "% per g"),
    "1/(m/s^2)^2": (1e2 * _G**2, "% per g^2"),
    "s/rad": (1e4 * _DEG, "% per 100 deg/s"),
    "s^2/rad^2": (1e6 * _DEG**2, "% per (100 deg/s)^2"),
    "m": (1e3, "mm"),
}
# For each SI unit, the unit in which tables show a value, as (factor, unit). It is the unit of datasheets.
DATASHEET: Final[dict[str, tuple[float, str]]] = {
    **SHOWN,
    "lsb/(m/s^2)": (_G, "lsb/g"),
    "lsb/(rad/s)": (_DEG, "lsb/(deg/s)"),
    "rad/s/sqrt(Hz)": (60.0 / _DEG, "deg/sqrt(h)"),
    "m/s^2/sqrt(Hz)": (1e6 / _G, "ug/sqrt(Hz)"),
    "rad/s/s/sqrt(Hz)": (3600.0 * 60.0 / _DEG, "deg/h/sqrt(h)"),
    "m/s^2/s/sqrt(Hz)": (1e6 * 60.0 / _G, "ug/sqrt(h)"),
}
# Matches the names of the entries of a sensitivity matrix. Tables show these entries in ppm (diagonal) and in
# mrad (off-diagonal), unlike other dimensionless parameters.
_SENSITIVITY: Final = re.compile(r"(?:accel|gyro)_sensitivity_([xyz])([xyz])")
_DIAGONAL: Final = (1e6, "ppm")
_OFF_DIAGONAL: Final = (1e3, "mrad")
# Units in which the bias instability is shown. They are smaller than the units of a bias (deg/s and mg).
_INSTABILITY: Final = {"rad/s": (3600.0 / _DEG, "deg/h"), "m/s^2": (1e6 / _G, "ug")}


class Scale(NamedTuple):
    """The unit in which a table shows a quantity: shown value = factor (SI value - zero)."""

    factor: float
    unit: str
    zero: float = 0.0

    def shown(self, value: float) -> float:
        """The SI value `value` in the unit of the table."""
        return self.factor * (value - self.zero)

    def named(self, name: str) -> str:
        """The name of the quantity in a table, such as `accel_sensitivity_xx - 1` for a difference from 1."""
        return f"{name} - {self.zero:g}" if self.zero else name


def significant(value: float, digits: int) -> str:
    """`value` as text with `digits` significant digits, such as 1220; no exponent from 1e-4 to 1e10."""
    return f"{float(f'{value:.{digits}g}'):.10g}"


def si(name: str, unit: str) -> Scale:
    """The Scale that shows a parameter unchanged, in its SI unit `unit`; `name` has no effect."""
    return Scale(1.0, unit)


def datasheet(name: str, unit: str) -> Scale:
    """The Scale that shows a parameter in the unit that datasheets use.

    name   the parameter; the diagonal of a sensitivity in SI units is shown as its difference from 1
    unit   unit of the parameter: an SI unit, or a unit with counts (lsb)
    """
    entry = _SENSITIVITY.fullmatch(name)
    if entry is not None and unit == "1":
        return Scale(*_DIAGONAL, zero=1.0) if entry[1] == entry[2] else Scale(*_OFF_DIAGONAL)
    if name.endswith("bias_instability"):
        return Scale(*_INSTABILITY.get(unit, (1.0, unit)))
    return Scale(*DATASHEET.get(unit, (1.0, unit)))


def units_of(si_unit: str) -> dict[str, float]:
    """The units in which a quantity with this SI unit may be given, each with its size in the SI unit."""
    return UNITS.get(si_unit, {si_unit: 1.0})


def to_degc(values: NDArray[Any], scale: tuple[float, float]) -> NDArray[Any]:
    """Temperatures in degC: slope * values + offset, with scale = (slope, offset).

    Values that are already in degC have the slope 1 and the offset 0. They are returned unchanged.
    """
    slope, offset = scale
    return values if scale == (1.0, 0.0) else slope * values + offset
