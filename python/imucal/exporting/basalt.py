"""Basalt: calib_accel_bias (9) and calib_gyro_bias (12) of its calibration file.

    corrected = raw + S raw - b

b is the bias of a sensor, and S (3x3) corrects its scale and misalignment. S of the accelerometer is lower
triangular. Each array holds the three biases, then S column by column (calib_bias.hpp of basalt-headers,
CalibAccelBias::getCalibrated and CalibGyroBias::getCalibrated).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.exporting.format import SI, Format, Written, in_json
from imucal.exporting.model import FRAMES, inverse, lost_effects, rotated, turned

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["BASALT", "ENTRIES"]

# Row and column of each entry of the matrix S, in the order in which Basalt's arrays contain them after the
# three biases: column by column. For the accelerometer, only the lower triangle is stored.
ENTRIES: Final = {
    "calib_accel_bias": ((0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)),
    "calib_gyro_bias": tuple((i, j) for j in range(3) for i in range(3)),
}


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the arrays of both sensors in the triangular frame.

    In this frame, the inverse of the accelerometer's sensitivity is lower triangular, as Basalt requires.
    """
    moved, rotation = rotated(calibration, "triangular")
    accelerometer, gyroscope = moved.both()
    fields = {}
    for name, triad in (("calib_accel_bias", accelerometer), ("calib_gyro_bias", gyroscope)):
        correction = inverse(triad)
        scale = correction - np.eye(3)
        fields[name] = [
            *(correction @ triad.bias).tolist(),
            *(float(scale[entry]) for entry in ENTRIES[name]),
        ]
    return Written(
        body=json.dumps({"value0": fields}),
        lost=lost_effects(calibration),
        same_as=moved,
        frame=FRAMES["triangular"] + turned(rotation),
        notes=(
            "Put the two arrays into your calibration.json. imucal does not know its other fields (cameras, "
            "rates, noise). T_imu_cam must refer to the body frame above.",
        ),
    )


BASALT = Format(
    name="basalt",
    title="Basalt calibration, IMU part",
    suffix=".json",
    formula="corrected = raw + S raw - b, for both sensors",
    source="basalt-headers, calib_bias.hpp",
    units=SI,
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=in_json,
    write=write,
)
