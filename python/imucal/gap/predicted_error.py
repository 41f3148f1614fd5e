"""How wrong corrected signals are without and with what joined the model, predicted without any truth.

    after^2 = noise^2 + E |D e|^2,   before^2 = noise^2 + E |d + D e|^2          docs/model.md (35)

all averaged over 1 s: white noise of density N leaves N / sqrt(1 s), e are the errors that the parameters may
have, D what these do to the corrected signals, and d what the two calibrations differ by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.calibration.correction import left_in_data
from imucal.gap.residuals import noise_densities
from imucal.gap.uncertainty import AVERAGED_S, Known, as_large_as_seen, means, slopes

if TYPE_CHECKING:
    from imucal.arrays import FloatArray, SampleArray
    from imucal.calibration.calibration import Calibration
    from imucal.estimation.result import CalibrationResult
    from imucal.recording.recording import Recording

__all__ = ["predicted_error"]

# What calibrations differ by is as slow as the motion: means over a tenth of a second show it.
BRIEF_S: Final = 0.1
SIGNALS: Final = ("angular_rate_rms_radps", "specific_force_rms_mps2")
# Draws of what may be behind these recordings, for the interval of the factor.
DRAWS: Final = 1000
SEED: Final = 1
INTERVAL: Final = (0.025, 0.975)
# Relative variance of a mean density squared, times seconds of rest: it is half the mean square of
# differences of means over 0.25 s on three axes, docs/model.md (10).
NOISE_KNOWN_S: Final = 0.25


def predicted_error(
    before: Calibration, after: CalibrationResult, recordings: Sequence[Recording]
) -> dict[str, dict[str, float]]:
    """Rms over samples and axes of the error of corrected rate and force, averaged over 1 s.

    By signal: before and after, rad/s and m/s^2; factor, before over after; and factor_low and factor_high,
    between which the factor of these recordings is with 95 % probability.
    """
    better = after.calibration
    brief = [_brief(recording) for recording in recordings]
    missed = np.concatenate([_slow(before, run) - _slow(better, run) for run in brief])
    known = Known.of(better)
    moved = np.concatenate([slopes(better, run, known) for run in brief], axis=1)
    off, covariance = as_large_as_seen(better, known)
    root = _root(covariance)
    rest_s = sum(rest.end_s - rest.start_s for rest in after.rests)
    chances = _Chances.drawn(len(off))
    found = {}
    for name, noise, axes in zip(SIGNALS, _noise(after), (slice(0, 3), slice(3, 6)), strict=True):
        columns = np.vstack((moved[:, :, axes].reshape(len(moved), -1), missed[:, axes].reshape(1, -1)))
        columns = columns[:, np.isfinite(columns).all(axis=0)]
        gram, count = columns @ columns.T / columns.shape[1], columns.shape[1]
        found[name] = _Signal(noise, gram, off, root, count, NOISE_KNOWN_S / rest_s).claim(chances)
    return found


@dataclass(frozen=True)
class _Chances:
    """Standard normal numbers, the same for both sensors: DRAWS of each.

    parameters  (DRAWS, P)
    products    (DRAWS, P+1), of the noise with each column
    noise       (DRAWS,)
    """

    parameters: FloatArray
    products: FloatArray
    noise: FloatArray

    @classmethod
    def drawn(cls, parameters: int) -> _Chances:
        random = np.random.default_rng(SEED)
        shapes = ((DRAWS, parameters), (DRAWS, parameters + 1), (DRAWS,))
        return cls(*(random.standard_normal(shape) for shape in shapes))


@dataclass(frozen=True)
class _Signal:
    """One sensor on these recordings.

    noise     mean square of an average over 1 s
    gram      (P+1, P+1) mean products of what each parameter's standard deviation changes, and of what the
              calibrations differ by, which is last
    off       (P,) how far the parameters are expected to be off, in standard deviations
    root      (P, P) a factor of the covariance of that
    count     how many averages there are
    unsure    relative variance of `noise`
    """

    noise: float
    gram: FloatArray
    off: FloatArray
    root: FloatArray
    count: int
    unsure: float

    def claim(self, chances: _Chances) -> dict[str, float]:
        unsure = float(np.sum(self.gram[:-1, :-1] * (self.root @ self.root.T)))
        before, after = (
            float(np.sqrt(self.noise + at @ self.gram @ at + unsure))
            for at in (np.append(self.off, 1.0), np.append(self.off, 0.0))
        )
        low, high = np.quantile(self._factors(chances), INTERVAL)
        return {
            "before": before,
            "after": after,
            "factor": before / after,
            "factor_low": float(low),
            "factor_high": float(high),
        }

    def _factors(self, chances: _Chances) -> FloatArray:
        """Of so many units and runs that may be behind these recordings."""
        off = self.off + chances.parameters @ self.root.T
        # The mean product of noise with each of the columns, and of noise with itself.
        crossed = chances.products @ _root(self.gram).T
        crossed *= np.sqrt(self.noise / self.count)
        chance = np.sqrt(2.0 / self.count + self.unsure) * chances.noise
        noise = self.noise * np.maximum(1.0 + chance, 0.1)

        def mean_square(missed: float) -> FloatArray:
            at = np.column_stack((off, np.full(DRAWS, missed)))
            of: FloatArray = np.sum((at @ self.gram + 2.0 * crossed) * at, axis=1) + noise
            return of

        least = 0.1 * self.noise
        before, after = (np.maximum(mean_square(missed), least) for missed in (1.0, 0.0))
        factors: FloatArray = np.sqrt(before / after)
        return factors


def _noise(after: CalibrationResult) -> tuple[float, float]:
    """Mean squares over 1 s of what no correction takes away, of rate and of force.

    The rate of the Earth stays in the rate; what it is about an axis of the unit changes with the attitude.
    """
    better = after.calibration
    accel, gyro = noise_densities(better)
    instability = after.fit.bias_instability_radps
    wander = 0.0 if instability is None else float(np.mean(np.square(instability)))
    left = left_in_data(better)
    stays = sum(
        float(np.mean(np.square(effect.values)))
        for effect in better.effects
        if effect.name in left and better.definition(effect).sensor == "gyroscope"
    )
    return float(np.mean(gyro**2)) / AVERAGED_S + wander + stays, float(np.mean(accel**2)) / AVERAGED_S


def _root(covariance: FloatArray) -> FloatArray:
    """A factor F with F F^T the covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    factor: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return factor


def _brief(recording: Recording) -> Recording:
    """Means over so many samples."""
    step_s = float(recording.time_s[-1] - recording.time_s[0]) / max(len(recording) - 1, 1)
    count = max(round(BRIEF_S / step_s), 1) if step_s > 0.0 else 1
    rows = len(recording) // count
    starts = np.arange(0, rows * count, count)

    def means(values: SampleArray) -> FloatArray:
        # Means over an axis of an array in three dimensions take eight times as long.
        sums: FloatArray = np.add.reduceat(values[: rows * count], starts, dtype=np.float64)
        return sums / count

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
    return means(recording, np.hstack((corrected.angular_rate, corrected.specific_force)))
