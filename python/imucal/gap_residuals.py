"""Residuals of a calibration in the body frame, what noise explains of them, and what they may go with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.recording import Recording

if TYPE_CHECKING:
    from imucal.arrays import FloatArray
    from imucal.calibration import Calibration
    from imucal.calibration_result import CalibrationResult

__all__ = ["Channel", "Item", "Residuals", "noise_densities"]

# Means of the force inside the moves.
BLOCK_S: Final = 0.04
# A temperature that changes by less says nothing.
LEAST_CHANGE_K: Final = 0.5
AXES: Final = "xyz"


@dataclass(frozen=True)
class Item:
    """A rest or a move: its place in the result, chi2 with `dof` degrees of freedom, and its error."""

    recording: str
    index: int
    chi2: float
    dof: int
    error: float
    left_out: bool


@dataclass(frozen=True, eq=False)
class Channel:
    """One kind of residual on one axis.

    values, sigma  (n,) and what noise explains of each, SI units
    items          how many rests or moves they are of
    inputs         name -> (n, p), what the values may go with
    """

    name: str
    axis: str | None
    unit: str
    values: FloatArray
    sigma: FloatArray
    items: int
    inputs: Mapping[str, FloatArray]

    @property
    def times_noise(self) -> float:
        """Rms of the values over what noise explains."""
        return float(np.sqrt(np.mean((self.values / self.sigma) ** 2)))


class Residuals:
    """All residuals of a result on the recordings that it was made of.

    rests, moves  those that take part, and those that were left out because they contradict the others
    turns         rotation vector of each move, by its place in the result, rad
    """

    def __init__(
        self,
        result: CalibrationResult,
        recordings: Sequence[Recording],
        inside_moves: bool,
        instability_radps: Sequence[float] | None,
    ) -> None:
        self._result, calibration = result, result.calibration
        self._gravity = calibration.gravity_mps2
        self._accel, self._gyro = noise_densities(calibration)
        self._instability = np.zeros(3) if instability_radps is None else np.array(instability_radps)
        tremors = [tremor for tremor in result.fit.get("tremor_deg", ()) if tremor is not None]
        self._tremor_rad = float(np.radians(max(tremors))) if tremors else 0.0
        self._corrected = {recording.name: calibration.apply_recording(recording) for recording in recordings}
        self._paths = {
            k: _Path(self._corrected[move["recording"]], move["first"], move["last"])
            for k, move in enumerate(result.moves)
            if _is_judged(move)
        }
        self.turns = {k: _vector(path.rotation) for k, path in self._paths.items()}
        self.rests: list[Item] = []
        self.moves: list[Item] = []
        self._by_rest = self._of_rests()
        self._by_move, self._by_block = self._of_moves(inside_moves)

    def channels(self) -> list[Channel]:
        """Every kind of residual, axis by axis."""
        found = [Channel("rest_norm", None, "m/s^2", *self._by_rest.column(0))]
        for axis in range(3):
            found.append(Channel("rest_rate", AXES[axis], "rad/s", *self._by_rest.column(1 + axis)))
        for name, unit, of in (
            ("move_direction", "rad", self._by_move),
            ("move_force", "m/s^2", self._by_block),
        ):
            if of.values:
                found += [Channel(name, AXES[axis], unit, *of.column(axis)) for axis in range(3)]
        return found

    def _of_rests(self) -> _Table:
        table = _Table()
        moves = self._result.moves
        turns = {(moves[k]["recording"], moves[k]["to_rest"]): turn for k, turn in self.turns.items()}
        for k, rest in enumerate(self._result.rests):
            if not _is_judged(rest):
                continue
            corrected = self._corrected[rest["recording"]]
            span = slice(rest["first"], rest["end"])
            duration_s = rest["end_s"] - rest["start_s"]
            force = corrected.specific_force[span].mean(axis=0)
            norm = float(np.linalg.norm(force))
            up = force / norm
            rate = corrected.angular_rate[span].mean(axis=0)
            sigma_norm = float(np.sqrt(np.sum(up**2 * self._accel**2) / duration_s))
            # Of a hand, what it turns by between the ends of a rest.
            sigma_rate = np.sqrt(
                self._gyro**2 / duration_s + self._instability**2 + 2.0 * (self._tremor_rad / duration_s) ** 2
            )
            values, sigma = np.array([norm - self._gravity, *rate]), np.array([sigma_norm, *sigma_rate])
            inputs = {"time": rest["start_s"], "gravity": up, "gravity_squared": _products(up)}
            inputs |= self._temperature(corrected, span)
            inputs["sign_of_the_last_turn"] = np.sign(turns.get((rest["recording"], k), np.zeros(3)))
            shared = {name: np.broadcast_to(given, (1, 4, np.size(given))) for name, given in inputs.items()}
            table.add(k, values[None], sigma[None], shared)
            chi2 = float(np.sum((values / sigma) ** 2))
            self.rests.append(
                Item(rest["recording"], k, chi2, 4, norm - self._gravity, rest["excluded"] is not None)
            )
        return table

    def _of_moves(self, inside_moves: bool) -> tuple[_Table, _Table]:
        directions, forces = _Table(), _Table()
        for k, path in self._paths.items():
            move = self._result.moves[k]
            before, after = (self._up(move, end) for end in ("before", "after"))
            carried = path.rotation.T @ before
            error = np.cross(after, carried)
            sigma = np.radians(move["direction_sigma_deg"] or 0.0)
            if not sigma > 0.0:
                ends = 2.0 * np.mean(self._accel**2) / self._gravity**2
                sigma = float(np.sqrt(np.mean(self._gyro**2) * move["duration_s"] + ends))
            # A turn about gravity is not seen.
            across = np.sqrt(np.maximum(1.0 - after**2, 1e-4))
            driven = {name: sums[None] for name, sums in path.driven().items()}
            directions.add(k, error[None], (sigma * across)[None], driven)
            error_deg = float(np.degrees(np.arctan2(np.linalg.norm(error), after @ carried)))
            chi2, left_out = float(error @ error) / sigma**2, move["excluded"] is not None
            self.moves.append(Item(move["recording"], k, chi2, 2, error_deg, left_out))
            if inside_moves:
                self._add_inside(forces, k, path, before)
        return directions, forces

    def _add_inside(self, table: _Table, k: int, path: _Path, before: FloatArray) -> None:
        up = path.up(before)
        values = path.force - self._gravity * up
        since_s = path.time_s + path.length_s - path.time_s[0]
        drift = (1.0 - up**2) * (self._gravity * self._gyro) ** 2 * since_s[:, None]
        sigma = np.sqrt(self._accel**2 / path.length_s[:, None] + drift)
        given = {
            "angular_acceleration": path.acceleration,
            "rate_squared": _products(path.rate),
            "gravity_squared": _products(up),
        }
        table.add(k, values, sigma, {name: np.repeat(of[:, None], 3, axis=1) for name, of in given.items()})

    def _up(self, move: Mapping[str, Any], end: str) -> FloatArray:
        """Direction of gravity before or after a move; of one that was left out, that of the rest."""
        known = move[f"gravity_{end}"]
        if known is not None and all(value is not None and np.isfinite(value) for value in known):
            return np.array(known)
        rest = self._result.rests[move["from_rest" if end == "before" else "to_rest"]]
        force = self._corrected[rest["recording"]].specific_force[rest["first"] : rest["end"]].mean(axis=0)
        up: FloatArray = force / np.linalg.norm(force)
        return up

    def _temperature(self, corrected: Recording, span: slice) -> dict[str, float]:
        given = corrected.temperature_degc
        if given is None or np.ptp(given) < LEAST_CHANGE_K:
            return {}
        return {"temperature": float(given[span].mean())}


class _Table:
    """Values of several axes, item after item."""

    def __init__(self) -> None:
        self.items: set[int] = set()
        self.values: list[FloatArray] = []
        self.sigma: list[FloatArray] = []
        self.inputs: list[Mapping[str, FloatArray]] = []

    def add(self, item: int, values: FloatArray, sigma: FloatArray, inputs: Mapping[str, FloatArray]) -> None:
        """Of one item, (n, axes) each; `inputs`: name -> (n, axes, p)."""
        self.items.add(item)
        self.values.append(values)
        self.sigma.append(sigma)
        self.inputs.append(inputs)

    def column(self, axis: int) -> tuple[FloatArray, FloatArray, int, dict[str, FloatArray]]:
        """Values, sigma, number of items and inputs of one axis."""
        shared = set.intersection(*(set(inputs) for inputs in self.inputs))

        def of(parts: Sequence[FloatArray]) -> FloatArray:
            return np.concatenate([part[:, axis] for part in parts])

        inputs = {name: of([given[name] for given in self.inputs]) for name in sorted(shared)}
        return of(self.values), of(self.sigma), len(self.items), inputs


class _Path:
    """A move, block by block.

    time_s, length_s  start and length of the B blocks
    rotations         from the body at the end of each block to the body at the start of the move, (B, 3, 3)
    middle, edges     the same in the middle of each block, (B, 3, 3), and at all B + 1 edges
    rate, force       means over the blocks, (B, 3)
    acceleration      of the rate, (B, 3)
    """

    def __init__(self, corrected: Recording, first: int, last: int) -> None:
        from imucal import _core

        time_s, rate = corrected.time_s, corrected.angular_rate
        step = max(2, round(BLOCK_S * (last - first) / (time_s[last] - time_s[first])))
        at = np.array([*range(first, last - step + 1, step), last])
        span = slice(first, last + 1)
        both = _matrices(_core.attitudes(time_s[span], rate[span], (at - first).tolist()))
        self.edges, self.middle = both[::2], both[1::2]
        self.time_s, self.length_s = time_s[at[:-1]], np.diff(time_s[at])
        self.rate = _means(time_s, rate, at)
        self.force = _means(time_s, corrected.specific_force, at)
        self.acceleration = np.diff(rate[at], axis=0) / self.length_s[:, None]
        given = corrected.temperature_degc
        self.temperature: FloatArray | None = None
        if given is not None and np.ptp(given) >= LEAST_CHANGE_K:
            self.temperature = given[at[:-1]] - given.mean()

    @property
    def rotation(self) -> FloatArray:
        """From the body at the end to the body at the start."""
        end: FloatArray = self.edges[-1]
        return end

    def up(self, before: FloatArray) -> FloatArray:
        """Mean over each block of a direction that is `before` at the start, (B, 3)."""
        at_edges = np.einsum("bji,j->bi", self.edges, before)
        in_middle = np.einsum("bji,j->bi", self.middle, before)
        mean: FloatArray = (at_edges[:-1] + 4.0 * in_middle + at_edges[1:]) / 6.0
        return mean

    def driven(self) -> dict[str, FloatArray]:
        """What errors of the rate turn the end by: name -> (3, p), each column one kind of error."""
        to_end = np.einsum("ji,bjk->bik", self.rotation, self.middle) * self.length_s[:, None, None]
        sums = {
            "time": np.einsum("bij,b->ij", to_end, self.time_s),
            "gravity": np.einsum("bij,bk->ijk", to_end, self.force).reshape(3, 9),
            "rate_squared": np.einsum("bij,bj->ij", to_end, self.rate**2),
            "sign_of_the_rate": np.einsum("bij,bj->ij", to_end, np.abs(self.rate)),
        }
        if self.temperature is not None:
            sums["temperature"] = np.einsum("bij,b->ij", to_end, self.temperature)
        return sums


def noise_densities(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """White noise of the accelerometer and of the gyroscope by axis, SI unit per sqrt(Hz)."""
    accel = [calibration.noise[f"accel_noise_density_{axis}_mps2_per_sqrt_hz"] for axis in AXES]
    gyro = [calibration.noise[f"gyro_noise_density_{axis}_radps_per_sqrt_hz"] for axis in AXES]
    # No finer than what the fit takes for the finest: a simulation without noise has none.
    return np.maximum(accel, 1e-5), np.maximum(gyro, 1e-6)


def _is_judged(item: Mapping[str, Any]) -> bool:
    return item["excluded"] is None or item["excluded"].startswith("contradicts")


def _products(v: FloatArray) -> FloatArray:
    """Squares and products of three components, (..., 6)."""
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)


def _means(time_s: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Means over the stretches between the samples `at`, by trapezoids."""
    first, last = at[0], at[-1]
    span = slice(first, last + 1)
    area = 0.5 * (values[span][1:] + values[span][:-1]) * np.diff(time_s[span])[:, None]
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(area, axis=0)])[at - first]
    means: FloatArray = np.diff(sums, axis=0) / np.diff(time_s[at])[:, None]
    return means


def _matrices(wxyz: FloatArray) -> FloatArray:
    """Of quaternions, (n, 4), to (n, 3, 3)."""
    w, x, y, z = wxyz.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _vector(rotation: FloatArray) -> FloatArray:
    """Rotation vector, rad; of half a turn the axis is as good as rounding leaves it."""
    skew = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = np.linalg.norm(skew) / 2.0, (np.trace(rotation) - 1.0) / 2.0
    if sine > 1e-6:
        turned: FloatArray = skew / (2.0 * sine) * np.arctan2(sine, cosine)
        return turned
    if cosine > 0:
        return skew / 2.0
    half_turn: FloatArray = np.pi * np.sqrt(np.maximum((np.diag(rotation) + 1.0) / 2.0, 0.0))
    return half_turn
