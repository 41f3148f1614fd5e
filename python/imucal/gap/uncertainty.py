"""What the parameters of a calibration may be off by, and what that does to signals averaged over 1 s."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

import imucal._core as _core
from imucal.calibration.correction import left_in_data
from imucal.effects.definition import UserEffect
from imucal.effects.state import State

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucal.arrays import FloatArray
    from imucal.calibration.calibration import Calibration
    from imucal.effects.effect import Effect, EffectValues
    from imucal.recording.recording import Recording

__all__ = ["Known", "as_large_as_seen", "means", "slopes"]

AVERAGED_S: Final = 1.0
# An effect that looks smaller than this share of its typical size is taken for as small.
LEAST_SIZE: Final = 0.01
PASSES: Final = 30
# Relative step of a time constant.
SHAPE_STEP: Final = 0.01


@dataclass(frozen=True)
class Known:
    """The parameters that were estimated: names, values and standard deviations in SI units, correlation."""

    names: tuple[str, ...]
    values: FloatArray
    sigma: FloatArray
    correlation: FloatArray

    @staticmethod
    def of(calibration: Calibration) -> Known:
        """Those of a calibration; none of one without a covariance."""
        if calibration.covariance is None:
            return Known((), np.zeros(0), np.zeros(0), np.zeros((0, 0)))
        sigma = np.sqrt(np.diag(calibration.covariance))
        free = np.flatnonzero(sigma > 0)
        names = tuple(calibration.covariance_names[k] for k in free)
        numbers = {parameter.name: parameter.value for parameter in calibration.parameters}
        return Known(
            names,
            np.array([numbers[name] for name in names]),
            sigma[free],
            calibration.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free]),
        )


def slopes(calibration: Calibration, recording: Recording, known: Known) -> FloatArray:
    """What a standard deviation of each parameter changes in corrected rate and force over 1 s, (P, n, 6).

    Effects are small beside the signals, so how they change with them is left out.
    """
    of: dict[str, tuple[slice, FloatArray]] = {}
    for sensor, triad, raw, axes in (
        ("gyro", calibration.gyroscope, recording.angular_rate, slice(0, 3)),
        ("accel", calibration.accelerometer, recording.specific_force, slice(3, 6)),
    ):
        inverse = np.linalg.inv(triad.sensitivity)
        seen = means(recording, (raw - triad.bias) @ inverse.T)
        for i, row in enumerate("xyz"):
            of[f"{sensor}_bias_{row}"] = axes, np.broadcast_to(-inverse[:, i], seen.shape)
            for j, column in enumerate("xyz"):
                of[f"{sensor}_sensitivity_{row}{column}"] = axes, -np.outer(seen[:, j], inverse[:, i])
    corrected = calibration.apply_recording(recording)
    state = State.of(recording, corrected.angular_rate, corrected.specific_force)
    left = left_in_data(calibration)
    for values in calibration.effects:
        if values.name not in left:
            effect = calibration.definition(values)
            axes = slice(0, 3) if effect.sensor == "gyroscope" else slice(3, 6)
            of.update(
                (name, (axes, -means(recording, field))) for name, field in _fields(effect, values, state)
            )
    changed = np.zeros((len(known.names), len(_edges(recording)) - 1, 6))
    for slope, name, step in zip(changed, known.names, known.sigma, strict=True):
        for entry in _entries(name, known.names):
            if entry in of:
                axes, derivative = of[entry]
                slope[:, axes] += step * derivative
    return changed


def _entries(name: str, names: Sequence[str]) -> Iterator[str]:
    """The places that a parameter stands in: two where the matrix is symmetric."""
    yield name
    of_triad = name.startswith(("accel_sensitivity_", "gyro_sensitivity_"))
    mirrored = name[:-2] + name[-1] + name[-2]
    if of_triad and mirrored != name and mirrored not in names:
        yield mirrored


def _fields(
    effect: Effect | UserEffect, values: EffectValues, state: State
) -> Iterator[tuple[str, FloatArray]]:
    """Derivative of what the effect adds by each of its parameters, (N, 3), with the parameter's name."""

    def field(shape: float | None) -> FloatArray:
        columns: FloatArray = (
            effect.columns(state)
            if isinstance(effect, UserEffect)
            else _core.effect_field(effect.name, shape, state)
        )
        return columns[:, :, : len(values.values)]

    plain = field(values.shape)
    for k, parameter in enumerate(effect.parameters[: len(values.values)]):
        yield f"{values.name}_{parameter.name}", plain[:, :, k]
    if effect.shape is not None and values.shape is not None:
        step = SHAPE_STEP * values.shape
        changed = (field(values.shape + step) - plain) @ values.values / step
        yield f"{values.name}_{effect.shape.name}", changed


def as_large_as_seen(calibration: Calibration, known: Known) -> tuple[FloatArray, FloatArray]:
    """How far the parameters are expected to be off, (P,), and its covariance, in standard deviations.

    The fit takes an effect for as large as is typical at least (23). What all of its parameters together show
    to be smaller is so in the directions too that the recordings do not show.
    """
    off, covariance = np.zeros(len(known.names)), known.correlation
    for values in calibration.effects:
        sizes = {
            f"{values.name}_{parameter.name}": parameter.typical
            for parameter in calibration.definition(values).parameters[: len(values.values)]
        }
        own = np.array([k for k, name in enumerate(known.names) if name in sizes], int)
        if len(own):
            typical = np.array([sizes[known.names[k]] for k in own]) / known.sigma[own]
            moved, covariance = _narrowed(
                covariance, own, known.values[own] / known.sigma[own] - off[own], typical
            )
            off += moved
    return off, covariance


def _narrowed(
    covariance: FloatArray, own: NDArray[np.intp], values: FloatArray, typical: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """By how much too large parameters are, and their covariance, with the size of (23) if below one."""
    square, moved, narrowed = 1.0, np.zeros(len(covariance)), covariance
    for _ in range(PASSES):
        seen = float(np.sum(1.0 - np.diag(narrowed)[own] / (square * typical**2)))
        size = float(np.sum(((values - moved[own]) / typical) ** 2)) / max(seen, 1e-3)
        square = min(max(size, LEAST_SIZE**2), 1.0)
        weight = np.sqrt(1.0 / square - 1.0) / typical
        across = covariance[:, own] * weight
        within = np.eye(len(own)) + weight[:, None] * across[own]
        narrowed = covariance - across @ np.linalg.solve(within, across.T)
        moved = narrowed[:, own] @ (weight**2 * values)
    return moved, narrowed


def _edges(recording: Recording) -> FloatArray:
    """Where whole averages begin, and the last one ends, s."""
    start, end = recording.time_s[0], recording.time_s[-1]
    edges: FloatArray = start + AVERAGED_S * np.arange(max(int((end - start) / AVERAGED_S), 1) + 1)
    return edges


def means(recording: Recording, values: FloatArray) -> FloatArray:
    """Averages of (N, 3) or (N, 6) over 1 s, (n, ...); NaN where there is no sample."""
    at = np.searchsorted(recording.time_s, _edges(recording))
    counts = np.diff(at)[:, None]
    sums = np.add.reduceat(values, np.minimum(at, len(values) - 1), axis=0)[:-1]
    averages: FloatArray = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return averages
