"""Detection limits predicted without the tool: `python -m gap.limits` writes limits.json.

Nothing of the estimator is used, and no derivative is written down: what an effect does to the data is the
difference of two simulated runs, one with a little of it. Residuals of a run whose unit is perfect:

    1. rest   T_a^-1 (f_k - b_a) - g u_k                 3 per rest
    2. rest   w_k - b_g                                  3 per rest
    3. move   the part of R_k^T u_k - u_(k+1) across u   2 per move
    4. move   T_a^-1 (f(t) - b_a) - g R_k(t)^T u_k       3 per 40 ms, in the data A' and C
    5. rest   the part of C_k^T e_z - u_k across u_k     2 per rest, in the data C
    6. move   log(R_k(t)^T C_k^T C(t))                   3 per 40 ms, in the data C instead of 3

with u_k the direction of gravity at rest k, R_k(t) the attitude since its end by the gyroscope, and C the
attitude of a perfect stand with the angles of the encoders. Unknown are the 21 parameters and all u_k, in the
data C also the eight angles of the stand. Noise is white; the gyroscope's within a move ties 3, 4 and 6
together. The noise of C_k, a mean over a rest, is neglected in 6. The limit is the root mean square per
parameter at which chi2 sees 90 % of random directions' runs, with the family-wise alpha shared by all
effects.
"""

import json
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ncx2

import imucal
from bound import accel_triad, across, gyro_triad, paper_unit_noise, parameters_of
from gap.kinds import KINDS, LIMITS, shown
from gap.scene import CROOKED, CYCLE, RATE_HZ, by_hand
from imucal.units import STANDARD_GRAVITY_MPS2 as G

ALPHA: Final = 0.01
POWER: Final = 0.9
BLOCK: Final = 4
STEP: Final = 1e-6
DIRECTIONS: Final = 300
# A direction counts if ten times the typical effect moves chi2 by 1 along it.
LARGEST: Final = 10.0
DIGITS: Final = 3
# The angles of a stand by which its errors are simulated, and how many of each there are.
STAND: Final = {"mount_rotation_deg": 3, "base_tilt_deg": 2, "non_orthogonality_deg": 2}
STAND_DEG: Final = 1e-3
ENCODER_RAD: Final = np.radians(CROOKED.encoder_noise_deg)


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
    rest_angle_rad: np.ndarray
    move_angle_rad: np.ndarray

    @staticmethod
    def of(recording: imucal.Recording, cut: Cut) -> "Data":
        force, rate = recording.specific_force, recording.angular_rate
        # By hand there are no angles, and nothing uses these.
        angle = np.zeros_like(rate) if recording.stand_rad is None else recording.stand_rad
        return Data(
            np.array([force[a:b].mean(axis=0) for a, b in cut.rests]),
            np.array([rate[a:b].mean(axis=0) for a, b in cut.rests]),
            force[cut.moves],
            rate[cut.moves],
            np.array([angle[a:b].mean(axis=0) for a, b in cut.rests]),
            angle[cut.moves],
        )

    @cached_property
    def rest_stand(self) -> np.ndarray:
        """(rests, 3, 3): attitude at each rest by the encoders."""
        return of_stand(self.rest_angle_rad)

    @cached_property
    def turned_by_stand(self) -> np.ndarray:
        """(moves, samples, 3, 3): attitude since the rest before each move by the encoders."""
        return transposed(self.rest_stand[:-1, None]) @ of_stand(self.move_angle_rad)


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
        self, motion: imucal.Program | imucal.Tumble, temperature: imucal.Temperature, kind: str
    ) -> None:
        self.motion, self.temperature = motion, temperature
        self.in_moves, self.has_encoders = kind != "A", kind == "C"
        run = self.simulate(())
        self.cut, self.step_s = Cut.of(run), 1.0 / RATE_HZ
        self.data = Data.of(run.recording, self.cut)
        self.theta = parameters_of(run.truth)
        self.up = self.data.rest_force / np.linalg.norm(self.data.rest_force, axis=1, keepdims=True)
        self.across = across(self.up)
        self.attitude = attitudes(self.data.move_rate, self.step_s)
        self.roots = self.whitening()
        self.stand_roots = self.stand_whitening() if self.has_encoders else None
        self.at_truth = self.residuals(self.data, self.theta, self.up)
        base = [*self.by_parameter(), *self.by_direction(), *self.by_stand()]
        self.base = np.linalg.qr(np.column_stack(base))[0]

    def simulate(
        self, effects: tuple[imucal.EffectValues, ...], stand: imucal.Stand | None = None
    ) -> imucal.Simulation:
        return imucal.simulate(
            self.motion, unit="ideal", effects=effects, temperature=self.temperature, rate_hz=RATE_HZ, seed=1,
            stand=stand,
        )  # fmt: skip

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
        of_move = [] if self.has_encoders else [ends]
        if self.in_moves:
            inside = (data.move_force - accel_bias) @ to_force - G * carried
            of_move.append(blocks(inside))
        by_stand = np.zeros(0)
        if self.has_encoders:
            of_move.append(blocks(small_turn(transposed(attitude) @ data.turned_by_stand)))
            off_up = np.einsum("kci,ki->kc", self.across, data.rest_stand[:, 2] - up)
            by_stand = np.einsum("kab,kb->ka", self.stand_roots, off_up)
        move = np.einsum("mab,mb->ma", self.roots, np.concatenate(of_move, axis=1))
        counts = np.array([b - a for a, b in self.cut.rests])[:, None]
        noise = paper_unit_noise(RATE_HZ)
        rest = [rest_force / noise.accel * np.sqrt(counts), rest_rate / noise.gyro * np.sqrt(counts)]
        return np.concatenate([rest[0].ravel(), rest[1].ravel(), move.ravel(), by_stand.ravel()])

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
            rows = [] if self.has_encoders else [np.einsum("ci,in->cn", self.across[m + 1], moved[-1])]
            own = [np.zeros((len(each), len(each))) for each in rows]
            if self.in_moves:
                rows.append(rows_of_blocks(-G * moved))
                own.append(np.eye(len(rows[-1])) * noise.accel**2 / BLOCK)
            if self.has_encoders:
                turned = (later * self.step_s * noise.gyro * since).transpose(0, 2, 1, 3)
                rows.append(rows_of_blocks(-turned.reshape(len(attitude), 3, -1)))
                by_motor = blocks(turn_by_motor(self.data.move_angle_rad[m])[None].reshape(1, -1, 9))
                own.append(
                    block_diag(*(ENCODER_RAD**2 / BLOCK * j @ j.T for j in by_motor.reshape(-1, 3, 3)))
                )
            by_rate = np.concatenate(rows)
            covariance = by_rate @ by_rate.T + block_diag(*own)
            roots.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        return np.array(roots)

    def stand_whitening(self) -> np.ndarray:
        """(rests, 2, 2): the same for the direction of gravity at each rest by the encoders."""
        counts = np.array([b - a for a, b in self.cut.rests])
        by_motor = turn_by_motor(self.data.rest_angle_rad)
        moved = np.einsum("kci,kij,kjm->kcm", self.across, skew(self.up), by_motor)
        covariance = moved @ moved.transpose(0, 2, 1) * (ENCODER_RAD**2 / counts)[:, None, None]
        return np.linalg.inv(np.linalg.cholesky(covariance))

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

    def by_stand(self) -> list[np.ndarray]:
        """What small angles of the stand do: of its mount, of its base, between its axes, zero of motor 2."""
        columns = []
        for name, count in STAND.items() if self.has_encoders else ():
            for one in np.eye(count):
                run = self.simulate((), imucal.Stand(**{name: tuple(STAND_DEG * one)}))
                changed = self.residuals(Data.of(run.recording, self.cut), self.theta, self.up)
                columns.append((changed - self.at_truth) / STAND_DEG)
        if self.has_encoders:
            zero_rad = np.radians(STAND_DEG) * np.array([0.0, 1.0, 0.0])
            shifted = replace(
                self.data,
                rest_angle_rad=self.data.rest_angle_rad + zero_rad,
                move_angle_rad=self.data.move_angle_rad + zero_rad,
            )
            columns.append((self.residuals(shifted, self.theta, self.up) - self.at_truth) / STAND_DEG)
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


