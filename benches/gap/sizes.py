"""How large an effect must be to be seen, and how large it usually is, in SI units.

The detection limit is the smallest root mean square per parameter that is seen with 90 % power (family-wise
alpha 0.01) in one run at the noise of the paper's unit: `limits` predicts it from differences of simulated
runs, without the tool. It does not reach data with encoders: those numbers are of an earlier study, for the
same noise.
The temperature goes up and down within the run, as `scene.CYCLE` says.
"""

from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

import imucal
from imucal.units import STANDARD_GRAVITY_MPS2

G: Final = STANDARD_GRAVITY_MPS2
DEG: Final = radians(1.0)


@dataclass(frozen=True)
class Size:
    """The data that show an effect, and its detection limit in each kind of data.

    kind   "A" rests and moves by hand, "A'" on a stand, so that the accelerometer counts within the moves
           too, "C" also encoders; with "T" the temperature is recorded and changes
    limit  by kind; not there where the data cannot show it
    """

    kind: str
    limit: dict[str, float]

    @property
    def here(self) -> float:
        """The limit in the data of its kind."""
        return self.limit[self.kind.removesuffix("T")]


def _size(kind: str, by_hand: float | None, stand: float | None, encoders: float) -> Size:
    limits = {"A": by_hand, "A'": stand, "C": encoders}
    return Size(kind, {data: limit for data, limit in limits.items() if limit is not None})


SIZES: Final = {
    "gyro_g_sensitivity": _size("A'", 7.01e-6, 7.02e-6, 6.47e-6),
    "gyro_g2_sensitivity": _size("A'", 1.63e-6, 1.41e-6, 1.41e-6),
    "gyro_scale_quadratic": _size("A'", 1.39e-4, 5.39e-5, 3.59e-5),
    "gyro_scale_cubic": _size("A'", 1.35e-4, 4.34e-5, 1.73e-5),
    "gyro_scale_asymmetry": _size("A'", 2.19e-4, 1.19e-4, 7.92e-5),
    "gyro_cross_axis_quadratic": _size("A'", 1.49e-4, 5.23e-5, 5.23e-5),
    "gyro_scale_g_sensitivity": _size("A'", 5.83e-5, 3.11e-5, 1.44e-5),
    "gyro_bias_temperature": _size("A'T", 6.80e-6, 6.59e-6, 6.58e-6),
    "gyro_scale_temperature": _size("A'T", 2.71e-5, 1.42e-5, 9.55e-6),
    "gyro_bias_drift": _size("A'", 6.33e-7, 6.18e-7, 6.18e-7),
    "gyro_bias_warmup": _size("A'", 2.27e-4, 2.21e-4, 2.21e-4),
    "gyro_scale_drift": _size("A'", 2.57e-6, 1.22e-6, 7.64e-7),
    "gyro_angular_acceleration": _size("A'", 9.42e-5, 3.50e-5, 2.09e-5),
    "gyro_time_offset": _size("A'", None, 4.46e-5, 4.46e-5),
    "earth_rate": _size("A'", 5.79e-5, 5.81e-5, 5.81e-5),
    "accel_scale_quadratic": _size("A'", 1.39e-5, 9.36e-6, 5.20e-6),
    "accel_scale_cubic": _size("A'", 2.77e-6, 1.69e-6, 9.40e-7),
    "accel_scale_asymmetry": _size("A'", 1.79e-4, 1.11e-4, 4.62e-5),
    "accel_cross_axis_quadratic": _size("C", 1.03e-5, 6.89e-6, 3.17e-6),
    "accel_bias_temperature": _size("A'T", 3.86e-5, 3.12e-5, 3.12e-5),
    "accel_scale_temperature": _size("A'T", 5.97e-6, 4.20e-6, 4.19e-6),
    "accel_bias_drift": _size("A'", 3.44e-6, 3.09e-6, 3.08e-6),
    "accel_bias_warmup": _size("A'", 1.27e-3, 1.12e-3, 1.12e-3),
    "accel_lever_arm": _size("A'", None, 4.31e-5, 4.31e-5),
    "accel_size_effect": _size("A'", None, 6.42e-5, 6.41e-5),
    "encoder_eccentricity": _size("C", None, None, 1.85e-5),
    "encoder_time_offset": _size("C", None, None, 1.70e-5),
    "encoder_backlash": _size("C", None, None, 1.48e-5),
}


def drawn(name: str, rms: float, random: np.random.Generator) -> imucal.EffectValues:
    """The effect in its plain form, in a random direction, with this root mean square per parameter.

    Parameters of different units keep their proportion to the typical sizes; a shape is within a factor of
    1.5 of the typical one.
    """
    effect = imucal.effects.find(name)
    typical = np.array([parameter.typical for parameter in effect.parameters[: effect.plain]])
    direction = random.normal(size=effect.plain)
    direction *= np.sqrt(effect.plain) / np.linalg.norm(direction)
    shape = None if effect.shape is None else effect.shape.typical * 1.5 ** random.uniform(-1.0, 1.0)
    return imucal.EffectValues(name, direction * typical / typical[0] * rms, shape)


def typical(name: str) -> float:
    """What ordinary sensors have."""
    return imucal.effects.find(name).parameters[0].typical
