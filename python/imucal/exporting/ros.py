"""ROS: the calibration file of the package imu_calib.

    corrected_accel = SM raw - bias

Source: AccelCalib::applyCalib in accel_calib.cpp of dpkoch/imu_calib; SM is stored row by row. The node
apply_calib reads no gyroscope parameters from the file. It subtracts the mean rate of the first samples after
its start (apply_calib.cpp).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.model import FRAMES, inverse, linear, lost_effects, misalignment, off_scale

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["ROS"]


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write SM = T^-1 and bias = T^-1 b; T and b are sensitivity and bias of the accelerometer."""
    scale = inverse(calibration.accelerometer)
    bias = scale @ calibration.accelerometer.bias
    gyro = calibration.gyroscope
    body = "\n".join(
        f"{name}: [{', '.join(number(value) for value in np.ravel(values))}]"
        for name, values in (("SM", scale), ("bias", bias))
    )
    return Written(
        body=body + "\n",
        lost=(
            *(() if gyro is None else _lost_gyroscope(gyro)),
            *lost_effects(calibration),
        ),
        same_as=replace(linear(calibration), gyroscope=None if gyro is None else Triad(np.eye(3), gyro.bias)),
        frame=FRAMES[calibration.frame],
        notes=("The unit must be at rest when the node starts.",),
    )


def _lost_gyroscope(gyro: Triad) -> tuple[str, ...]:
    return (
        f"bias of the gyroscope, {gyro.bias.tolist()} rad/s: the node estimates this bias at its start",
        *off_scale("gyroscope", gyro.sensitivity),
        *misalignment("gyroscope", gyro.sensitivity),
    )


ROS = Format(
    name="ros",
    title="ROS package imu_calib",
    suffix=".yaml",
    formula="corrected_accel = SM raw - bias; corrected_gyro = raw - mean of the first samples",
    source="dpkoch/imu_calib, accel_calib.cpp and apply_calib.cpp",
    units=SI,
    includes="bias, scale and misalignment of the accelerometer",
    omits="bias, scale and misalignment of the gyroscope, all effects",
    layout=line_comments("#"),
    write=write,
    needs_gyroscope=False,
)
