"""Noise figures as files for other programs: Kalibr's imu.yaml, and unit files for the simulation."""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.document.name import require_name
from imucal.errors import InputError
from imucal.noise_analysis.noise import NoiseResult
from imucal.rig.unit import Sensor, Unit

__all__ = ["kalibr_yaml", "unit_of_noise"]

ROSTOPIC: Final = "/imu0"
# For each name of a noise figure in Kalibr's imu.yaml: the sensor, the noise figure of imucal, and Kalibr's
# unit.
KALIBR: Final = {
    "accelerometer_noise_density": ("accel", "noise_density", "m/s^2/sqrt(Hz)"),
    "accelerometer_random_walk": ("accel", "random_walk", "m/s^3/sqrt(Hz)"),
    "gyroscope_noise_density": ("gyro", "noise_density", "rad/s/sqrt(Hz)"),
    "gyroscope_random_walk": ("gyro", "random_walk", "rad/s^2/sqrt(Hz)"),
}


def kalibr_yaml(noise: NoiseResult, *, rostopic: str = ROSTOPIC) -> str:
    """Kalibr's imu.yaml: continuous-time noise figures in SI units, each the largest of the three axes.

    A random walk that is not detected is written as the upper end of its 95 % band, with a comment, because
    Kalibr does not accept zero. If only one sensor was recorded, only its two lines are written. Raises
    InputError for a recording in raw counts.
    """
    _require_si(noise)
    lines = [
        "# Written by imucal noise: maximum-likelihood figures of the noise at rest, continuous time,",
        f"# the largest of the three axes, from {noise.samples} samples ({noise.duration_s:.0f} s) at rest.",
    ]
    for name, (sensor, figure, unit) in KALIBR.items():
        if not noise.has(sensor):
            continue
        estimates = [getattr(axis, figure) for axis in noise.triad(sensor)]
        seen = [e for e in estimates if e.value is not None]
        value, std = max(((e.value, e.std) for e in seen), default=(max(e.high for e in estimates), None))
        if not np.isfinite(value):
            raise InputError(f"{noise.name}: an axis of the {sensor} is constant: {name} is not known")
        how = (
            "not detected on any axis: the upper end of its 95 % band"
            if std is None
            else f"1 sigma {std:.2g}"
        )
        # YAML 1.1 reads a number without a decimal point, such as 1e-05, as text.
        lines.append(f"{name}: {np.format_float_scientific(value, precision=9, trim='0')}  # {unit}, {how}")
    quoted = require_name(rostopic, "the rostopic").replace("'", "''")
    rate = np.format_float_positional(noise.rate_hz, precision=6, trim="0")
    return "\n".join([*lines, f"rostopic: '{quoted}'", f"update_rate: {rate}  # Hz", ""])


def unit_of_noise(noise: NoiseResult, *, name: str = "measured") -> Unit:
    """A unit for the simulation with this noise and no other errors.

    Noise processes that were not detected are zero.

    Noise density and bias instability are root mean squares over the axes. Raises InputError for raw counts.
    """
    _require_si(noise)

    def sensor(triad: str) -> Sensor:
        axes = noise.triad(triad)
        figures = {
            figure: np.array([getattr(axis, figure).value or 0.0 for axis in axes])
            for figure in ("noise_density", "bias_instability", "random_walk")
        }
        return Sensor(
            noise_density=float(np.sqrt(np.mean(figures["noise_density"] ** 2))),
            bias_instability=float(np.sqrt(np.mean(figures["bias_instability"] ** 2))),
            random_walk=figures["random_walk"],
        )

    return Unit(
        sensor("accel"),
        sensor("gyro"),
        name=name,
        description=f"Noise as identified from {noise.samples} samples ({noise.duration_s:.0f} s) at rest.",
        sources={"recording": noise.name},
    )


def _require_si(noise: NoiseResult) -> None:
    if "lsb" in (noise.accel_unit, noise.gyro_unit):
        raise InputError(
            f"{noise.name} is in raw counts: correct it first (imucal apply), for these figures need SI units"
        )
