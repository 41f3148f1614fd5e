"""The same calibration as a SciPy program, to which `compare.py` compares imucal.

Model and rests are those of imucal: rests from the variance in a sliding window, nine accelerometer
parameters fitted to the means of the rests, gyroscope bias from all rests, nine gyroscope parameters from
gravity propagated from rest to rest, standard deviations from the Jacobians. Both fits use
`scipy.optimize.least_squares`. The accelerometer has an analytic Jacobian. The gyroscope is integrated over
all moves at once, with one NumPy operation per level of a product tree.

It has no checks of the data, no outlier rejection, no model of hand tremor, and needs a nominal scale of the
gyroscope as a start value.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.optimize import OptimizeResult, least_squares

BLOCK_S = 0.05
WINDOW_BLOCKS = 10
# Upper triangle of the symmetric matrix P in `f = P (a - b)`.
ROWS, COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])


@dataclass(frozen=True)
class PeerResult:
    """`measured = T true + bias`. Rests are (K, 2) sample ranges; standard deviations of biases, then
    entries.
    """

    rests: np.ndarray
    accel_sensitivity: np.ndarray
    accel_bias: np.ndarray
    accel_std: np.ndarray
    gyro_sensitivity: np.ndarray
    gyro_bias: np.ndarray
    gyro_std: np.ndarray


def calibrate(
    time_s: np.ndarray,
    force: np.ndarray,
    rate: np.ndarray,
    *,
    gravity_mps2: float,
    gyro_nominal: float,
    rests: np.ndarray | None = None,
) -> PeerResult:
    """Calibrate from (N,) times and (N, 3) raw samples; finds the rests unless they are given."""
    dt_s = float(np.median(np.diff(time_s)))
    if rests is None:
        rests = find_rests(np.hstack([rate, force]), dt_s)
    lengths = rests[:, 1] - rests[:, 0]
    force_means, force_variance = rest_moments(force, rests)
    rate_means, rate_variance = rest_moments(rate, rests)

    accelerometer = fit_accelerometer(force_means, force_variance / lengths[:, None], gravity_mps2)
    accel_inverse, accel_bias = symmetric(accelerometer.x[3:]), accelerometer.x[:3]
    force_at_rest = (force_means - accel_bias) @ accel_inverse
    up = force_at_rest / np.linalg.norm(force_at_rest, axis=1, keepdims=True)

    gyro_bias = rate_means.mean(axis=0)
    first, last = rests[:-1, 1] - 1, rests[1:, 0]
    density = np.sqrt(np.median(rate_variance, axis=0).mean() * dt_s) / gyro_nominal
    sigma = density * np.sqrt(time_s[last] - time_s[first])
    gyroscope = fit_gyroscope(Moves(time_s, rate - gyro_bias, first, last), up, sigma, gyro_nominal)
    gyro_sensitivity = np.linalg.inv(gyroscope.x.reshape(3, 3))

    # Jacobian from the entries of the inverse P to those of T = P^-1: dT = -T dP T.
    accel_sensitivity = np.linalg.inv(accel_inverse)
    shape = np.zeros((9, 6))
    shape[3 * ROWS + COLUMNS, np.arange(6)] = shape[3 * COLUMNS + ROWS, np.arange(6)] = 1.0
    to_t = -np.kron(accel_sensitivity, accel_sensitivity) @ shape
    accel_jacobian = np.zeros((9, 9))
    accel_jacobian[:3, :3] = np.eye(3)
    accel_jacobian[3:, 3:] = to_t[3 * ROWS + COLUMNS]
    return PeerResult(
        rests,
        accel_sensitivity,
        accel_bias,
        standard_deviations(accelerometer, accel_jacobian),
        gyro_sensitivity,
        gyro_bias,
        np.concatenate(
            [
                rate_means.std(axis=0, ddof=1) / np.sqrt(len(rests)),
                standard_deviations(gyroscope, -np.kron(gyro_sensitivity, gyro_sensitivity.T)),
            ]
        ),
    )


# --- rests ---


def find_rests(channels: np.ndarray, dt_s: float, min_rest_s: float = 1.0) -> np.ndarray:
    """Sample ranges of the rests, for the threshold in the widest range with the same number of rests."""
    block = max(round(BLOCK_S / dt_s), 1)
    min_blocks = round(min_rest_s / (block * dt_s))
    blocks = (channels - channels[0])[: len(channels) // block * block].reshape(-1, block, channels.shape[1])
    sums, squares = blocks.sum(axis=1), np.einsum("nbc,nbc->nc", blocks, blocks)
    window_sum = sliding_window_view(sums, WINDOW_BLOCKS, axis=0).sum(axis=-1)
    window_squares = sliding_window_view(squares, WINDOW_BLOCKS, axis=0).sum(axis=-1)
    samples = block * WINDOW_BLOCKS
    variance = (window_squares - window_sum**2 / samples) / (samples - 1)
    statistic = (variance / np.quantile(variance, 0.05, axis=0)).mean(axis=1)
    floor = np.median(variance[statistic <= 2 * np.quantile(statistic, 0.05)], axis=0)
    statistic = (variance / floor).mean(axis=1)

    def stretches(threshold: float) -> np.ndarray:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], statistic < threshold, [False]])))
        start, end = edges[::2], edges[1::2] + WINDOW_BLOCKS - 1
        apart = start[1:] > end[:-1]  # overlapping windows belong to one rest
        start, end = start[np.append(True, apart)], end[np.append(apart, True)]
        start, end = start + (start > 0), end - (end < len(blocks))
        return np.column_stack([start, end])[end - start >= min_blocks]

    thresholds = np.geomspace(1.5, np.sqrt(statistic.max()), 60)
    counts = np.array([len(stretches(threshold)) for threshold in thresholds])
    changes = np.flatnonzero(np.diff(counts)) + 1
    plateaus = np.column_stack([np.append(0, changes), np.append(changes, len(counts))])
    plateaus = plateaus[counts[plateaus[:, 0]] > 0]
    start, end = plateaus[np.argmax(plateaus[:, 1] - plateaus[:, 0])]
    return stretches(thresholds[start + (end - start) // 4]) * block


def rest_moments(samples: np.ndarray, rests: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of each rest."""
    parts = [samples[start:end] for start, end in rests]
    return np.array([p.mean(axis=0) for p in parts]), np.array([p.var(axis=0, ddof=1) for p in parts])


