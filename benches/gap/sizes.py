"""How large an effect must be to be seen, and how large it usually is, in SI units.

The detection limit is the smallest root mean square per parameter that is seen with 90 % power (family-wise
alpha 0.01) in one run at the noise of the paper's unit: `limits` predicts it from differences of simulated
runs, without the tool. Where it does not reach (all data with encoders), the numbers are those of an earlier
study. In the data that `limits` reaches the tool sees what is within a tenth of the limit or better; with
encoders it needs 1.7 to 2.1 times the number here, for all four effects alike.
The temperature goes up and down within the run, as `scene.CYCLE` says.

The numbers are for noise densities of the data sheets read as two-sided. They are now read as one-sided, so
the true limits are smaller by a factor of 1.4.
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
    "gyro_g_sensitivity": _size("A'", 9.91e-6, 9.93e-6, 9.15e-6),
    "gyro_g2_sensitivity": _size("A'", 2.30e-6, 1.99e-6, 1.99e-6),
    "gyro_scale_quadratic": _size("A'", 1.96e-4, 7.62e-5, 5.08e-5),
    "gyro_scale_cubic": _size("A'", 1.91e-4, 6.14e-5, 2.45e-5),
    "gyro_scale_asymmetry": _size("A'", 3.09e-4, 1.68e-4, 1.12e-4),
    "gyro_cross_axis_quadratic": _size("A'", 2.11e-4, 7.39e-5, 7.39e-5),
    "gyro_scale_g_sensitivity": _size("A'", 8.24e-5, 4.40e-5, 2.03e-5),
    "gyro_bias_temperature": _size("A'T", 9.62e-6, 9.31e-6, 9.31e-6),
    "gyro_scale_temperature": _size("A'T", 3.83e-5, 2.01e-5, 1.35e-5),
    "gyro_bias_drift": _size("A'", 8.95e-7, 8.74e-7, 8.74e-7),
    "gyro_bias_warmup": _size("A'", 3.21e-4, 3.13e-4, 3.13e-4),
    "gyro_scale_drift": _size("A'", 3.63e-6, 1.73e-6, 1.08e-6),
    "gyro_angular_acceleration": _size("A'", 1.33e-4, 4.94e-5, 2.96e-5),
    "gyro_time_offset": _size("A'", None, 6.31e-5, 6.31e-5),
    "earth_rate": _size("A'", 8.19e-5, 8.22e-5, 8.22e-5),
    "accel_scale_quadratic": _size("A'", 1.97e-5, 1.32e-5, 7.35e-6),
    "accel_scale_cubic": _size("A'", 3.91e-6, 2.39e-6, 1.33e-6),
    "accel_scale_asymmetry": _size("A'", 2.53e-4, 1.57e-4, 6.53e-5),
    "accel_cross_axis_quadratic": _size("C", 1.46e-5, 9.74e-6, 4.49e-6),
    "accel_bias_temperature": _size("A'T", 5.45e-5, 4.41e-5, 4.41e-5),
    "accel_scale_temperature": _size("A'T", 8.42e-6, 5.93e-6, 5.93e-6),
    "accel_bias_drift": _size("A'", 4.86e-6, 4.36e-6, 4.36e-6),
    "accel_bias_warmup": _size("A'", 1.80e-3, 1.58e-3, 1.58e-3),
    "accel_lever_arm": _size("A'", None, 6.09e-5, 6.09e-5),
    "accel_size_effect": _size("A'", None, 9.07e-5, 9.07e-5),
    "encoder_eccentricity": _size("C", None, None, 2.62e-5),
    "encoder_time_offset": _size("C", None, None, 2.40e-5),
    "encoder_backlash": _size("C", None, None, 2.09e-5),
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
