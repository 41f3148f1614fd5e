"""The canonical column names, such as accel_x_g; `imucal.units` lists the units at their ends.

time_*          accel_{x,y,z}_*     gyro_{x,y,z}_*
temp_*          stand_{1,2,3}_*
"""

from __future__ import annotations

import re

from imucal.units import COLUMN_UNITS, TEMPERATURE_UNITS, TICKS_PER_S

__all__ = [
    "AXES",
    "NAMES",
    "RAW_TEMPERATURE",
    "SKIP",
    "is_canonical",
    "temperature_unit",
    "time_unit",
    "triad_part",
]

NAMES = (
    f"time_{{{','.join(TICKS_PER_S)}}}, accel_{{x,y,z}}_{{{','.join(COLUMN_UNITS['accel'])}}}, "
    f"gyro_{{x,y,z}}_{{{','.join(COLUMN_UNITS['gyro'])}}}, temp_{{{','.join(TEMPERATURE_UNITS)},lsb}}, "
    f"stand_{{1,2,3}}_{{{','.join(COLUMN_UNITS['stand'])}}}"
)
SKIP = ("-", "skip")
# Column with raw counts of a temperature sensor. It is an auxiliary input unless `temp_scale` is given.
RAW_TEMPERATURE = "temp_lsb"

AXES = {"accel": "xyz", "gyro": "xyz", "stand": "123"}
TRIAD_NAME = r"(?:(accel|gyro)_([xyz])|(stand)_([123]))_([a-z0-9]+)"


def is_canonical(name: str) -> bool:
    """Whether `name` is a canonical name; columns with other names become auxiliary inputs."""
    return (
        triad_part(name) is not None
        or time_unit(name) is not None
        or temperature_unit(name) is not None
        or name == RAW_TEMPERATURE
    )


def triad_part(name: str) -> tuple[str, str, str] | None:
    """("accel", "x", "mps2") for accel_x_mps2; None for a name that is not a triad column."""
    match = re.fullmatch(TRIAD_NAME, name)
    if match is None:
        return None
    triad, axis, unit = match[1] or match[3], match[2] or match[4], match[5]
    return (triad, axis, unit) if unit in COLUMN_UNITS[triad] else None


def time_unit(name: str) -> str | None:
    """The unit of a time column, such as us for time_us; None for any other column."""
    unit = name.removeprefix("time_")
    return unit if unit != name and unit in TICKS_PER_S else None


def temperature_unit(name: str) -> str | None:
    """The unit of a temperature column, such as k for temp_k; None for other columns and raw counts."""
    unit = name.removeprefix("temp_")
    return unit if unit != name and unit in TEMPERATURE_UNITS else None
