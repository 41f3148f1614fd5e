"""Detection limits predicted without the tool: `python -m gap.limits`.

Nothing of the estimator is used, and no derivative is written down: what an effect does to the data is the
difference of two simulated runs, one with a little of it. Residuals of a run whose unit is perfect:

    1. rest   T_a^-1 (f_k - b_a) - g u_k                 3 per rest
    2. rest   w_k - b_g                                  3 per rest
    3. move   the part of R_k^T u_k - u_(k+1) across u   2 per move
    4. move   T_a^-1 (f(t) - b_a) - g R_k(t)^T u_k       3 per 40 ms, in the data A' only

with u_k the direction of gravity at rest k and R_k(t) the attitude since its end by the gyroscope. Unknown
are the 21 parameters and all u_k. Noise is white; the gyroscope's within a move ties 3 and 4 together.
The limit is the root mean square per parameter at which chi2 sees 90 % of random directions' runs, with the
family-wise alpha shared by all effects.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ncx2

import imucal
from bound import accel_triad, across, gyro_triad, paper_unit_noise, parameters_of
from gap.page import table
from gap.scene import CYCLE, RATE_HZ, by_hand
from gap.sizes import SIZES, G

ALPHA: Final = 0.01
POWER: Final = 0.9
BLOCK: Final = 4
STEP: Final = 1e-6
DIRECTIONS: Final = 300
# A direction counts if ten times the typical effect moves chi2 by 1 along it.
LARGEST: Final = 10.0


@dataclass(frozen=True)
class Cut:
    """The rests and moves of a run, as sample numbers; all moves of the program are of one length."""

    rests: list[tuple[int, int]]
    moves: np.ndarray

    @staticmethod
    def of(run: imucal.Simulation) -> "Cut":
        time_s = run.recording.time_s
        rests = [tuple(int(i) for i in np.searchsorted(time_s, ends)) for ends in run.truth.rests]
        length = max(b[0] - a[1] for a, b in pairwise(rests)) + 2
        first = np.array([end - 1 for _, end in rests[:-1]])
        return Cut(rests, first[:, None] + np.arange(length))


@dataclass(frozen=True)
class Data:
    """What the residuals need of a recording."""

    rest_force: np.ndarray
    rest_rate: np.ndarray
    move_force: np.ndarray
    move_rate: np.ndarray

    @staticmethod
    def of(recording: imucal.Recording, cut: Cut) -> "Data":
        force, rate = recording.specific_force, recording.angular_rate
        return Data(
            np.array([force[a:b].mean(axis=0) for a, b in cut.rests]),
            np.array([rate[a:b].mean(axis=0) for a, b in cut.rests]),
            force[cut.moves],
            rate[cut.moves],
        )


def attitudes(rate: np.ndarray, step_s: float) -> np.ndarray:
    """(moves, samples, 3, 3): attitude since the first sample of each move."""
    before, after = rate[:, :-1], rate[:, 1:]
    turns = step_s / 2 * (before + after) + step_s**2 / 12 * np.cross(before, after)
    here = [Rotation.identity(len(rate))]
    for k in range(turns.shape[1]):
        here.append(here[-1] * Rotation.from_rotvec(turns[:, k]))
    return np.stack([attitude.as_matrix() for attitude in here], axis=1)


class Design:
    """Residuals and their derivatives for one run of a perfect unit."""

    def __init__(
        self, motion: imucal.Program | imucal.Tumble, temperature: imucal.Temperature, in_moves: bool
    ) -> None:
        self.motion, self.temperature, self.in_moves = motion, temperature, in_moves
        run = self.simulate(())
        self.cut, self.step_s = Cut.of(run), 1.0 / RATE_HZ
        self.data = Data.of(run.recording, self.cut)
        self.theta = parameters_of(run.truth)
        self.up = self.data.rest_force / np.linalg.norm(self.data.rest_force, axis=1, keepdims=True)
        self.across = across(self.up)
        self.attitude = attitudes(self.data.move_rate, self.step_s)
        self.roots = self.whitening()
        self.at_truth = self.residuals(self.data, self.theta, self.up)
        self.base = np.linalg.qr(np.column_stack([*self.by_parameter(), *self.by_direction()]))[0]

    def simulate(self, effects: tuple[imucal.EffectValues, ...]) -> imucal.Simulation:
        return imucal.simulate(
            self.motion, unit="ideal", effects=effects, temperature=self.temperature, rate_hz=RATE_HZ, seed=1
        )

    def residuals(self, data: Data, theta: np.ndarray, up: np.ndarray) -> np.ndarray:
        """All residuals, whitened."""
        accel, accel_bias = accel_triad(theta)
        gyro, gyro_bias = gyro_triad(theta)
        to_force, to_rate = np.linalg.inv(accel).T, np.linalg.inv(gyro).T
        rest_force = (data.rest_force - accel_bias) @ to_force - G * up
        rest_rate = data.rest_rate - gyro_bias
        rate = (data.move_rate - gyro_bias) @ to_rate
        same = rate is data.move_rate or np.array_equal(rate, self.data.move_rate)
        attitude = self.attitude if same and hasattr(self, "attitude") else attitudes(rate, self.step_s)
        carried = np.einsum("mtji,mj->mti", attitude, up[:-1])
        ends = np.einsum("mci,mi->mc", self.across[1:], carried[:, -1] - up[1:])
        of_move = [ends]
        if self.in_moves:
            inside = (data.move_force - accel_bias) @ to_force - G * carried
            of_move.append(blocks(inside))
        move = np.einsum("mab,mb->ma", self.roots, np.concatenate(of_move, axis=1))
        counts = np.array([b - a for a, b in self.cut.rests])[:, None]
        noise = paper_unit_noise(RATE_HZ)
        rest = [rest_force / noise.accel * np.sqrt(counts), rest_rate / noise.gyro * np.sqrt(counts)]
        return np.concatenate([rest[0].ravel(), rest[1].ravel(), move.ravel()])

    def whitening(self) -> np.ndarray:
        """(moves, n, n): inverse Cholesky factors of the covariance of the residuals of each move."""
        noise = paper_unit_noise(RATE_HZ)
        roots = []
        for m, attitude in enumerate(self.attitude):
            # An error of the rate at sample s turns what is carried beyond it, seen in the frame of its time.
            carried = np.einsum("tji,j->ti", attitude, self.up[m])
            since = np.einsum("tji,sjk->tsik", attitude, attitude)
            later = np.tri(len(attitude), k=-1)[:, :, None, None]
            moved = later * self.step_s * noise.gyro * np.einsum("tij,tsjk->tsik", skew(carried), since)
            moved = moved.transpose(0, 2, 1, 3).reshape(len(attitude), 3, -1)
            rows = [np.einsum("ci,in->cn", self.across[m + 1], moved[-1])]
            if self.in_moves:
                inside = blocks((-G * moved)[None].transpose(0, 1, 3, 2).reshape(1, len(attitude), -1))
                rows.append(
                    inside.reshape(-1, moved.shape[2], 3).transpose(0, 2, 1).reshape(-1, moved.shape[2])
                )
            covariance = np.concatenate(rows)
            covariance = covariance @ covariance.T
            if self.in_moves:
                covariance[2:, 2:] += np.eye(len(covariance) - 2) * noise.accel**2 / BLOCK
            roots.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        return np.array(roots)

    def by_parameter(self) -> list[np.ndarray]:
        return [
            (self.residuals(self.data, self.theta + STEP * one, self.up) - self.at_truth) / STEP
            for one in np.eye(21)
        ]

    def by_direction(self) -> list[np.ndarray]:
        columns = []
        for k in range(len(self.up)):
            for c in range(2):
                up = self.up.copy()
                up[k] += STEP * self.across[k, c]
                columns.append((self.residuals(self.data, self.theta, up) - self.at_truth) / STEP)
        return columns

    def columns(self, name: str, size: float = 1e-2) -> np.ndarray:
        """What typical sizes of the parameters do, base parameters taken out, (m, p)."""
        effect = imucal.effects.find(name)
        columns = []
        for j in range(effect.plain):
            values = np.zeros(effect.plain)
            values[j] = size * effect.parameters[j].typical
            shape = None if effect.shape is None else effect.shape.typical
            run = self.simulate((imucal.EffectValues(name, values, shape),))
            changed = self.residuals(Data.of(run.recording, self.cut), self.theta, self.up)
            columns.append((changed - self.at_truth) / size)
        found = np.column_stack(columns)
        left: np.ndarray = found - self.base @ (self.base.T @ found)
        return left


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3, 3) with skew(v) w = v x w."""
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)