# --- fits ---


def symmetric(entries: np.ndarray) -> np.ndarray:
    matrix = np.empty((3, 3))
    matrix[ROWS, COLUMNS] = matrix[COLUMNS, ROWS] = entries
    return matrix


def fit_accelerometer(means: np.ndarray, variance_of_mean: np.ndarray, gravity_mps2: float) -> OptimizeResult:
    """Minimise (|P (a - b)| - g) / sigma over `[b, P]`."""
    low, high = means.min(axis=0), means.max(axis=0)
    scale = (high - low).max() / 2 / gravity_mps2
    start = np.concatenate([(low + high) / 2, np.full(3, 1 / scale), np.zeros(3)])
    direction = means - start[:3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sigma = np.sqrt((direction**2 * variance_of_mean).sum(axis=1)) / scale

    def residuals(x: np.ndarray) -> np.ndarray:
        return (np.linalg.norm((means - x[:3]) @ symmetric(x[3:]), axis=1) - gravity_mps2) / sigma

    def jacobian(x: np.ndarray) -> np.ndarray:
        inverse, offset = symmetric(x[3:]), means - x[:3]
        force = offset @ inverse
        up = force / np.linalg.norm(force, axis=1, keepdims=True)
        by_entry = up[:, ROWS] * offset[:, COLUMNS] + (ROWS != COLUMNS) * up[:, COLUMNS] * offset[:, ROWS]
        return np.hstack([-up @ inverse, by_entry]) / sigma[:, None]

    return least_squares(residuals, start, jacobian, method="lm", x_scale="jac")


class Moves:
    """All moves as (moves, steps) arrays, padded with steps of zero duration."""

    def __init__(self, time_s: np.ndarray, rate: np.ndarray, first: np.ndarray, last: np.ndarray) -> None:
        index = np.minimum(first[:, None] + np.arange((last - first).max() + 1), last[:, None])
        self.dt_s = np.diff(time_s[index], axis=1)[..., None]
        self.rate = rate[index]

    def rotations(self, inverse: np.ndarray) -> np.ndarray:
        """Quaternion (w, x, y, z) of each move, from its end to its start."""
        rate = self.rate @ inverse.T
        before, after = rate[:, :-1], rate[:, 1:]
        turn = self.dt_s / 2 * (before + after) + self.dt_s**2 / 12 * cross(before, after)
        half = np.sqrt((turn**2).sum(axis=-1, keepdims=True)) / 2
        steps = np.concatenate([np.cos(half), turn * (np.sinc(half / np.pi) / 2)], axis=-1)
        while steps.shape[1] > 1:
            odd = steps[:, -1:] if steps.shape[1] % 2 else steps[:, :0]
            steps = np.concatenate([product(steps[:, :-1:2], steps[:, 1::2]), odd], axis=1)
        return steps[:, 0]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over a last axis of three, several times faster than `numpy.cross`."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (aw, ax, ay, az), (bw, bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def fit_gyroscope(moves: Moves, up: np.ndarray, sigma: np.ndarray, nominal: float) -> OptimizeResult:
    """Minimise propagated minus measured gravity over the nine entries of P in `w = P (m - b)`."""
    before, after = up[:-1], up[1:]

    def residuals(entries: np.ndarray) -> np.ndarray:
        q = moves.rotations(entries.reshape(3, 3) / nominal)
        w, v = q[:, :1], -q[:, 1:]
        t = 2 * cross(v, before)
        return ((before + w * t + cross(v, t) - after) / sigma[:, None]).ravel()

    result = least_squares(residuals, np.eye(3).ravel(), method="lm", x_scale="jac")
    result.x = result.x / nominal
    result.jac = result.jac * nominal
    return result


def standard_deviations(result: OptimizeResult, jacobian: np.ndarray) -> np.ndarray:
    """Standard deviations of `jacobian @ x`, scaled up if the residuals exceed their noise."""
    scale = np.linalg.norm(result.jac, axis=0)
    covariance = np.linalg.inv((result.jac / scale).T @ (result.jac / scale)) / np.outer(scale, scale)
    freedom = max(len(result.fun) - len(result.x), 1)
    covariance *= max(2 * result.cost / freedom, 1.0)
    return np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
