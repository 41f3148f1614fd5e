"""Temperature of a simulated unit: piecewise linear between knots, constant outside them."""

from __future__ import annotations

import csv
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray, as_rows
from imucal.document.source import open_file
from imucal.errors import FormatError, InputError
from imucal.units import TEMPERATURE_UNITS, to_degc

__all__ = ["Temperature"]

# Reference temperature of sensitivities and biases; temperature effects are relative to it.
REFERENCE_DEGC: Final = 25.0
ABSOLUTE_ZERO_DEGC: Final = -273.15
# An exponential warm-up is approximated by 50 line segments per time constant, over 12 time constants. The
# largest approximation error is 5e-5 of the temperature rise. After 12 time constants, the exponential is
# still below its final value by 6e-6 of the rise.
KNOTS_PER_CONSTANT: Final = 50
CONSTANTS: Final = 12
FORMS: Final = (
    "DEGC, warmup:START:END:TIME_CONSTANT_S, cycle:LOW:HIGH:DURATION_S, or a CSV file with time_s and "
    "temp_degc, temp_k or temp_degf"
)


@dataclass(frozen=True, eq=False)
class Temperature:
    """Temperature over time, linear between K knots at the increasing times `time_s` with `temp_degc`.

    With a single knot, the temperature is constant.

    Raises InputError for times that do not increase, and for missing or impossible temperatures.
    """

    time_s: FloatArray
    temp_degc: FloatArray

    def __post_init__(self) -> None:
        time_s = as_rows(self.time_s, "time_s of the temperature")
        temp_degc = as_rows(self.temp_degc, "temp_degc", None, len(time_s))
        if len(time_s) == 0:
            raise InputError("the temperature has no knots: give one or more")
        if not (np.isfinite(time_s).all() and (np.diff(time_s) > 0).all()):
            raise InputError(
                "time_s of the temperature must increase: sort the rows, and remove rows with equal times"
            )
        if not (np.isfinite(temp_degc).all() and (temp_degc > ABSOLUTE_ZERO_DEGC).all()):
            raise InputError("temp_degc contains a number that is not a possible temperature: give degC")
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "temp_degc", temp_degc)

    @staticmethod
    def constant(temp_degc: float) -> Temperature:
        """A constant temperature."""
        return Temperature(_row(0.0), _row(temp_degc))

    @staticmethod
    def warm_up(start_degc: float, end_degc: float, time_constant_s: float) -> Temperature:
        """A unit that warms up: end + (start - end) exp(-t / time_constant)."""
        if not (math.isfinite(time_constant_s) and time_constant_s > 0):
            raise InputError(
                f"the time constant of the warm-up is {time_constant_s} s: a positive one is needed"
            )
        share = np.linspace(0.0, CONSTANTS, CONSTANTS * KNOTS_PER_CONSTANT + 1)
        return Temperature(share * time_constant_s, end_degc + (start_degc - end_degc) * np.exp(-share))

    @staticmethod
    def cycle(low_degc: float, high_degc: float, duration_s: float) -> Temperature:
        """Heating from low to high in the first half of the duration, and cooling in the second half."""
        if not (math.isfinite(duration_s) and duration_s > 0):
            raise InputError(f"the heat-cool cycle takes {duration_s} s: a positive time is needed")
        return Temperature(_row(0.0, duration_s / 2.0, duration_s), _row(low_degc, high_degc, low_degc))

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Temperature:
        """Read a CSV file with the columns time_s and temp_degc (or temp_k, temp_degf).

        Raises FormatError if it is invalid.
        """
        file = open_file(path)
        try:
            rows = list(csv.DictReader(io.StringIO(file.content.decode("utf-8-sig"))))
            given = [unit for unit in TEMPERATURE_UNITS if rows and f"temp_{unit}" in rows[0]]
            unit = given[0] if len(given) == 1 else "degc"
            knots = [(float(row["time_s"]), float(row[f"temp_{unit}"])) for row in rows]
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise FormatError(
                f"{file.name}: {error}: a CSV file with the columns time_s,temp_degc (or temp_k, temp_degf) "
                "and numbers is needed"
            ) from None
        try:
            temperature = to_degc(_row(*(knot[1] for knot in knots)), TEMPERATURE_UNITS[unit])
            return Temperature(_row(*(knot[0] for knot in knots)), temperature)
        except InputError as error:
            raise FormatError(f"{file.name}: {error}") from None


def temperature_of(given: Temperature | float | str | os.PathLike[str]) -> Temperature:
    """The temperature for an argument: a Temperature, a number, `warmup:...`, `cycle:...`, or a CSV file."""
    if isinstance(given, Temperature):
        return given
    if isinstance(given, (int, float)):
        return Temperature.constant(float(given))
    text = os.fspath(given)
    kind, _, numbers = text.partition(":")
    forms = {"warmup": Temperature.warm_up, "cycle": Temperature.cycle}
    try:
        if kind in forms and numbers:
            first, second, third = map(float, numbers.split(":"))
            return forms[kind](first, second, third)
        return Temperature.constant(float(text))
    except ValueError as error:
        # InputError is also a ValueError. Its message already explains the cause, so it is raised unchanged.
        if isinstance(error, InputError):
            raise
    if kind in forms or not Path(text).exists():
        raise InputError(f"the temperature {text!r} is not understood: give {FORMS}")
    return Temperature.read(text)


def _row(*values: ArrayLike) -> FloatArray:
    return np.array(values, dtype=np.float64)
