"""How large an effect must be to be seen (MDE), and how large it usually is, in SI units.

The MDE is the smallest root mean square per parameter that is seen with 90 % power (family-wise alpha 0.01)
in one run of 46 rests at the noise of the paper's unit. The numbers are those of a prototype; `limits`
predicts them again. Temperature goes up and down within the run, as `scene.CYCLE` says.
"""

from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

import imucal

G: Final = imucal.recording.STANDARD_GRAVITY_MPS2
DEG: Final = radians(1.0)
PPM: Final = 1e-6


@dataclass(frozen=True)
class Size:
    """The data that show an effect, and its MDE in those data.

    kind  "A" rests and moves, "A'" also the accelerometer within the moves, "C" also encoders; with "T" the
          temperature is recorded and changes
    """

    kind: str
    mde: dict[str, float]

    @property
    def here(self) -> float:
        """The MDE in the least data that show it."""
        return self.mde[self.kind.removesuffix("T")]


def _size(kind: str, unit: float, a: float, a_moves: float | None = None, c: float | None = None) -> Size:
    a_moves = a if a_moves is None else a_moves
    return Size(kind, {"A": a * unit, "A'": a_moves * unit, "C": (a_moves if c is None else c) * unit})


SIZES: Final = {
    "gyro_g_sensitivity": _size("A", DEG / G, 0.0040, 0.0038, 0.0035),
    "gyro_g2_sensitivity": _size("A", DEG / G**2, 0.007),
    "gyro_scale_quadratic": _size("A", 0.01 / (250 * DEG), 0.04, 0.03, 0.02),
    "gyro_scale_cubic": _size("A", 1.0, 7.1e-5, 4.5e-5, 1.8e-5),
    "gyro_scale_asymmetry": _size("A", PPM, 190, 150, 100),
    "gyro_cross_axis_quadratic": _size("A", 1.0, 1.2e-4),
    "gyro_scale_g_sensitivity": _size("A", PPM / G, 600, 390, 180),
    "gyro_bias_temperature": _size("AT", DEG, 0.0006),
    "gyro_scale_temperature": _size("AT", PPM, 96, 70, 47),
    "gyro_bias_drift": _size("A", DEG / 100, 0.0037),
    "gyro_bias_warmup": _size("A", DEG, 0.017),
    "gyro_scale_drift": _size("A", PPM / 100, 220, 160, 100),
    "gyro_angular_acceleration": _size("A'", 1.0, 7.6e-5, 5e-5, 3e-5),
    "gyro_time_offset": _size("A'", 1e-6, 65),
    "earth_rate": _size("A", 7.292e-5, 0.8),
    "accel_scale_quadratic": _size("A", 1 / G, 1.2e-4, 9e-5, 5e-5),
    "accel_scale_cubic": _size("A", 1 / G**2, 2.4e-4, 1.8e-4, 1.0e-4),
    "accel_scale_asymmetry": _size("A", PPM, 160, 120, 50),
    "accel_cross_axis_quadratic": _size("C", 1 / G, 9e-5, 6.5e-5, 3e-5),
    "accel_bias_temperature": _size("AT", 1e-6 * G, 6.0),
    "accel_scale_temperature": _size("AT", PPM, 21),
    "accel_bias_drift": _size("A", 1e-8 * G, 39),
    "accel_bias_warmup": _size("A", 1e-6 * G, 180),
    "accel_lever_arm": _size("A'", 1e-6, 57),
    "accel_size_effect": _size("A'", 1e-6, 84),
    "encoder_eccentricity": _size("C", DEG, 0.0015),
    "encoder_time_offset": _size("C", 1e-6, 24),
    "encoder_backlash": _size("C", DEG, 0.0012),
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
