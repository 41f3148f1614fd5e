"""Conversion of a calibration to another body frame, or to raw samples whose axes have not been remapped.

Two body frames differ by one rotation Q. If T is the sensitivity of a sensor in one frame, T' = T Q^T is its
sensitivity in the other frame (docs/model.md (2)). Residuals and the norm of the force are the same in both
frames. The covariance is propagated linearly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.model import SensorModel
from imucal.calibration.propagation import jacobian, known_covariance
from imucal.calibration.triad import Frame, Triad
from imucal.effects.effect import EffectValues
from imucal.effects.formula import ARGUMENTS, AXES, INPUTS
from imucal.effects.formula_effect import FormulaEffect
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED, Axes

__all__ = ["for_columns", "in_frame", "is_added"]

# Effects whose values are one or more vectors k in the body frame. A change of frame by the rotation Q
# changes each vector to Q k.
VECTORS: Final = frozenset(
    {
        "accel_bias_temperature",
        "gyro_bias_temperature",
        *(
            f"{sensor}_bias_temperature_{variable}"
            for sensor in ("accel", "gyro")
            for variable in ("lag", "rate", "hysteresis")
        ),
        "accel_bias_drift",
        "gyro_bias_drift",
        "accel_bias_warmup",
        "gyro_bias_warmup",
        "accel_lever_arm",
    }
)
# Effects whose nine values are a matrix K in the body frame, by rows. A change of frame by the rotation Q
# changes the matrix to Q K Q^T.
MATRICES: Final = frozenset({"gyro_g_sensitivity", "gyro_angular_acceleration"})
# Effects whose values do not depend on the body frame: a delay, and a rate in the world frame.
INVARIANT: Final = frozenset({"gyro_time_offset", "earth_rate"})


def in_frame(calibration: Calibration, frame: Frame) -> Calibration:
    """Convert a calibration and its covariance to the frame "symmetric" or "triangular".

    Raises InputError for effects that are defined along the axes of their body frame, such as nonlinear
    scales, and for left-handed accelerometer axes.
    """
    if calibration.frame == frame:
        return calibration
    if np.linalg.det(calibration.accelerometer.sensitivity) < 0:
        raise InputError(
            "the accelerometer's sensitivity has a negative determinant, so its axes are left-handed and "
            f"cannot be rotated to the frame {frame}: change the sign of an axis in the recordings"
        )

    def convert(model: SensorModel) -> SensorModel:
        # The accelerometer alone defines the frame, so the identity can replace the sensitivity of a missing
        # gyroscope.
        gyroscope = np.eye(3) if model.gyroscope is None else model.gyroscope.sensitivity
        accel, gyro = _core.convert_frame(model.accelerometer.sensitivity, gyroscope, frame)
        rotation: FloatArray = np.linalg.solve(accel, model.accelerometer.sensitivity).astype(np.float64)
        return SensorModel(
            Triad(accel, model.accelerometer.bias),
            None if model.gyroscope is None else Triad(gyro, model.gyroscope.bias),
            frame,
            model.accel_unit,
            model.gyro_unit,
            model.gravity_mps2,
            tuple(rotated_effect(model, values, rotation) for values in model.effects),
            model.user_effects,
            model.axes,
        )

    return _converted(calibration, convert)


def for_columns(calibration: Calibration) -> Calibration:
    """Convert a calibration so that it applies to raw samples before axis remapping, as in the columns.

    The body frame does not change, so the sensitivity is no longer symmetric or triangular and the frame is
    "given".
    """
    if calibration.axes == UNCHANGED:
        return calibration
    axes = Axes.parse(calibration.axes)

    def convert(model: SensorModel) -> SensorModel:
        return replace(
            model,
            accelerometer=_before(model.accelerometer, axes.accel),
            gyroscope=None if model.gyroscope is None else _before(model.gyroscope, axes.gyro),
            frame="given",
            axes=UNCHANGED,
        )

    return _converted(calibration, convert)


def is_added(model: SensorModel, values: EffectValues) -> bool:
    """Whether an effect adds a vector that depends only on time, temperature or auxiliary columns."""
    effect = model.definition(values)
    if isinstance(effect, FormulaEffect):
        samples = {name for name in INPUTS if name not in ("temp_degc", "time_s", *ARGUMENTS)}
        return effect.formula.axes == AXES and not effect.formula.inputs & samples
    return values.name in VECTORS and "_bias_" in values.name


def rotated_effect(model: SensorModel, values: EffectValues, rotation: FloatArray) -> EffectValues:
    """Convert an effect to another body frame, in which a vector v has the components `rotation @ v`.

    Raises InputError if the effect cannot be expressed in the other frame.
    """
    if values.name in VECTORS or is_added(model, values):
        rows = values.values.reshape(-1, 3) @ rotation.T
    elif values.name in MATRICES:
        rows = rotation @ values.values.reshape(3, 3) @ rotation.T
    elif values.name in INVARIANT:
        return values
    else:
        raise InputError(
            f"{values.name} is defined along the axes of the body frame, and the two calibrations have "
            "different body frames: compare calibrations in the same frame"
        )
    return replace(values, values=rows.ravel())


def _before(triad: Triad, axes: FloatArray) -> Triad:
    return Triad(axes.T @ triad.sensitivity, axes.T @ triad.bias)


def _converted(calibration: Calibration, convert: Callable[[SensorModel], SensorModel]) -> Calibration:
    model = convert(calibration)
    covariance = known_covariance(calibration)
    if covariance is not None:
        derivative = jacobian(convert, calibration)
        covariance = derivative @ covariance @ derivative.T
        covariance = (covariance + covariance.T) / 2
    return replace(
        calibration,
        accelerometer=model.accelerometer,
        gyroscope=model.gyroscope,
        frame=model.frame,
        effects=model.effects,
        axes=model.axes,
        covariance=covariance,
        covariance_names=()
        if covariance is None
        else tuple(parameter.name for parameter in model.parameters),
    )
