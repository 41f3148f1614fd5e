"""gz-sensors: the noise of a simulated IMU as an SDF element <imu>.

    output = true + N(mean, stddev) + bias
    bias  <- exp(-dt / tau) bias + N(0, s),  s^2 = dynamic_bias_stddev^2 (tau / 2) (1 - exp(-2 dt / tau))

N(m, d) is a normal random number with mean m and standard deviation d, dt is the sampling interval, and tau
is `dynamic_bias_correlation_time`.

Source: GaussianNoiseModel::ApplyImpl in GaussianNoiseModel.cc of gz-sensors. `stddev` is the standard
deviation of one sample, so it is valid for one sampling rate only. The constant bias is written as `mean`,
because gz-sensors gives `bias_mean` a random sign.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from imucal.calibration.calibration import Calibration
from imucal.errors import InputError
from imucal.exporting.format import SI, Format, Written, number, xml_comment
from imucal.exporting.model import lost_effects, misalignment, off_scale

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["GAZEBO"]

SENSORS: Final = {
    "gyro": ("gyroscope", "angular_velocity"),
    "accel": ("accelerometer", "linear_acceleration"),
}


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the SDF element with bias, white noise and random walk of each axis."""
    if noise is None:
        raise ValueError("noise figures are needed")
    lines = ["<imu>"]
    for sensor, (triad, element) in SENSORS.items():
        lines.append(f"  <{element}>")
        bias = getattr(calibration, triad).bias
        for i, axis in enumerate("xyz"):
            found = noise.axes[f"{sensor}_{axis}"]
            density = found.noise_density.value
            if density is None:
                raise InputError(
                    f"{noise.name}: the white noise of {sensor}_{axis} could not be determined: record a "
                    "longer rest, with a finer resolution"
                )
            fields = {"mean": bias[i], "stddev": density * noise.rate_hz**0.5}
            if found.random_walk.value is not None:
                fields["dynamic_bias_stddev"] = found.random_walk.value
                fields["dynamic_bias_correlation_time"] = noise.duration_s
            lines.append(f'    <{axis}><noise type="gaussian">')
            lines += [f"      <{name}>{number(value)}</{name}>" for name, value in fields.items()]
            lines.append(f"    </noise></{axis}>")
        lines.append(f"  </{element}>")
    return Written(
        body="\n".join([*lines, "</imu>", ""]),
        lost=(
            *(
                text
                for name in ("accelerometer", "gyroscope")
                for text in (
                    *off_scale(name, getattr(calibration, name).sensitivity),
                    *misalignment(name, getattr(calibration, name).sensitivity),
                )
            ),
            "bias instability of both sensors",
            *lost_effects(calibration),
        ),
        same_as=None,
        frame="the axes of the sensors",
        notes=(
            f"stddev is for <update_rate>{number(noise.rate_hz)}</update_rate>. The noise was measured in "
            f"{noise.name}, {noise.duration_s:.0f} s at rest; this duration is also the correlation time of "
            "the random walk.",
        ),
    )


GAZEBO = Format(
    name="gazebo",
    title="gz-sensors noise of a simulated IMU, SDF",
    suffix=".sdf",
    formula="simulated = true + N(mean, stddev) + a Gauss-Markov bias with dynamic_bias_stddev",
    source="gz-sensors, GaussianNoiseModel.cc",
    units=SI,
    includes="bias of both sensors, white noise, random walk",
    omits="scale and misalignment, all effects, bias instability",
    layout=xml_comment,
    write=write,
    needs_noise=True,
)
