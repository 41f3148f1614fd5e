"""How wrong corrected signals are without and with what joined the model, predicted without any truth.

    after^2  = noise^2 + parameters^2,   before^2 = after^2 + rms(before - after)^2

all averaged over 1 s: white noise of density N leaves N / sqrt(1 s), the parameters what draws from their
covariance leave, and what the plain calibration misses is its difference from the better one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.calibration import Triad
from imucal.effects import EffectValues
from imucal.gap_residuals import noise_densities

if TYPE_CHECKING:
    from imucal.arrays import FloatArray
    from imucal.calibration import Calibration
    from imucal.calibration_result import CalibrationResult
    from imucal.recording import Recording

__all__ = ["predicted_error"]

AVERAGED_S: Final = 1.0
BRIEF_S: Final = 0.1
# Draws of all parameters: their squares are a small part of the error.
DRAWS: Final = 8
SEED: Final = 1


def predicted_error(
    before: Calibration, after: CalibrationResult, recordings: Sequence[Recording]
) -> dict[str, dict[str, float]]:
    """Rms over samples and axes of the error of corrected rate and force, averaged over 1 s."""
    better = after.calibration
    accel, gyro = noise_densities(better)
    instability = after.fit.get("bias_instability_radps")
    wander = 0.0 if instability is None else np.mean(np.square(instability))
    noise = np.array([np.mean(gyro**2) / AVERAGED_S + wander, np.mean(accel**2) / AVERAGED_S])
    best = [_slow(better, recording) for recording in recordings]
    missed = _mean_square([_slow(before, recording) for recording in recordings], best)
    # What an error of a parameter does is as slow as the motion: means over a tenth of a second show it.
    brief = [_brief(recording) for recording in recordings]
    middle = [_slow(better, recording) for recording in brief]
    drawn = [[_slow(draw, recording) for recording in brief] for draw in _draws(better)]
    unsure = np.mean([_mean_square(draw, middle) for draw in drawn], axis=0) if drawn else np.zeros(2)
    left = noise + unsure
    return {
        name: {"before": float(np.sqrt(left[k] + missed[k])), "after": float(np.sqrt(left[k]))}
        for k, name in enumerate(("angular_rate_rms_radps", "specific_force_rms_mps2"))
    }


def _brief(recording: Recording) -> Recording:
    """Means over so many samples."""
    step_s = float(recording.time_s[-1] - recording.time_s[0]) / max(len(recording) - 1, 1)
    count = max(round(BRIEF_S / step_s), 1) if step_s > 0.0 else 1
    rows = len(recording) // count

    def means(values: FloatArray) -> FloatArray:
        of: FloatArray = values[: rows * count].reshape(rows, count, *values.shape[1:]).mean(axis=1)
        return of

    return replace(
        recording,
        time_s=means(recording.time_s),
        specific_force=means(recording.specific_force),
        angular_rate=means(recording.angular_rate),
        temperature_degc=None if recording.temperature_degc is None else means(recording.temperature_degc),
        stand_rad=None if recording.stand_rad is None else means(recording.stand_rad),
        auxiliary={name: means(values) for name, values in recording.auxiliary.items()},
    )


def _slow(calibration: Calibration, recording: Recording) -> FloatArray:
    """Corrected rate and force averaged over 1 s, (n, 6)."""
    corrected = calibration.apply_recording(recording)
    both = np.hstack((corrected.angular_rate, corrected.specific_force))
    edges = np.arange(recording.time_s[0], recording.time_s[-1], AVERAGED_S)
    at = np.searchsorted(recording.time_s, edges)
    counts = np.diff(np.append(at, len(both)))
    slow: FloatArray = (np.add.reduceat(both, at) / counts[:, None])[counts > 1]
    return slow


def _mean_square(these: Sequence[FloatArray], others: Sequence[FloatArray]) -> FloatArray:
    """Of the differences in rate and in force."""
    difference = np.concatenate([a - b for a, b in zip(these, others, strict=True)])
    return np.array([np.nanmean(difference[:, :3] ** 2), np.nanmean(difference[:, 3:] ** 2)])


def _draws(calibration: Calibration) -> list[Calibration]:
    """The calibration with parameters drawn from their covariance."""
    if calibration.covariance is None:
        return []
    size = np.sqrt(np.diag(calibration.covariance))
    known = size > 0
    scaled = calibration.covariance[np.ix_(known, known)] / np.outer(size[known], size[known])
    values, vectors = np.linalg.eigh(scaled)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    numbers = {parameter.name: parameter.value for parameter in calibration.parameters}
    names = [name for name, is_known in zip(calibration.covariance_names, known, strict=True) if is_known]
    random = np.random.default_rng(SEED)
    draws = []
    for _ in range(DRAWS):
        moved = size[known] * (factor @ random.standard_normal(factor.shape[1]))
        draws.append(
            _with(calibration, numbers | {n: numbers[n] + m for n, m in zip(names, moved, strict=True)})
        )
    return draws


def _with(calibration: Calibration, numbers: Mapping[str, float]) -> Calibration:
    """The calibration with other numbers for its parameters."""

    def triad(sensor: str) -> Triad:
        old: Triad = calibration.accelerometer if sensor == "accel" else calibration.gyroscope
        bias = [numbers[f"{sensor}_bias_{axis}"] for axis in "xyz"]
        sensitivity = old.sensitivity.copy()
        for i, row in enumerate("xyz"):
            for j, column in enumerate("xyz"):
                # The accelerometer's is symmetric: one number stands in two places.
                for name in (f"{sensor}_sensitivity_{row}{column}", f"{sensor}_sensitivity_{column}{row}"):
                    if name in numbers:
                        sensitivity[i, j] = numbers[name]
                        break
        return Triad(sensitivity, np.array(bias))

    effects = []
    for values in calibration.effects:
        definition = calibration.definition(values)
        own = [numbers[f"{values.name}_{p.name}"] for p in definition.parameters[: len(values.values)]]
        shape = values.shape
        if definition.shape is not None and shape is not None:
            # A time constant that is hardly known must stay one.
            shape = max(numbers[f"{values.name}_{definition.shape.name}"], 0.1 * shape)
        effects.append(EffectValues(values.name, np.array(own), shape))
    return replace(
        calibration,
        accelerometer=triad("accel"),
        gyroscope=triad("gyro"),
        effects=tuple(effects),
        covariance=None,
        covariance_names=(),
    )
