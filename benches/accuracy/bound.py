"""Cramér-Rao bound of a run: how well any unbiased estimator can know the 21 parameters.

Only the truth is used. d is the error of the attitude seen in the world, of which only the two components
across gravity can be seen; it is unknown at every node, and every node is estimated along.

    from node to node   d' - d + sum R T^-1 (dT w + db) dt      = noise of the gyroscope, x and y
    at a rest           T_a g R^T (z x d) + dT_a f + db_a       = noise of the accelerometer's mean
    at a still rest     db                                      = noise of the gyroscope's mean

T and b are sensitivity and bias, w and f the true rate and specific force in the body, R takes a vector from
the body to the world. A unit that lies on something firm is still: one node for each rest. One that a hand
holds is not, and how it trembles is not known: a node every fifth of a second, and no third line. What the
accelerometer says within the moves is not used, for the way of a hand is not known.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solveh_banded

import imucal

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
NODE_S = 0.2
PARAMETERS = 21


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one sample, m/s^2 and rad/s: white noise, and rounding to counts."""

    accel: float
    gyro: float

    @staticmethod
    def of(unit: imucal.Unit, rate_hz: float) -> "Noise":
        return Noise(
            *(
                np.hypot(sensor.noise_density * np.sqrt(rate_hz), (sensor.lsb or 0.0) / np.sqrt(12.0))
                for sensor in (unit.accelerometer, unit.gyroscope)
            )
        )


def bound(
    truth: imucal.Truth,
    noise: Noise,
    *,
    held: bool = False,
    rests: list[tuple[float, float]] | None = None,
    lost: list[tuple[float, float]] | None = None,
) -> np.ndarray:
    """(21, 21) smallest covariance.

    held   the unit is held by a hand
    rests  start and end of the rests that count, s; all of the truth without it
    lost   stretches in which the gyroscope says nothing
    """
    ranges = [
        np.searchsorted(truth.time_s, (start, end))
        for start, end in (truth.rests if rests is None else rests)
    ]
    dt_s = float(np.median(np.diff(truth.time_s)))
    every = max(1, round(NODE_S / dt_s))
    # A rest is its first and last node, (samples, nodes) with all samples between neighbouring nodes.
    blocks = [np.arange(a, b + 1, every) if held else np.array([a, b]) for a, b in ranges]
    for block, (_, b) in zip(blocks, ranges, strict=True):
        block[-1] = b
    information = _Information(sum(len(block) if held else 1 for block in blocks))
    gone = [np.searchsorted(truth.time_s, stretch) for stretch in lost or []]
    node = 0
    for number, block in enumerate(blocks):
        for first, end in pairwise(block):
            information.add_rest(truth, noise, first, end, node, node + held)
            if held:
                information.add_move(truth, noise, dt_s, first, end, node)
                node += 1
        if not held:
            information.add_still(noise, block[-1] - block[0])
        if number + 1 < len(blocks):
            first, end = block[-1], blocks[number + 1][0]
            if not any(a < end and b > first for a, b in gone):
                information.add_move(truth, noise, dt_s, first, end, node)
            node += 1
    return information.covariance()


class _Information:
    """Normal equations of the 21 parameters and of two components of d at each node.

    Only neighbouring nodes have anything in common.
    """

    def __init__(self, nodes: int) -> None:
        self.own = np.zeros((nodes, 2, 2))
        self.next = np.zeros((nodes, 2, 2))
        self.shared = np.zeros((nodes, 2, PARAMETERS))
        self.parameters = np.zeros((PARAMETERS, PARAMETERS))

    def add_rest(
        self, truth: imucal.Truth, noise: Noise, first: int, end: int, node: int, after: int
    ) -> None:
        """The accelerometer's mean over samples, which lie half way between two nodes or at one."""
        world = _rotation(truth.rotation_wxyz[first:end])
        force = truth.specific_force[first:end].mean(axis=0)
        gravity = truth.calibration.gravity_mps2
        up = world.mean(axis=0)
        across = np.column_stack([-up[1], up[0]]) * gravity
        sigma = noise.accel / np.sqrt(end - first)
        by_node = truth.calibration.accelerometer.sensitivity @ across / sigma
        by_parameters = np.zeros((3, PARAMETERS))
        by_parameters[:, :3] = np.eye(3)
        for column, (i, j) in enumerate(SYMMETRIC, start=3):
            by_parameters[i, column] = force[j]
            by_parameters[j, column] = force[i]
        by_parameters /= sigma
        self.parameters += by_parameters.T @ by_parameters
        nodes = [node] if after == node else [node, after]
        for one in nodes:
            self.own[one] += by_node.T @ by_node / len(nodes) ** 2
            self.shared[one] += by_node.T @ by_parameters / len(nodes)
        if after != node:
            self.next[node] += by_node.T @ by_node / 4.0

    def add_still(self, noise: Noise, samples: int) -> None:
        """The gyroscope's mean over a rest that is known to be still."""
        self.parameters[9:12, 9:12] += np.eye(3) * samples / noise.gyro**2

    def add_move(
        self, truth: imucal.Truth, noise: Noise, dt_s: float, first: int, end: int, node: int
    ) -> None:
        """What the gyroscope says between a node and the next."""
        # Rows x and y of R T^-1, (samples, 2, 3).
        seen = _rotation(truth.rotation_wxyz[first:end])[:, :2] @ np.linalg.inv(
            truth.calibration.gyroscope.sensitivity
        )
        rate = truth.angular_rate[first:end]
        covariance = np.einsum("nij,nkj->ik", seen, seen) * (dt_s * noise.gyro) ** 2
        by_parameters = np.zeros((2, PARAMETERS))
        by_parameters[:, 9:12] = seen.sum(axis=0) * dt_s
        by_parameters[:, 12:] = np.einsum("nij,nk->ijk", seen, rate).reshape(2, 9) * dt_s
        weight = np.linalg.inv(covariance)
        self.parameters += by_parameters.T @ weight @ by_parameters
        self.own[node] += weight
        self.own[node + 1] += weight
        self.next[node] -= weight
        self.shared[node] -= weight @ by_parameters
        self.shared[node + 1] += weight @ by_parameters

    def covariance(self) -> np.ndarray:
        """That of the parameters, with all nodes unknown."""
        count = 2 * len(self.own)
        # Upper form of solveh_banded: row 3 is the diagonal.
        banded = np.zeros((4, count))
        banded[3] = np.diagonal(self.own, axis1=1, axis2=2).ravel()
        banded[2, 1::2] = self.own[:, 0, 1]
        for i in range(2):
            for j in range(2):
                banded[1 - j + i, 2 + j :: 2] = self.next[:-1, i, j]
        shared = self.shared.reshape(count, PARAMETERS)
        left = self.parameters - shared.T @ solveh_banded(banded, shared)
        scale = np.sqrt(np.diag(left))
        return np.linalg.inv(left / np.outer(scale, scale)) / np.outer(scale, scale)


def _rotation(wxyz: np.ndarray) -> np.ndarray:
    """(samples, 3, 3) from the body to the world."""
    w, x, y, z = wxyz.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)
