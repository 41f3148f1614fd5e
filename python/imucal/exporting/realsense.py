"""RealSense: calibration.json of rs-imu-calibration, with the 24 numbers of the camera's calibration table.

    corrected = sensitivity raw - bias

Source: correct_motion_helper in motion-transform.cpp of librealsense. `scale_and_alignment` holds the
sensitivity column by column: the tool solves raw^T X = corrected^T and writes X row by row
(rs-imu-calibration.py).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from imucal.calibration.calibration import Calibration
from imucal.exporting.format import SI, Format, Written, in_json
from imucal.exporting.model import FRAMES, inverse, linear, lost_effects

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["REALSENSE"]


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """T^-1 and T^-1 b of both sensors, as JSON."""
    imu = {}
    for sensor in ("accelerometer", "gyroscope"):
        triad = getattr(calibration, sensor)
        correction = inverse(triad)
        imu[sensor] = {
            "scale_and_alignment": correction.T.ravel().tolist(),
            "bias": (correction @ triad.bias).tolist(),
        }
    return Written(
        body=json.dumps({"device_type": "D435i", "imus": [imu]}),
        lost=lost_effects(calibration),
        same_as=linear(calibration),
        frame=FRAMES[calibration.frame],
        notes=(
            "Record with motion correction switched off (enable_motion_correction 0), in the frame of the "
            "depth sensor, which is librealsense's default. The camera stores float32.",
        ),
    )


REALSENSE = Format(
    name="realsense",
    title="RealSense calibration.json",
    suffix=".json",
    formula="corrected = S raw - bias for both sensors, S being scale_and_alignment column by column",
    source="librealsense, motion-transform.cpp and tools/rs-imu-calibration",
    units=SI,
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=in_json,
    write=write,
)
