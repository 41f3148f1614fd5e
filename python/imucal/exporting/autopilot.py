"""The correction model shared by PX4 and ArduPilot: an offset and a scale per axis, no misalignment.

    corrected_accel = (raw - thermal - offset) * scale           for each axis
    corrected_gyro  =  raw - thermal - offset

Both autopilots store their parameters as float32.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.effects.effect import EffectValues
from imucal.exporting.model import lost_effects, misalignment, off_scale, per_axis, rotated

__all__ = ["THERMAL", "PerAxis", "Thermal", "per_axis_model"]

# For each sensor, the temperature effect that the autopilots can represent.
THERMAL: Final = {"accel": "accel_bias_temperature", "gyro": "gyro_bias_temperature"}


@dataclass(frozen=True, eq=False)
class Thermal:
    """Temperature dependence of a bias in raw units: linear d + square d^2 + cube d^3.

    d is the temperature minus the reference temperature, K.
    linear   (3,), raw units per K
    square   (3,), raw units per K^2
    cube     (3,), raw units per K^3
    """

    linear: FloatArray
    square: FloatArray
    cube: FloatArray


@dataclass(frozen=True, eq=False)
class PerAxis:
    """A calibration approximated by offsets and scales; all arrays are (3,).

    accel_offset, gyro_offset   raw units; gyro_offset is None for an accelerometer alone
    accel_scale                 corrected / raw, dimensionless
    thermal                     thermal terms by sensor ("accel", "gyro"); only sensors with a temperature
                                effect are listed
    same_as                     the approximation as a calibration
    lost                        description of each part of the calibration that the approximation omits
    """

    accel_offset: FloatArray
    accel_scale: FloatArray
    gyro_offset: FloatArray | None
    thermal: dict[str, Thermal]
    temperature_range_degc: tuple[float, float] | None
    same_as: Calibration
    lost: tuple[str, ...]

    def range_degc(self, default: tuple[float, float]) -> tuple[float, float]:
        """Temperature range of the thermal terms, degC: range of the recordings, or `default` if unknown."""
        return self.temperature_range_degc or default

    @property
    def thermal_notes(self) -> tuple[str, ...]:
        """A note about the thermal terms for the user of the file; empty if there are no thermal terms."""
        if not self.thermal:
            return ()
        source = (
            "the range of the recordings" if self.temperature_range_degc else "the autopilot's default range"
        )
        return (f"The thermal terms are constant below TMIN and above TMAX, which are {source}.",)


def per_axis_model(calibration: Calibration) -> PerAxis:
    """The offsets and scales that approximate `calibration`.

    The scales minimise the mean square error of the specific force over all directions. The values are
    computed in the symmetric body frame, the orthogonal frame closest to the sensor axes.
    """
    moved, _ = rotated(calibration, "symmetric")
    accel, gyro = moved.accelerometer, moved.gyroscope
    scale = per_axis(accel.sensitivity)
    thermal = {
        sensor: _thermal(values, triad.sensitivity)
        # The autopilots apply thermal terms to raw samples, so the rotation of the body frame does not affect
        # these terms.
        for sensor, triad in (("accel", calibration.accelerometer), ("gyro", calibration.gyroscope))
        for values in calibration.effects
        if triad is not None and values.name == THERMAL[sensor]
    }
    diagonal = {"accel": np.diag(scale), "gyro": np.eye(3)}
    effects = [_effect(sensor, found, diagonal[sensor]) for sensor, found in thermal.items()]
    return PerAxis(
        accel_offset=accel.bias,
        accel_scale=1 / scale,
        gyro_offset=None if gyro is None else gyro.bias,
        thermal=thermal,
        temperature_range_degc=calibration.temperature_range_degc,
        same_as=replace(
            moved,
            accelerometer=Triad(diagonal["accel"], accel.bias),
            gyroscope=None if gyro is None else Triad(diagonal["gyro"], gyro.bias),
            effects=tuple(effects),
        ),
        lost=(
            *misalignment("accelerometer", accel.sensitivity),
            *(() if gyro is None else off_scale("gyroscope", gyro.sensitivity)),
            *(() if gyro is None else misalignment("gyroscope", gyro.sensitivity)),
            *lost_effects(calibration, THERMAL.values()),
        ),
    )


def _thermal(values: EffectValues, sensitivity: FloatArray) -> Thermal:
    """Convert a temperature effect to raw units.

    The result is the sensitivity times the effect, because the effect is added to the true value.
    """
    numbers = np.zeros(9)
    numbers[: len(values.values)] = values.values
    return Thermal(*(sensitivity @ row for row in numbers.reshape(3, 3)))


def _effect(sensor: str, thermal: Thermal, diagonal: FloatArray) -> EffectValues:
    # For a triad with this diagonal sensitivity, the effect is the thermal terms in raw units, divided by the
    # sensitivity.
    numbers = np.linalg.solve(diagonal, np.column_stack((thermal.linear, thermal.square, thermal.cube)))
    return EffectValues(THERMAL[sensor], np.asarray(numbers.T.ravel(), dtype=np.float64))
