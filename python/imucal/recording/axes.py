"""Axis remapping of a recording: the columns, with their signs, that become x, y and z of each sensor.

x,-y,-z                    both sensors: x is the column x, y the negative column y, z the negative column z
frd, ned                   both sensors: x,-y,-z, which converts x forward, y right, z down to x forward, y
                           left, z up
flu                        both sensors: x,y,z, no change
accel=-x,-y,-z             the accelerometer only
accel=z,y,x gyro=z,y,-x    each sensor separately
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError

__all__ = ["UNCHANGED", "Axes"]

NAMED: Final = {"frd": "x,-y,-z", "ned": "x,-y,-z", "flu": "x,y,z"}
SENSORS: Final = ("accel", "gyro")
# The text that stands for no remapping.
UNCHANGED: Final = "x,y,z"


@dataclass(frozen=True, eq=False)
class Axes:
    """For each sensor, the signed permutation matrix (3, 3) from the columns of a file to x, y and z."""

    accel: FloatArray
    gyro: FloatArray

    @staticmethod
    def parse(text: str) -> Axes:
        """The axes of a text in a form listed at the start of this module. Raises InputError for others."""
        parts = re.split(r"[;\s]+", text.strip().lower()) if isinstance(text, str) else []
        given: dict[str, FloatArray] = {}
        for part in parts:
            sensor, equals, words = part.rpartition("=")
            matrix = _matrix(NAMED.get(words, words))
            sensors = (sensor,) if equals else SENSORS
            if matrix is None or not set(sensors) <= set(SENSORS) or set(sensors) & given.keys():
                given = {}
                break
            given.update(dict.fromkeys(sensors, matrix))
        if not given:
            raise InputError(
                f"axes is {text!r}: give frd, ned, flu, the axes of the file that become x, y and z, such as "
                "x,-y,-z, or these axes for one sensor, such as accel=-x,-y,-z or gyro=y,-x,z"
            )
        return Axes(given.get("accel", np.eye(3)), given.get("gyro", np.eye(3)))

    @property
    def are_alike(self) -> bool:
        """Whether the remapping is the same for both sensors."""
        return np.array_equal(self.accel, self.gyro)

    def after(self, first: Axes) -> Axes:
        """The remapping that is equivalent to `first` followed by this remapping."""
        return Axes(self.accel @ first.accel, self.gyro @ first.gyro)

    @property
    def inverse(self) -> Axes:
        """The inverse remapping."""
        return Axes(self.accel.T, self.gyro.T)

    def __str__(self) -> str:
        accel, gyro = (_words(matrix) for matrix in (self.accel, self.gyro))
        if accel == gyro:
            return accel
        named = {"accel": accel, "gyro": gyro}
        return " ".join(f"{sensor}={words}" for sensor, words in named.items() if words != UNCHANGED)


def _matrix(words: str) -> FloatArray | None:
    """The signed permutation of a text such as x,-y,-z; None for any other text."""
    if not re.fullmatch(r"[+-]?[xyz](,[+-]?[xyz]){2}", words):
        return None
    matrix = np.zeros((3, 3))
    for row, word in enumerate(words.split(",")):
        matrix[row, "xyz".index(word[-1])] = -1.0 if word.startswith("-") else 1.0
    return matrix if matrix.any(axis=0).all() else None


def _words(matrix: FloatArray) -> str:
    columns = np.abs(matrix).argmax(axis=1)
    return ",".join(
        ("-" if matrix[row, column] < 0 else "") + "xyz"[column] for row, column in enumerate(columns)
    )
