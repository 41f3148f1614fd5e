"""Effects that the catalogue does not have, and effects that it has in another form.

Sizes are five to fifteen times what would be seen of a drift.
"""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

import imucal
from gap.case import Answer, Case, generator
from gap.scene import Added, Scene
from gap.sizes import DEG, G

Random = np.random.Generator
# The field of the Earth in the world frame, as a direction: 67 deg of dip.
MAGNETIC: Final = np.array([0.39, 0.0, -0.92])


def gyro_bias_size(random: Random) -> np.ndarray:
    return random.uniform(0.02, 0.06) * DEG * unit_vector(random)


def accel_bias_size(random: Random) -> np.ndarray:
    return random.uniform(0.2, 0.6) * 1e-3 * G * unit_vector(random)


def unit_vector(random: Random) -> np.ndarray:
    """Three numbers with a root mean square of 1."""
    vector = random.normal(size=3)
    return vector * np.sqrt(3.0) / np.linalg.norm(vector)


def in_body(rotation_wxyz: np.ndarray, world: np.ndarray) -> np.ndarray:
    """A vector of the world, (3,), seen in the body frame at each sample, (N, 3)."""
    w, axis = rotation_wxyz[:, :1], -rotation_wxyz[:, 1:]
    once = np.cross(axis, np.broadcast_to(world, axis.shape))
    return world + 2.0 * (w * once + np.cross(axis, once))


def magnetic_coupling(random: Random) -> Added:
    """The gyroscope's bias follows the direction of the magnetic field."""
    matrix = random.normal(size=(3, 3)) * random.uniform(0.03, 0.08) * DEG
    return "gyroscope", lambda state: in_body(state.rotation_wxyz, MAGNETIC) @ matrix.T


def motor_ripple(random: Random) -> Added:
    """Magnets of the motors: a bias that goes up and down several times per turn."""
    size, times = gyro_bias_size(random) * np.sqrt(2.0), random.integers(3, 8)
    phase = random.uniform(0.0, 2.0 * np.pi, size=3)
    return "gyroscope", lambda state: size * np.sin(times * state.stand_rad + phase)


def hysteresis(random: Random) -> Added:
    """The accelerometer's bias keeps the sign of the last rate about its axis."""
    size = accel_bias_size(random)
    return "accelerometer", lambda state: size * last_sign(state.angular_rate, 5.0 * DEG)


def last_sign(values: np.ndarray, least: float) -> np.ndarray:
    """Sign of the last value of a column beyond `least`, 0 before any."""
    sign = np.where(np.abs(values) > least, np.sign(values), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(values))[:, None], 0), axis=0)
    kept: np.ndarray = np.take_along_axis(sign, last, axis=0)
    return kept


def supply_coupling(random: Random) -> Added:
    """A load that switches on and off makes the supply sag, and the gyroscope's bias with it."""
    size, period_s = gyro_bias_size(random) * 2.0, random.uniform(40.0, 90.0)
    on, phase = random.uniform(0.3, 0.7), random.uniform()
    return "gyroscope", lambda state: size * ((state.time_s / period_s + phase) % 1.0 < on)[:, None]


def slow_sine(random: Random) -> Added:
    """The gyroscope's bias swings slowly."""
    return "gyroscope", _sine(gyro_bias_size(random), random)


def slow_sine_of_force(random: Random) -> Added:
    """The accelerometer's bias swings slowly."""
    return "accelerometer", _sine(accel_bias_size(random), random)


def _sine(size: np.ndarray, random: Random) -> Callable[[imucal.State], np.ndarray]:
    period_s, phase = random.uniform(60.0, 150.0), random.uniform(0.0, 2.0 * np.pi)
    return lambda state: size * np.sqrt(2.0) * np.sin(2.0 * np.pi * state.time_s / period_s + phase)[:, None]


def scale_sine(random: Random) -> Added:
    """The gyroscope's scale swings slowly."""
    swing = _sine(random.uniform(2e-3, 6e-3) * unit_vector(random), random)
    return "gyroscope", lambda state: swing(state) * state.angular_rate


def saturating_g_sensitivity(random: Random) -> Added:
    """A g-sensitivity that gives way beyond half a g."""
    matrix = random.normal(size=(3, 3)) * random.uniform(0.05, 0.15) * DEG
    return "gyroscope", lambda state: 0.5 * np.tanh(state.specific_force / (0.5 * G)) @ matrix.T


def two_warm_ups(random: Random) -> Added:
    """A package that warms up fast on a board that warms up slowly."""
    fast, slow = (random.uniform(0.1, 0.3) * DEG * unit_vector(random) for _ in range(2))
    return (
        "gyroscope",
        lambda state: (
            fast * np.exp(-state.time_s / 15.0)[:, None] + slow * np.exp(-state.time_s / 150.0)[:, None]
        ),
    )


def piecewise_asymmetry(random: Random) -> Added:
    """Another scale for positive rates, from 40 deg/s on."""
    size = random.uniform(2e-3, 6e-3) * unit_vector(random)
    return "gyroscope", lambda state: size * np.maximum(state.angular_rate - 40.0 * DEG, 0.0)


OUTSIDE: Final = {
    "magnetic coupling": (magnetic_coupling, "gyroscope bias"),
    "motor-angle ripple": (motor_ripple, "gyroscope bias"),
    "hysteresis by last motion": (hysteresis, "accelerometer bias"),
    "supply coupling": (supply_coupling, "gyroscope bias"),
    "slow sine, gyroscope": (slow_sine, "gyroscope bias"),
    "slow sine, accelerometer": (slow_sine_of_force, "accelerometer bias"),
    "slow sine, gyroscope scale": (scale_sine, "gyroscope scale"),
}
# In another form than in the catalogue: the name of what is alike is right, and so is that it is unknown.
OFF_FORM: Final = {
    "saturating g-sensitivity": (
        saturating_g_sensitivity, ("gyro_g_sensitivity",), "gyroscope bias"
    ),
    "warm-up with two time constants": (
        two_warm_ups, ("gyro_bias_warmup",), "gyroscope bias"
    ),
    "asymmetry from 40 deg/s on": (
        piecewise_asymmetry, ("gyro_scale_asymmetry", "gyro_scale_quadratic"), "gyroscope scale"
    ),
}  # fmt: skip
UNKNOWN: Final = ("unknown", "stochastic")


def outside(runs: int) -> Iterator[Case]:
    """What no row of the catalogue describes."""
    for label, (make, block) in OUTSIDE.items():
        for index in range(runs):
            scene = Scene("A'", added=(make(generator("outside", label, index)),))
            yield Case("outside", label, index, scene, Answer(verdicts=UNKNOWN, block=block))
    for index in range(runs):
        random = generator("outside", "flexure", index)
        stand = imucal.Stand(
            mount_rotation_deg=(0.8, -1.1, 0.6), base_tilt_deg=(0.4, -0.3),
            encoder_noise_deg=0.005, flexure_deg=random.uniform(0.05, 0.15),
        )  # fmt: skip
        answer = Answer(verdicts=UNKNOWN, block="encoder")
        yield Case("outside", "stand flexure", index, Scene("C", stand=stand), answer)


def off_form(runs: int) -> Iterator[Case]:
    """What a row of the catalogue describes roughly."""
    for label, (make, names, block) in OFF_FORM.items():
        for index in range(runs):
            scene = Scene("A'", added=(make(generator("off form", label, index)),))
            answer = Answer(verdicts=("named", "ambiguous", *UNKNOWN), names=names, block=block)
            yield Case("off form", label, index, scene, answer)
