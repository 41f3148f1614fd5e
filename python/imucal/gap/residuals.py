"""Residuals of a calibration in the body frame, what noise explains of them, and what they may go with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.estimation.rests import Move, Rest
from imucal.gap.paths import LEAST_CHANGE_K, Paths, Placed, means_of
from imucal.recording.recording import Recording

if TYPE_CHECKING:
    from imucal.arrays import FloatArray
    from imucal.calibration.calibration import Calibration
    from imucal.estimation.result import CalibrationResult

__all__ = ["Channel", "Item", "Residuals", "noise_densities"]

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
        tremors = [tremor for tremor in result.fit.tremor_deg if tremor is not None]
        self._tremor_rad = float(np.radians(max(tremors))) if tremors else 0.0
        self._corrected = {recording.name: calibration.apply_recording(recording) for recording in recordings}
        self._paths = [Paths(corrected, moves) for corrected, moves in self._judged(result.moves)]
        self.turns = {
            k: turn for paths in self._paths for (k, _), turn in zip(paths.moves, paths.turns, strict=True)
        }
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

    def _judged(self, items: Sequence[Any]) -> Iterator[tuple[Recording, list[Placed]]]:
        """Each recording with its rests, or moves, that are judged, and their places in the result."""
        for name, corrected in self._corrected.items():
            own = [(k, item) for k, item in enumerate(items) if item.recording == name and _is_judged(item)]
            if own:
                yield corrected, own

    def _of_rests(self) -> _Table:
        table = _Table()
        moves = self._result.moves
        turns = {(moves[k].recording, moves[k].to_rest): turn for k, turn in self.turns.items()}
        for corrected, rests in self._judged(self._result.rests):
            spans = np.array([(rest.first, rest.end) for _, rest in rests])
            duration_s = np.array([rest.end_s - rest.start_s for _, rest in rests])
            force, rate = (
                means_of(column, spans) for column in (corrected.specific_force, corrected.angular_rate)
            )
            norm = np.linalg.norm(force, axis=1)
            up = force / norm[:, None]
            sigma_norm = np.sqrt(up**2 @ self._accel**2 / duration_s)
            # Of a hand, what it turns by between the ends of a rest.
            noise = self._gyro**2 / duration_s[:, None] + self._instability**2
            sigma_rate = np.sqrt(noise + 2.0 * (self._tremor_rad / duration_s[:, None]) ** 2)
            values = np.column_stack([norm - self._gravity, rate])
            sigma = np.column_stack([sigma_norm, sigma_rate])
            last_turns = [turns.get((rest.recording, k), np.zeros(3)) for k, rest in rests]
            inputs = {
                "time": np.array([[rest.start_s] for _, rest in rests]),
                "gravity": up,
                "gravity_squared": _products(up),
                "sign_of_the_last_turn": np.sign(last_turns),
            }
            given = corrected.temperature_degc
            if given is not None and np.ptp(given) >= LEAST_CHANGE_K:
                inputs["temperature"] = means_of(given[:, None], spans)
            table.add((k for k, _ in rests), values, sigma, inputs)
            chi2 = np.sum((values / sigma) ** 2, axis=1)
            for (k, rest), own, error in zip(rests, chi2, values[:, 0], strict=True):
                left_out = rest.excluded is not None
                self.rests.append(Item(rest.recording, k, float(own), 4, float(error), left_out))
        return table

    def _of_moves(self, inside_moves: bool) -> tuple[_Table, _Table]:
        directions, forces = _Table(), _Table()
        for paths in self._paths:
            moves = [move for _, move in paths.moves]
            before, after = (np.array([self._up(move, end) for move in moves]) for end in ("before", "after"))
            carried = np.einsum("mji,mj->mi", paths.rotation, before)
            error = np.cross(after, carried)
            sigma = np.array([self._direction_sigma(move) for move in moves])
            # A turn about gravity is not seen.
            across = np.sqrt(np.maximum(1.0 - after**2, 1e-4))
            directions.add((k for k, _ in paths.moves), error, sigma[:, None] * across, paths.driven())
            angle = np.arctan2(np.linalg.norm(error, axis=1), np.sum(after * carried, axis=1))
            chi2 = np.sum(error**2, axis=1) / sigma**2
            for (k, move), own, error_rad in zip(paths.moves, chi2, angle, strict=True):
                left_out = move.excluded is not None
                error_deg = float(np.degrees(error_rad))
                self.moves.append(Item(move.recording, k, float(own), 2, error_deg, left_out))
            if inside_moves:
                self._add_inside(forces, paths, before)
        return directions, forces

    def _direction_sigma(self, move: Move) -> float:
        """What noise explains of each component of a move's direction, rad."""
        sigma = float(np.radians(move.direction_sigma_deg or 0.0))
        if sigma > 0.0:
            return sigma
        ends = 2.0 * np.mean(self._accel**2) / self._gravity**2
        return float(np.sqrt(np.mean(self._gyro**2) * move.duration_s + ends))

    def _add_inside(self, table: _Table, paths: Paths, before: FloatArray) -> None:
        up = paths.up(before)
        values = paths.force - self._gravity * up
        drift = (1.0 - up**2) * (self._gravity * self._gyro) ** 2 * paths.since_s[:, None]
        sigma = np.sqrt(self._accel**2 / paths.length_s[:, None] + drift)
        inputs = {
            "angular_acceleration": paths.acceleration,
            "rate_squared": _products(paths.rate),
            "gravity_squared": _products(up),
        }
        table.add((k for k, _ in paths.moves), values, sigma, inputs)

    def _up(self, move: Move, end: str) -> FloatArray:
        """Direction of gravity before or after a move; of one that was left out, that of the rest."""
        known = move.gravity_before if end == "before" else move.gravity_after
        if known is not None and all(value is not None and math.isfinite(value) for value in known):
            return np.array(known)
        rest = self._result.rests[move.from_rest if end == "before" else move.to_rest]
        force = self._corrected[rest.recording].specific_force[rest.first : rest.end].mean(axis=0)
        up: FloatArray = force / np.linalg.norm(force)
        return up


