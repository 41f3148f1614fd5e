"""Classes that describe how a calibration file of another program is recognised and read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.document.source import Source
from imucal.effects.effect import EffectValues
from imucal.effects.formula_effect import FormulaEffect

__all__ = ["Content", "Found", "Reader", "Wanted"]


@dataclass(frozen=True)
class Content:
    """The contents of one file.

    name      the path as it was given
    text      the text of the file; empty for a binary file
    document  the root of a JSON or YAML document; None for other text
    source    the path and the hash
    data      the bytes of the file
    """

    name: str
    text: str
    document: Node | None
    source: Source
    data: bytes

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of the JSON or YAML document; empty if the file contains no object with fields."""
        value = None if self.document is None else self.document.value
        return value if isinstance(value, dict) else {}


@dataclass(frozen=True)
class Wanted:
    """Options of the user for reading a calibration.

    instance      index of the sensor in a file with several sensors, from 0
    accel_unit, gyro_unit   units of the raw samples, for formats that do not define them
    temperature_degc        temperature at which thermal terms are evaluated, None to keep the terms
    accel_lsb_per_g, gyro_lsb_per_dps   resolution of the sensor, counts per g and per deg/s, for INAV
    """

    instance: int = 0
    accel_unit: str | None = None
    gyro_unit: str | None = None
    temperature_degc: float | None = None
    accel_lsb_per_g: float | None = None
    gyro_lsb_per_dps: float | None = None


@dataclass(frozen=True)
class Found:
    """A calibration as the files state it.

    accelerometer, gyroscope   the triads in raw units; None for a sensor that the files do not describe
    effects                    effects of the catalogue, and those of `user_effects`
    user_effects               effects that a formula defines
    accel_unit, gyro_unit      raw units: m/s^2 and rad/s, or lsb
    noise                      noise figures, named as in a calibration file
    temperature_range_degc     temperatures for which the thermal terms are valid; None without these terms
    missing                    parts of a calibration, besides covariance and gravity, that the files do not
                               state; see `Imported.missing`
    notes                      remarks for the user
    """

    accelerometer: Triad | None
    gyroscope: Triad | None
    effects: tuple[EffectValues, ...] = ()
    user_effects: tuple[FormulaEffect, ...] = ()
    accel_unit: str = "m/s^2"
    gyro_unit: str = "rad/s"
    noise: dict[str, float] = field(default_factory=dict)
    temperature_range_degc: tuple[float, float] | None = None
    serial_number: str | None = None
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reader:
    """A format of another program that contains calibrations.

    name        value of `imucal import --from`
    title       short description of the file
    program     the program that writes these files
    formula     correction that the other program computes
    source      source file of the other program that contains the formula
    files       minimum and maximum number of files of one calibration
    recognises  function that tests whether a file has this format
    read        function that returns the calibration in the contents
    without     the parts of a calibration that files of this format never state, for the table of formats
    scaled      whether the correction depends on the resolution of the sensor's driver, which the file does
                not state
    """

    name: str
    title: str
    program: str
    formula: str
    source: str
    recognises: Callable[[Content], bool]
    read: Callable[[tuple[Content, ...], Wanted], Found]
    without: str
    files: tuple[int, int] = (1, 1)
    scaled: bool = False


def corrected_by(matrix: FloatArray, bias: FloatArray) -> Triad:
    """The triad of `corrected = matrix raw - bias`: sensitivity matrix^-1, bias matrix^-1 bias.

    If the matrix is triangular or diagonal, the sensitivity has exact zeros in the same places.
    """
    inverse: FloatArray = np.linalg.inv(matrix).astype(np.float64, copy=False)
    for part in (np.tril, np.triu):
        if np.array_equal(matrix, part(matrix)):
            inverse = part(inverse)
    return Triad(inverse, inverse @ bias)