def blocks(samples: np.ndarray) -> np.ndarray:
    """Means of four samples at a time, (moves, blocks * width); what is left over is left out."""
    count = samples.shape[1] // BLOCK
    whole = samples[:, : count * BLOCK].reshape(len(samples), count, BLOCK, -1)
    return whole.mean(axis=2).reshape(len(samples), -1)


def limit(columns: np.ndarray, effects: int) -> float:
    """The detection limit as a multiple of the typical sizes; infinite if no direction is seen."""
    _, s, vt = np.linalg.svd(columns, full_matrices=False)
    seen = LARGEST * s >= 1.0
    if not seen.any():
        return float("inf")
    threshold = chi2.isf(ALPHA / effects, seen.sum())
    directions = np.random.default_rng(1).normal(size=(DIRECTIONS, columns.shape[1]))
    directions *= np.sqrt(columns.shape[1]) / np.linalg.norm(directions, axis=1, keepdims=True)
    power_of_one = ((directions @ (s[:, None] * vt)[seen].T) ** 2).sum(axis=1)

    def missing(log_size: float) -> float:
        return float(ncx2.sf(threshold, seen.sum(), np.exp(2 * log_size) * power_of_one).mean()) - POWER

    return float(np.exp(brentq(missing, -12.0, 12.0)))


def limits(in_moves: bool, names: list[str]) -> dict[str, float]:
    """SI limits of the effects in one run of the paper's program."""
    made = Design(imucal.Program.random(seed=1) if in_moves else by_hand(1), CYCLE, in_moves)
    return {
        name: limit(made.columns(name), len(SIZES)) * imucal.effects.find(name).parameters[0].typical
        for name in names
    }


def main() -> None:
    names = [name for name in SIZES if not name.startswith("encoder")]
    found = {kind: limits(kind == "A'", names) for kind in ("A", "A'")}
    rows = []
    for name in names:
        cells = [
            f"{found[kind][name]:.3g} ({found[kind][name] / SIZES[name].limit[kind]:.2f})"
            if kind in SIZES[name].limit
            else "-"
            for kind in found
        ]
        rows.append((f"`{name}`", *cells))
    print(table(("limit, SI (over that of the table)", "A", "A'"), rows))


if __name__ == "__main__":
    main()
