"""Reads parameter files of autopilots, and converts their thermal terms to offsets and effects."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.effects.effect import EffectValues
from imucal.effects.formula_effect import FormulaEffect
from imucal.errors import FormatError
from imucal.exporting.autopilot import THERMAL
from imucal.importing.source_format import Content

__all__ = ["AXES", "Cubic", "Parameters", "Thermal", "has_parameters"]

AXES: Final = "XYZ"
# Prefixes of the names of calibration parameters in PX4 and ArduPilot.
PREFIXES: Final = ("CAL_ACC", "CAL_GYRO", "INS_ACC", "INS_GYR", "INS_TCAL")
# Matches one parameter: NAME,VALUE or NAME=VALUE or NAME VALUE. The numbers of vehicle and component, or
# `param set`, may precede the name. A line of `param show` also matches: x + NAME [12,34] : VALUE.
LINE: Final = re.compile(
    r"^\s*(?:(?:\d+\s+\d+|param\s+set|x?\s*[+*]?)\s+)?([A-Z][A-Z0-9_]{2,16})"
    r"(?:\s*\[[\d,]+\]\s*:\s*|\s*[,=\t]\s*|\s+)([-+]?[\w.+-]+)"
)


def has_parameters(text: str, prefixes: tuple[str, ...] = PREFIXES) -> bool:
    """Whether a text has parameters of an autopilot whose names start with one of the prefixes."""
    return any(name.startswith(prefixes) for name in names_in(text))


def names_in(text: str) -> set[str]:
    """The names of all parameters in a text."""
    return {match[1] for match in map(LINE.match, text.splitlines()) if match}


@dataclass(frozen=True)
class Parameters:
    """The parameters of a file by name, with their values as text.

    Raises FormatError if a parameter has two different values.
    """

    file: str
    values: dict[str, str]

    @staticmethod
    def of(content: Content) -> Parameters:
        """The parameters in a file."""
        found: dict[str, str] = {}
        for match in map(LINE.match, content.text.splitlines()):
            if match is None:
                continue
            name, value = match.groups()
            if found.setdefault(name, value) != value:
                raise FormatError(f"{content.name}: {name} is {found[name]} and {value}: keep one of them")
        return Parameters(content.name, found)

    def number(self, name: str, default: float | None = None) -> float:
        """A parameter as a finite number. Raises FormatError if it is missing and has no default."""
        if name not in self.values:
            if default is not None:
                return default
            raise FormatError(
                f"{self.file}: the parameter {name} is missing: save all parameters of the vehicle again"
            )
        try:
            value = float(self.values[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise FormatError(f"{self.file}: {name} is {self.values[name]!r}: a finite number is needed")
        return value

    def vector(self, name: str, axes: Sequence[str] = AXES, default: float | None = None) -> FloatArray:
        """Three parameters, one per axis; `{}` in the name is replaced by the letter of the axis."""
        return np.array([self.number(name.format(axis), default) for axis in axes])

    def scale(self, name: str) -> FloatArray:
        """Three scale factors, one per axis.

        Raises FormatError if a factor is not positive, as in an autopilot that was never calibrated.
        """
        scale = self.vector(name)
        for axis, value in zip(AXES, scale, strict=True):
            if value <= 0:
                raise FormatError(
                    f"{self.file}: {name.format(axis)} is {value:g}: the sensor is not calibrated"
                )
        return scale


@dataclass(frozen=True, eq=False)
class Cubic:
    """A thermal offset of a sensor, raw units: the sum of coefficients[k] (T - reference_degc)^k, k = 0 to 3.

    coefficients    (4, 3)
    reference_degc  reference temperature in this polynomial
    range_degc      T is clamped to this range
    """

    coefficients: FloatArray
    reference_degc: float
    range_degc: tuple[float, float]

    def at(self, temperature_degc: float) -> FloatArray:
        """The offset at a temperature. The temperature is clamped to the range of the polynomial."""
        held = min(max(temperature_degc, self.range_degc[0]), self.range_degc[1])
        powers = (held - self.reference_degc) ** np.arange(4)
        offset: FloatArray = powers @ self.coefficients
        return offset

    def about(self, reference_degc: float) -> FloatArray:
        """Coefficients (4, 3) of the polynomial as a function of T - reference_degc, without clamping T."""
        shift = reference_degc - self.reference_degc
        a, b, c, d = self.coefficients
        return np.array(
            [
                a + (b + (c + d * shift) * shift) * shift,
                b + (2 * c + 3 * d * shift) * shift,
                c + 3 * d * shift,
                d,
            ]
        )

    def effect(self, sensor: str, scale: FloatArray) -> Thermal:
        """The polynomial as an offset and an effect.

        sensor   "accel" or "gyro"
        scale    corrected / raw of each axis

        Without cubic terms, the effect is the temperature effect of the catalogue, relative to the reference
        temperature of imucal. With cubic terms, the effect is a formula, which also clamps the temperature to
        the range.
        """
        constant, linear, square, cubic = self.about(_core.REFERENCE_TEMPERATURE_DEGC)
        if not cubic.any():
            values = np.concatenate((scale * linear, scale * square))
            return Thermal(constant, EffectValues(THERMAL[sensor], values), None)
        low, high = self.range_degc
        x = f"(min(max(temp_degc, {low!r}), {high!r}) - {self.reference_degc!r})"
        name = f"{THERMAL[sensor]}_cubic"
        definition = FormulaEffect.of(f"{sensor}: k1 * {x} + k2 * {x}**2 + k3 * {x}**3", name=name)
        return Thermal(
            self.coefficients[0],
            EffectValues(name, (scale * self.coefficients[1:]).ravel()),
            definition,
        )


@dataclass(frozen=True, eq=False)
class Thermal:
    """The thermal terms of a sensor.

    offset      constant part, raw units
    effect      temperature-dependent part, with its values
    definition  definition of the effect if it is not in the catalogue, else None
    """

    offset: FloatArray
    effect: EffectValues
    definition: FormulaEffect | None
