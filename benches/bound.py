"""Cramér-Rao bound of a simulated run: the smallest covariance of the 21 parameters for unbiased estimators.

The bound uses no part of the estimator and no analytic derivatives: the information matrix comes from finite
differences of noise-free predictions.

Data: for each rest the means of accelerometer and gyroscope; for each move the two components of the
difference between the gravity direction propagated by the gyroscope and the direction at its end. Unknowns:
the 21 parameters, and as nuisance parameters two angles of the gravity direction at each rest. Noise: white
noise and the rounding to counts.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

import imucal

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
STEP = 1e-6


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one sample at rest and in a move, m/s^2 and rad/s."""

    accel: float
    gyro: float


def paper_unit_noise(rate_hz: float) -> Noise:
    """Noise densities in the datasheets of FXOS8700CQ and FXAS21002CQ, and the rounding to their counts.

    The densities are one-sided: the noise of a sample is the density times the root of half the rate.
    """
    g = 9.80665
    bandwidth_hz = rate_hz / 2
    return Noise(
        np.hypot(126e-6 * g * np.sqrt(bandwidth_hz), 2 * g / 8192 / np.sqrt(12)),
        np.hypot(np.radians(0.025) * np.sqrt(bandwidth_hz), np.radians(0.015625) / np.sqrt(12)),
    )


def parameters_of(truth: imucal.Truth) -> np.ndarray:
    return np.array([parameter.value for parameter in truth.calibration.parameters])


def accel_triad(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sensitivity = np.empty((3, 3))
    for (i, j), entry in zip(SYMMETRIC, parameters[3:9], strict=True):
        sensitivity[i, j] = sensitivity[j, i] = entry
    return sensitivity, parameters[:3]


def gyro_triad(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return parameters[12:].reshape(3, 3), parameters[9:12]


def across(direction: np.ndarray) -> np.ndarray:
    """Two unit vectors orthogonal to each direction, (K, 2, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


class SimulatedRun:
    """The noise-free data of a run as a function of parameters and gravity directions."""

    def __init__(self, simulation: imucal.Simulation, gravity_mps2: float) -> None:
        truth, time_s = simulation.truth, simulation.recording.time_s
        self.gravity_mps2 = gravity_mps2
        self.dt_s = float(np.median(np.diff(time_s)))
        ranges = [np.searchsorted(time_s, (start, end)) for start, end in truth.rests]
        self.rest_samples = np.array([end - first for first, end in ranges])
        up = np.array([truth.specific_force[first] for first, _ in ranges])
        self.up = up / np.linalg.norm(up, axis=1, keepdims=True)
        self.across = across(self.up)
        self.theta = parameters_of(truth)
        sensitivity, bias = gyro_triad(self.theta)
        # Noise-free gyroscope samples of each move, (moves, samples, 3); shorter moves are padded with
        # samples of the rest.
        length = max(b[0] - a[1] for a, b in pairwise(ranges)) + 2
        index = np.minimum(
            np.array([a[1] - 1 for a in ranges[:-1]])[:, None] + np.arange(length), len(time_s) - 1
        )
        self.raw_rate = truth.angular_rate[index] @ sensitivity.T + bias
        # The padding has zero duration, so it does not contribute to the integral.
        last = np.array([b[0] for b in ranges[1:]])
        self.step_s = np.where(index[:, 1:] <= last[:, None], self.dt_s, 0.0)

    def turned_up(self, angles: np.ndarray) -> np.ndarray:
        """Gravity directions at the rests, each rotated by two small angles."""
        moved = self.up + np.einsum("kc,kci->ki", angles, self.across)
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)

    def rotations(self, theta: np.ndarray) -> list[Rotation]:
        """Attitude at every sample of a move relative to its start."""
        sensitivity, bias = gyro_triad(theta)
        rate = (self.raw_rate - bias) @ np.linalg.inv(sensitivity).T
        before, after, step = rate[:, :-1], rate[:, 1:], self.step_s[..., None]
        turn = step / 2 * (before + after) + step**2 / 12 * np.cross(before, after)
        attitude = [Rotation.identity(len(turn))]
        for k in range(turn.shape[1]):
            attitude.append(attitude[-1] * Rotation.from_rotvec(turn[:, k]))
        return attitude

    def predictions(self, theta: np.ndarray, angles: np.ndarray, ends: Rotation | None = None) -> np.ndarray:
        """All data as a vector: 3 per rest for each sensor, 2 per move."""
        up = self.turned_up(angles)
        sensitivity, bias = accel_triad(theta)
        force = self.gravity_mps2 * up @ sensitivity.T + bias
        still = np.broadcast_to(theta[9:12], force.shape)
        ends = self.rotations(theta)[-1] if ends is None else ends
        carried = ends.inv().apply(up[:-1]) - up[1:]
        move = np.einsum("kci,ki->kc", self.across[1:], carried)
        return np.concatenate([force.ravel(), still.ravel(), move.ravel()])

    def move_covariances(self, gyro_sigma: float) -> np.ndarray:
        """Covariance of the gravity direction from the samples' white noise over each move, (moves, 2, 2)."""
        attitude = self.rotations(self.theta)
        inverse = np.linalg.inv(gyro_triad(self.theta)[0])
        end = attitude[-1].inv()
        total = np.zeros((len(self.raw_rate), 2, 2))
        for k, here in enumerate(attitude[:-1]):
            # A rotation error at sample k in the frame at the end of the move, where it tilts gravity.
            seen = (end * here).as_matrix() @ inverse
            moved = np.cross(self.up[1:, :, None], seen, axis=1)
            effect = self.across[1:] @ moved * self.step_s[:, k, None, None] * gyro_sigma
            total += effect @ effect.transpose(0, 2, 1)
        return total


def bound(simulation: imucal.Simulation, noise: Noise, gravity_mps2: float = 9.80665) -> np.ndarray:
    """The smallest covariance of an unbiased estimator, (21, 21)."""
    run = SimulatedRun(simulation, gravity_mps2)
    rests = len(run.up)
    none = np.zeros((rests, 2))
    at_truth = run.rotations(run.theta)[-1]
    columns = []
    for p in range(21):
        step = np.zeros(21)
        step[p] = STEP
        ends = at_truth if p < 9 else None  # accelerometer parameters do not change the attitude
        change = run.predictions(run.theta + step, none, ends) - run.predictions(run.theta - step, none, ends)
        columns.append(change / (2 * STEP))
    for k in range(rests):
        for c in range(2):
            angles = none.copy()
            angles[k, c] = STEP
            change = run.predictions(run.theta, angles, at_truth) - run.predictions(
                run.theta, -angles, at_truth
            )
            columns.append(change / (2 * STEP))
    design = np.column_stack(columns)

    means = np.repeat(run.rest_samples, 3)
    whitened = design.copy()
    whitened[: 3 * rests] *= (np.sqrt(means) / noise.accel)[:, None]
    whitened[3 * rests : 6 * rests] *= (np.sqrt(means) / noise.gyro)[:, None]
    factors = np.linalg.cholesky(run.move_covariances(noise.gyro))
    moves = design[6 * rests :].reshape(len(factors), 2, -1)
    whitened[6 * rests :] = np.linalg.solve(factors, moves).reshape(2 * len(factors), -1)

    scale = np.linalg.norm(whitened, axis=0)
    scaled = whitened / scale
    return (np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale))[:21, :21]
