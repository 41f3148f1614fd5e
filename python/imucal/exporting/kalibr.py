"""Kalibr: the block `imu0` of a result with the model scale-misalignment, and imu.yaml.

    raw_accel = M_a f_i + b_a
    raw_gyro  = M_g C_gyro_i w_i + A C_gyro_i f_i + b_g

M_a and M_g are lower triangular, C_gyro_i is a rotation, A is the g-sensitivity, and b_a and b_g are the
biases. f_i and w_i are in the IMU frame i, whose x axis is the accelerometer's x axis (the `triangular` frame
here). A is in the gyroscope frame. Source: IccSensors.py of ethz-asl/kalibr,
IccScaledMisalignedImu.addAccelerometerErrorTerms and addGyroscopeErrorTerms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.effects.effect import EffectValues
from imucal.errors import InputError
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.model import FRAMES, lost_effects, rotated, turned
from imucal.noise_analysis.files import kalibr_yaml

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["G_SENSITIVITY", "KALIBR", "KALIBR_IMU", "matrix_text", "triangular_model"]

G_SENSITIVITY = "gyro_g_sensitivity"


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the block `imu0`, in the triangular frame."""
    model = triangular_model(calibration)
    moved, rotation, gyro, to_gyro = model.same_as, model.rotation, model.gyro, model.to_gyro
    accelerometer, gyroscope = moved.both()
    in_gyro = model.from_force @ to_gyro.T
    body = [
        "imu0:",
        "  model: scale-misalignment",
        "  accelerometers:",
        f"    M: {matrix_text(moved.accelerometer.sensitivity)}",
        "  gyroscopes:",
        f"    M: {matrix_text(gyro)}",
        f"    A: {matrix_text(in_gyro)}  # rad/s per m/s^2",
        f"    C_gyro_i: {matrix_text(to_gyro)}",
        "  T_i_b: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]",
        "",
    ]
    return Written(
        body="\n".join(body),
        lost=(
            "the constant biases: Kalibr's block has no field for them, because estimators estimate them "
            f"(start values: {accelerometer.bias.tolist()} m/s^2 and {gyroscope.bias.tolist()} rad/s)",
            *lost_effects(calibration, {G_SENSITIVITY}),
        ),
        same_as=moved,
        frame=FRAMES["triangular"] + ", Kalibr's frame i" + turned(rotation),
        notes=(
            "The formula gives raw samples from true values. To correct samples, solve it for f_i and then "
            "for w_i.",
            "Add rostopic, update_rate and the noise figures: imucal noise REC --kalibr imu.yaml",
            "OpenVINS has other names, and its Tg is A C_gyro_i instead of A: for OpenVINS use --to "
            "openvins.",
        ),
    )


@dataclass(frozen=True, eq=False)
class TriangularModel:
    """The calibration with a lower triangular matrix for each sensor, in the triangular body frame.

        raw_accel = M_a f + b_a
        raw_gyro  = gyro to_gyro w + from_force f + b_g

    f is the true force and w the true rate.

    same_as       the calibration in the triangular frame, with the g-sensitivity as its only effect. M_a is
                  the sensitivity of its accelerometer; b_a and b_g are its biases
    rotation      (3, 3), rotation from the body frame of the calibration to the triangular frame
    gyro, to_gyro (3, 3) each: a lower triangular matrix with positive diagonal, and a rotation
    from_force    (3, 3) matrix of the g-sensitivity, rad/s per m/s^2
    """

    same_as: Calibration
    rotation: FloatArray
    gyro: FloatArray
    to_gyro: FloatArray
    from_force: FloatArray


def triangular_model(calibration: Calibration) -> TriangularModel:
    """Convert a calibration to the model of Kalibr and OpenVINS. Raises InputError for left-handed axes."""
    moved, rotation = rotated(calibration, "triangular")
    from_body = moved.both()[1].sensitivity
    gyro, to_gyro = _lower_times_rotation(from_body)
    effects = [values for values in calibration.effects if values.name == G_SENSITIVITY]
    # In Kalibr and OpenVINS the g-sensitivity term is added to the raw rate. In imucal it is added to the
    # true rate in the body frame, before the sensitivity matrix.
    sensitivity = np.zeros((3, 3))
    for values in effects:
        sensitivity = rotation @ values.values.reshape(3, 3) @ rotation.T
    moved = replace(moved, effects=tuple(EffectValues(G_SENSITIVITY, sensitivity.ravel()) for _ in effects))
    return TriangularModel(moved, rotation, gyro, to_gyro, from_body @ sensitivity)


def _lower_times_rotation(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Decompose `matrix` into a lower triangular matrix with positive diagonal times a rotation."""
    if np.linalg.det(matrix) < 0:
        raise InputError(
            "the gyroscope axes are left-handed relative to the accelerometer axes: change the sign of one "
            "gyroscope axis in the recording and calibrate again"
        )
    upper_rotation, upper = np.linalg.qr(matrix.T)
    signs = np.sign(np.diag(upper))
    lower = (upper * signs[:, None]).T
    return np.tril(lower), (upper_rotation * signs).T


def matrix_text(matrix: FloatArray) -> str:
    """A matrix as a list of rows in YAML."""
    return "[" + ", ".join(f"[{', '.join(map(number, row))}]" for row in matrix) + "]"


def write_imu(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write imu.yaml with the noise figures of a recording at rest, corrected by this calibration."""
    if noise is None:
        raise ValueError("noise figures are needed")
    return Written(
        body=kalibr_yaml(noise),
        lost=(
            "bias, scale, misalignment and effects: imu.yaml contains only noise figures, use --to kalibr "
            "for these",
        ),
        same_as=None,
        frame=FRAMES[calibration.frame],
        notes=(f"The noise was measured in {noise.name}, corrected by the calibration.",),
    )


KALIBR = Format(
    name="kalibr",
    title="Kalibr result, block imu0 of the model scale-misalignment",
    suffix=".yaml",
    formula="raw_accel = M_a f_i + b_a; raw_gyro = M_g C_gyro_i w_i + A C_gyro_i f_i + b_g",
    source="ethz-asl/kalibr, IccSensors.py, IccScaledMisalignedImu",
    units=SI,
    includes="scale and misalignment of both sensors, gyro_g_sensitivity",
    omits="constant biases (given in the header), all other effects, noise figures (see kalibr-imu)",
    layout=line_comments("#"),
    write=write,
)

KALIBR_IMU = Format(
    name="kalibr-imu",
    title="Kalibr imu.yaml",
    suffix=".yaml",
    formula="none: the file contains noise figures for the weights of an estimator, no correction",
    source="ethz-asl/kalibr, ConfigReader.py, ImuParameters",
    units=SI + "; continuous-time noise figures",
    includes="noise density and random walk, the largest of the three axes",
    omits="bias instability, and everything except noise",
    layout=line_comments("#"),
    write=write_imu,
    takes_counts=True,
    needs_noise=True,
    needs_gyroscope=False,
)
