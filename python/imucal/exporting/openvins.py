"""OpenVINS: kalibr_imu_chain.yaml, the block `imu0` of the model `kalibr`.

    raw_accel = Ta f + b_a
    raw_gyro  = Tw R_IMUtoGYRO w + Tg f + b_g

f is the true force and w the true rate in the IMU frame. R_IMUtoGYRO is a rotation, Tg is the g-sensitivity,
and b_a and b_g are the biases. Ta and Tw are lower triangular; OpenVINS takes the lower triangle of their
inverses. Source: rpng/open_vins, Simulator.cpp (get_next_imu), Propagator.cpp and VioManagerOptions.h
(print_and_load_state). Tg acts on the force in the IMU frame. Kalibr's g-sensitivity A acts on the force in
the gyroscope frame, and Kalibr's C_gyro_i rotates from the IMU frame to the gyroscope frame. Therefore
Tg = A C_gyro_i. The comment in OpenVINS' files, "Tg is imu0:gyroscopes:A", is correct only if C_gyro_i = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.exporting.format import SI, Format, Written, line_comments
from imucal.exporting.kalibr import G_SENSITIVITY, matrix_text, triangular_model
from imucal.exporting.model import FRAMES, lost_effects, turned
from imucal.noise_analysis.files import kalibr_yaml

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["OPENVINS"]

# First line of the file. OpenVINS reads the file with cv::FileStorage, which requires this line. Other YAML
# libraries do not accept it.
FIRST_LINE: Final = "%YAML:1.0"


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the block `imu0`, in the triangular frame, with the noise figures if there are any."""
    model = triangular_model(calibration)
    accelerometer, gyroscope = model.same_as.both()
    matrices = {
        "T_i_b": np.eye(4),
        "Tw": model.gyro,
        "R_IMUtoGYRO": model.to_gyro,
        "Ta": accelerometer.sensitivity,
        "R_IMUtoACC": np.eye(3),
        "Tg": model.from_force,
    }
    figures = [] if noise is None else kalibr_yaml(noise).splitlines()
    body = [
        "imu0:",
        "  model: kalibr",
        *(f"  {name}: {matrix_text(matrix)}" for name, matrix in matrices.items()),
        "  time_offset: 0.0",
        *(f"  {line}" for line in figures if not line.startswith("#")),
        "",
    ]
    without_noise = (
        "OpenVINS also needs noise figures, rostopic and update_rate in this block: export with "
        "--noise REC, a recording at rest, or copy them from your kalibr_imu_chain.yaml.",
    )
    return Written(
        body="\n".join(body),
        lost=(
            f"the constant biases, {accelerometer.bias.tolist()} m/s^2 and {gyroscope.bias.tolist()} "
            "rad/s: OpenVINS estimates them; their start values are init_dyn_bias_a and "
            "init_dyn_bias_g of estimator_config.yaml",
            *lost_effects(calibration, {G_SENSITIVITY}),
            *(["noise figures"] if noise is None else []),
        ),
        same_as=model.same_as,
        frame=FRAMES["triangular"] + ", the IMU frame of OpenVINS" + turned(model.rotation),
        notes=(
            "Set relative_config_imu to the name of this file. T_imu_cam must refer to the body frame above.",
            "With calib_imu_intrinsics or calib_imu_g_sensitivity OpenVINS estimates these matrices "
            "anew, starting from this file.",
            *(without_noise if noise is None else ()),
        ),
    )


def layout(lines: Sequence[str], body: str) -> str:
    """The text of the file: the first line, the header as comments, and the body."""
    return f"{FIRST_LINE}\n\n{line_comments('#')(lines, body)}"


OPENVINS = Format(
    name="openvins",
    title="OpenVINS kalibr_imu_chain.yaml, model kalibr",
    suffix=".yaml",
    formula="raw_accel = Ta f + b_a; raw_gyro = Tw R_IMUtoGYRO w + Tg f + b_g",
    source="rpng/open_vins, Simulator.cpp, Propagator.cpp and VioManagerOptions.h",
    units=SI,
    includes="scale and misalignment of both sensors, gyro_g_sensitivity, noise figures with --noise",
    omits="constant biases (given in the header), all other effects",
    layout=layout,
    write=write,
)