def of_stand(angle_rad: np.ndarray) -> np.ndarray:
    """(..., 3, 3): attitude, world from body, of a perfect stand whose motors are at these angles."""
    flat = Rotation.from_euler("XYZ", angle_rad.reshape(-1, 3)).as_matrix()
    return flat.reshape(*angle_rad.shape, 3)


def turn_by_motor(angle_rad: np.ndarray) -> np.ndarray:
    """(..., 3, 3): small turn of the body, in its frame, per angle of each motor."""
    here = of_stand(angle_rad)
    there = [of_stand(angle_rad + STEP * one) for one in np.eye(3)]
    return np.stack([small_turn(transposed(here) @ each) / STEP for each in there], axis=-1)


def small_turn(rotation: np.ndarray) -> np.ndarray:
    """(..., 3): rotation vectors of matrices that hardly turn."""
    turn = rotation - transposed(rotation)
    return np.stack([turn[..., 2, 1], turn[..., 0, 2], turn[..., 1, 0]], axis=-1) / 2.0


def transposed(matrices: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrices, -1, -2)


def rows_of_blocks(by_rate: np.ndarray) -> np.ndarray:
    """What the samples of the rate do to the means of four samples at a time.

    by_rate  (samples, 3, n)
    returns  (3 * blocks, n)
    """
    means: np.ndarray = blocks(by_rate.reshape(1, len(by_rate), -1)).reshape(-1, by_rate.shape[2])
    return means


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


def limits(kind: str, names: list[str]) -> dict[str, float]:
    """SI limits of the effects in one run of the paper's program."""
    made = Design(by_hand(1) if kind == "A" else imucal.Program.random(seed=1), CYCLE, kind)
    return {
        name: limit(made.columns(name), len(KINDS)) * imucal.effects.find(name).parameters[0].typical
        for name in names
    }


def main() -> None:
    found = {kind: limits(kind, shown(kind)) for kind in ("A", "A'", "C")}
    rounded = {
        kind: {name: float(f"{value:.{DIGITS}g}") for name, value in of.items()} for kind, of in found.items()
    }
    LIMITS.write_text(json.dumps(rounded, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(f"written to {LIMITS}")


if __name__ == "__main__":
    main()
