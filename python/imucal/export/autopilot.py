"""What PX4 and ArduPilot have in common: an offset and a scale for each axis, and no misalignment.

    corrected_accel = (raw - thermal - offset) * scale           for each axis
    corrected_gyro  =  raw - thermal - offset

Both keep their parameters in float32.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration import Calibration, Triad
from imucal.effects import EffectValues
from imucal.export.model import lost_effects, misalignment, off_scale, per_axis, rotated

__all__ = ["PerAxis", "Thermal", "per_axis_model"]

THERMAL: Final = {"accel": "accel_bias_temperature", "gyro": "gyro_bias_temperature"}


@dataclass(frozen=True, eq=False)
class Thermal:
    """A bias that changes with d, temperature less the reference one: linear d + square d^2, raw units."""

    linear: FloatArray
    square: FloatArray


@dataclass(frozen=True, eq=False)
class PerAxis:
    """A calibration as offsets and scales; `thermal` by sensor, where it is known.

    same_as   the same as a calibration
    lost      what is not in it
    """

    accel_offset: FloatArray
    accel_scale: FloatArray
    gyro_offset: FloatArray
    thermal: dict[str, Thermal]
    temperature_range_degc: tuple[float, float] | None
    same_as: Calibration
    lost: tuple[str, ...]

    def range_degc(self, default: tuple[float, float]) -> tuple[float, float]:
        """The temperatures between which the thermal terms act: those seen, or else the autopilot's own."""
        return self.temperature_range_degc or default

    @property
    def thermal_notes(self) -> tuple[str, ...]:
        """What the user of the thermal terms has to know; empty without any."""
        if not self.thermal:
            return ()
        seen = "the recordings saw" if self.temperature_range_degc else "the autopilot has as its own"
        return (f"The thermal terms are held below TMIN and above TMAX, the temperatures that {seen}.",)


def per_axis_model(calibration: Calibration) -> PerAxis:
    """The model that leaves the smallest errors of the force over all directions.

    It is found in the symmetric frame, whose axes are as near to those of the sensor as can be.
    """
    moved, _ = rotated(calibration, "symmetric")
    accel, gyro = moved.accelerometer, moved.gyroscope
    scale = per_axis(accel.sensitivity)
    thermal = {
        sensor: _thermal(values, triad.sensitivity)
        # In raw units, where the frame has no part.
        for sensor, triad in (("accel", calibration.accelerometer), ("gyro", calibration.gyroscope))
        for values in calibration.effects
        if values.name == THERMAL[sensor]
    }
    diagonal = {"accel": np.diag(scale), "gyro": np.eye(3)}
    effects = [_effect(sensor, found, diagonal[sensor]) for sensor, found in thermal.items()]
    return PerAxis(
        accel_offset=accel.bias,
        accel_scale=1 / scale,
        gyro_offset=gyro.bias,
        thermal=thermal,
        temperature_range_degc=calibration.temperature_range_degc,
        same_as=replace(
            moved,
            accelerometer=Triad(diagonal["accel"], accel.bias),
            gyroscope=Triad(diagonal["gyro"], gyro.bias),
            effects=tuple(effects),
        ),
        lost=(
            *misalignment("accelerometer", accel.sensitivity),
            *off_scale("gyroscope", gyro.sensitivity),
            *misalignment("gyroscope", gyro.sensitivity),
            *lost_effects(calibration, THERMAL.values()),
        ),
    )


def _thermal(values: EffectValues, sensitivity: FloatArray) -> Thermal:
    """T times the effect, which adds to the true value."""
    numbers = np.zeros(6)
    numbers[: len(values.values)] = values.values
    return Thermal(sensitivity @ numbers[:3], sensitivity @ numbers[3:])


def _effect(sensor: str, thermal: Thermal, diagonal: FloatArray) -> EffectValues:
    # Of the raw units back to the true value, as a diagonal calibration has it.
    numbers = np.linalg.solve(diagonal, np.column_stack((thermal.linear, thermal.square)))
    return EffectValues(THERMAL[sensor], np.asarray(numbers.T.ravel(), dtype=np.float64))