class _Table:
    """Values of several axes, of items after items."""

    def __init__(self) -> None:
        self.items: set[int] = set()
        self.values: list[FloatArray] = []
        self.sigma: list[FloatArray] = []
        self.inputs: list[Mapping[str, FloatArray]] = []

    def add(
        self, items: Iterable[int], values: FloatArray, sigma: FloatArray, inputs: Mapping[str, FloatArray]
    ) -> None:
        """Values (n, axes) of some items; `inputs`: name -> (n, p), shared by all axes, or (n, axes, p)."""
        self.items.update(items)
        self.values.append(values)
        self.sigma.append(sigma)
        self.inputs.append(inputs)

    def column(self, axis: int) -> tuple[FloatArray, FloatArray, int, dict[str, FloatArray]]:
        """Values, sigma, number of items and inputs of one axis."""
        shared = set.intersection(*(set(inputs) for inputs in self.inputs))

        def of(parts: Iterable[FloatArray]) -> FloatArray:
            return np.concatenate([part[:, axis] for part in parts])

        def input_of(name: str) -> FloatArray:
            parts = [inputs[name] for inputs in self.inputs]
            return np.concatenate([part if part.ndim == 2 else part[:, axis] for part in parts])

        inputs = {name: input_of(name) for name in sorted(shared)}
        return of(self.values), of(self.sigma), len(self.items), inputs


def noise_densities(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """White noise of the accelerometer and of the gyroscope by axis, SI unit per sqrt(Hz)."""
    accel = [calibration.noise[f"accel_noise_density_{axis}_mps2_per_sqrt_hz"] for axis in AXES]
    gyro = [calibration.noise[f"gyro_noise_density_{axis}_radps_per_sqrt_hz"] for axis in AXES]
    # No finer than what the fit takes for the finest: a simulation without noise has none.
    return np.maximum(accel, 1e-5), np.maximum(gyro, 1e-6)


def _is_judged(item: Rest | Move) -> bool:
    return item.excluded is None or item.excluded.startswith("contradicts")


def _products(v: FloatArray) -> FloatArray:
    """Squares and products of three components, (..., 6)."""
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)
