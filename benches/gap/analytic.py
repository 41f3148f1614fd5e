"""Recordings made without the product's simulator: attitude by SciPy rotations, everything else in NumPy.

The motion is a sequence of rests and smooth rotations about random axes. The angular rate is the difference
of attitudes a fraction of a millisecond apart, the specific force is gravity in the body frame, and sensors
are `matrix @ (true + error) + bias + noise`. No formula is shared with `imucal.simulate`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

import imucal

RATE_HZ: Final = 100.0
G: Final = 9.80665
DEG: Final = np.pi / 180.0
# Half of the interval over which attitudes are differenced, s.
HALF_STEP_S: Final = 2e-4
# Noise per sample of a consumer sensor, m/s^2 and rad/s.
FORCE_NOISE: Final = 0.012
RATE_NOISE: Final = 1.2e-3
# Noise of an encoder reading, rad.
ENCODER_NOISE_RAD: Final = 1e-4


@dataclass(frozen=True)
class Motion:
    """True motion at each sample: time (N,), rate (N, 3) rad/s, force (N, 3) m/s^2, attitude, rests (N,).

    at         attitude at any times
    stand_rad  angles of the motors (N, 3), for a motion on a stand
    """

    time_s: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    attitude: Rotation
    is_rest: np.ndarray
    at: Callable[[np.ndarray], Rotation]
    stand_rad: np.ndarray | None = None

    def rate_at(self, time_s: np.ndarray) -> np.ndarray:
        """Angular rate at any times, rad/s."""
        before, after = self.at(time_s - HALF_STEP_S), self.at(time_s + HALF_STEP_S)
        rate: np.ndarray = (before.inv() * after).as_rotvec() / (2.0 * HALF_STEP_S)
        return rate


# An error of one sensor as a function of the motion, (N, 3) in SI units.
Error = Callable[[Motion], np.ndarray]


def random_motion(
    random: np.random.Generator, *, rests: int = 46, hold_s: float = 5.0, move_s: float = 2.0
) -> Motion:
    """Rests in random attitudes, connected by rotations about a fixed axis with a smooth angle."""
    turns = [Rotation.random(rng=random) if k == 0 else _turn(random) for k in range(rests)]
    poses = [turns[0]]
    for turn in turns[1:]:
        poses.append(poses[-1] * turn)
    period_s = hold_s + move_s
    time_s = np.arange(round((rests * period_s - move_s) * RATE_HZ)) / RATE_HZ
    vectors = np.array([turn.as_rotvec() for turn in turns[1:]] + [[0.0, 0.0, 0.0]])
    quaternions = np.array([pose.as_quat() for pose in poses])

    def attitude(time_s: np.ndarray) -> Rotation:
        item = np.clip((time_s // period_s).astype(int), 0, rests - 1)
        share = np.clip((time_s - item * period_s - hold_s) / move_s, 0.0, 1.0)
        turned = vectors[item] * _smooth(share)[:, None]
        return Rotation.from_quat(quaternions[item]) * Rotation.from_rotvec(turned)

    return _motion(time_s, attitude, time_s % period_s < hold_s)


def stand_motion(
    random: np.random.Generator, flexure_rad: float = 0.0, *, rests: int = 46, hold_s: float = 5.0
) -> Motion:
    """Rests on a stand with three nested axes x, y, z, whose unit is mounted and whose base is set up askew.

    flexure_rad   angle by which the innermost axis sags under the weight of the unit if it is horizontal
    """
    move_s, period_s = 2.0, hold_s + 2.0
    time_s = np.arange(round((rests * period_s - move_s) * RATE_HZ)) / RATE_HZ
    steps = random.uniform(40.0, 130.0, size=(rests, 3)) * random.choice([-1.0, 1.0], size=(rests, 3)) * DEG
    targets = np.cumsum(steps, axis=0)
    mount = Rotation.from_rotvec(random.normal(size=3) * 0.8 * DEG)
    base = Rotation.from_rotvec([*(random.normal(size=2) * 0.4 * DEG), 0.0])

    def angles(time_s: np.ndarray) -> np.ndarray:
        item = np.clip((time_s // period_s).astype(int), 0, rests - 1)
        share = np.clip((time_s - item * period_s - hold_s) / move_s, 0.0, 1.0)
        after = targets[np.clip(item + 1, 0, rests - 1)]
        found: np.ndarray = targets[item] + (after - targets[item]) * _smooth(share)[:, None]
        return found

    def attitude(time_s: np.ndarray) -> Rotation:
        ring = base * Rotation.from_euler("XYZ", angles(time_s))
        # The ring turns about the horizontal line that is perpendicular to the innermost axis.
        down = np.cross(ring.inv().apply([0.0, 0.0, 1.0]), [0.0, 0.0, 1.0])
        return ring * Rotation.from_rotvec(flexure_rad * down) * mount

    return replace(_motion(time_s, attitude, time_s % period_s < hold_s), stand_rad=angles(time_s))


def _motion(time_s: np.ndarray, attitude: Callable[[np.ndarray], Rotation], is_rest: np.ndarray) -> Motion:
    here, none = attitude(time_s), np.empty((0, 3))
    motion = Motion(time_s, none, here.inv().apply([0.0, 0.0, G]), here, is_rest, attitude)
    return replace(motion, rate=motion.rate_at(time_s))


def _smooth(share: np.ndarray) -> np.ndarray:
    """Share of a move that is done: the third derivative is continuous, and rests are exactly at rest."""
    smooth: np.ndarray = share**4 * (35.0 - 84.0 * share + 70.0 * share**2 - 20.0 * share**3)
    return smooth


def _turn(random: np.random.Generator) -> Rotation:
    axis = random.normal(size=3)
    angle = random.uniform(60.0, 170.0) * DEG
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle)


@dataclass(frozen=True)
class Sensors:
    """Sensor matrices and biases of one unit, drawn once and kept for all of its recordings."""

    force_matrix: np.ndarray
    force_bias: np.ndarray
    rate_matrix: np.ndarray
    rate_bias: np.ndarray

    @staticmethod
    def random(random: np.random.Generator) -> "Sensors":
        def matrix() -> np.ndarray:
            return np.eye(3) + random.normal(scale=0.01, size=(3, 3))

        force_matrix = matrix()
        return Sensors(
            0.5 * (force_matrix + force_matrix.T),
            random.normal(scale=0.2, size=3),
            matrix(),
            random.normal(scale=0.02, size=3),
        )


def measured(
    sensors: Sensors,
    motion: Motion,
    random: np.random.Generator,
    *,
    rate_error: tuple[Error, ...] = (),
    force_error: tuple[Error, ...] = (),
    temperature_degc: float | np.ndarray | None = None,
    louder_in_moves: tuple[float, float] = (1.0, 1.0),
    name: str = "measured",
) -> imucal.Recording:
    """One recording of a unit with these errors.

    louder_in_moves   noise in moves over noise at rest, of the gyroscope and of the accelerometer
    """
    loud = [np.where(motion.is_rest, 1.0, factor)[:, None] for factor in louder_in_moves]
    count = len(motion.time_s)
    rate = motion.rate + np.sum([np.zeros((count, 3)), *(error(motion) for error in rate_error)], axis=0)
    force = motion.force + np.sum([np.zeros((count, 3)), *(error(motion) for error in force_error)], axis=0)
    rate_noise = loud[0] * random.normal(scale=RATE_NOISE, size=(count, 3))
    rate = rate @ sensors.rate_matrix.T + sensors.rate_bias + rate_noise
    force_noise = loud[1] * random.normal(scale=FORCE_NOISE, size=(count, 3))
    force = force @ sensors.force_matrix.T + sensors.force_bias + force_noise
    degc = None if temperature_degc is None else np.broadcast_to(temperature_degc, count) + 0.0
    if degc is not None:
        degc = degc + random.normal(scale=0.02, size=count)
    stand_rad = motion.stand_rad
    if stand_rad is not None:
        stand_rad = stand_rad + random.normal(scale=ENCODER_NOISE_RAD, size=stand_rad.shape)
    return imucal.Recording(motion.time_s, force, rate, temperature_degc=degc, stand_rad=stand_rad, name=name)


def walk(random: np.random.Generator, per_sqrt_s: float) -> Error:
    """A bias that walks randomly, independently on each axis; `per_sqrt_s` in SI units."""
    step = per_sqrt_s / np.sqrt(RATE_HZ)
    return lambda motion: np.cumsum(random.normal(scale=step, size=(len(motion.time_s), 3)), axis=0)


def heading(random: np.random.Generator, size_radps: float) -> Error:
    """A gyroscope bias that follows the directions of two horizontal axes of the room."""
    matrix = random.normal(size=(3, 2))
    matrix *= size_radps * np.sqrt(6.0) / np.linalg.norm(matrix)
    axes = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))

    def bias(motion: Motion) -> np.ndarray:
        inverse = motion.attitude.inv()
        return np.sum([inverse.apply(axis) * matrix[:, k] for k, axis in enumerate(axes)], axis=0)

    return bias
