"""Computation of user-defined effects: during a fit, the compiled library calls `UserEffectSource`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.effects.definition import UserEffect
from imucal.effects.effect import EffectValues
from imucal.effects.state import State
from imucal.estimation.options import UserField
from imucal.recording.recording import Recording, samples_of_both

__all__ = ["UserEffectSource"]


# Time, s, over which `brief_means` averages the samples before it corrects them by the two calibrations that
# are compared. Means are sufficient to predict the errors of the calibrations, because these errors vary as
# slowly as the motion.
BRIEF_S: Final = 0.1

RateAndForce: TypeAlias = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class UserEffectSource:
    """User-defined effects, and the recordings at whose samples their fields (see `UserEffect`) are computed.

    effects     the definitions
    recordings  the calibration recordings
    control     the control recordings, which are not fitted
    given       a calibration with which the fit with effects is compared; None to compare that fit with the
                fit without effects
    """

    effects: tuple[UserEffect, ...]
    recordings: Sequence[Recording]
    control: Sequence[Recording] = ()
    given: Calibration | None = None

    @property
    def names(self) -> list[str]:
        """Names of the effects."""
        return [effect.name for effect in self.effects]

    def fields(self, names: Sequence[str], estimate: _core.Estimate) -> list[UserField]:
        """The effects `names`, with the error per unit of each parameter at each corrected sample, (N, 3, p).

        The samples are corrected by `estimate`.
        """
        own = [effect for effect in self.effects if effect.name in names]
        return self._fields(own, self._calibration(estimate), self.recordings) if own else []

    def corrected(self, estimate: _core.Estimate, of_control: bool) -> list[RateAndForce]:
        """Rate and force, (N, 3) each, of each recording after correction by `estimate`.

        of_control  whether to correct the control recordings instead of the calibration recordings
        """
        recordings = self.control if of_control else self.recordings
        return _corrected(self._calibration(estimate), recordings)

    def brief_means(
        self, before: _core.Estimate, after: _core.Estimate, of_control: bool
    ) -> tuple[list[RateAndForce], list[RateAndForce], list[UserField]]:
        """Means of samples over 0.1 s after correction by two calibrations, and fields of the user effects.

        The first calibration is `self.given`, or `before` if no calibration was given. The second calibration
        is `after`. The fields of the user-defined effects are evaluated at the means that the second
        calibration has corrected.
        """
        recordings = [_brief(recording) for recording in (self.control if of_control else self.recordings)]
        better = self._calibration(after)
        first = self._calibration(before) if self.given is None else self.given
        own = [effect for effect, _ in better.own_effects()]
        fields = self._fields(own, better, recordings)
        return _corrected(first, recordings), _corrected(better, recordings), fields

    def _calibration(self, estimate: _core.Estimate) -> Calibration:
        first = self.recordings[0]
        return Calibration(
            Triad(estimate.accel_sensitivity, estimate.accel_bias),
            Triad(estimate.gyro_sensitivity, estimate.gyro_bias),
            accel_unit=first.accel_unit,
            gyro_unit=first.gyro_unit,
            effects=tuple(EffectValues(e.name, e.values, e.shape) for e in estimate.effects),
            user_effects=self.effects,
        )

    @staticmethod
    def _fields(
        own: Sequence[UserEffect], calibration: Calibration, recordings: Sequence[Recording]
    ) -> list[UserField]:
        corrected = [calibration.apply_recording(recording) for recording in recordings]
        both = [samples_of_both(recording) for recording in corrected]
        states = [State.of(c, rate, force) for c, (force, rate) in zip(corrected, both, strict=True)]
        return [
            UserField(
                effect.name,
                effect.sensor,
                tuple(parameter.typical for parameter in effect.parameters),
                tuple(np.ascontiguousarray(effect.columns(state)) for state in states),
            )
            for effect in own
        ]


def _corrected(calibration: Calibration, recordings: Sequence[Recording]) -> list[RateAndForce]:
    corrected = [calibration.apply_recording(recording) for recording in recordings]
    both = map(samples_of_both, corrected)
    return [(np.ascontiguousarray(rate), np.ascontiguousarray(force)) for force, rate in both]


def _brief(recording: Recording) -> Recording:
    """Average a recording over intervals of 0.1 s (`BRIEF_S`); an incomplete last interval is dropped."""
    step_s = float(recording.time_s[-1] - recording.time_s[0]) / max(len(recording) - 1, 1)
    count = max(round(BRIEF_S / step_s), 1) if step_s > 0.0 else 1
    rows = len(recording) // count
    starts = np.arange(0, rows * count, count)

    def means(values: SampleArray) -> FloatArray:
        sums: FloatArray = np.add.reduceat(values[: rows * count], starts, dtype=np.float64)
        return sums / count

    force, rate = samples_of_both(recording)
    return replace(
        recording,
        time_s=means(recording.time_s),
        specific_force=means(force),
        angular_rate=means(rate),
        temperature_degc=None if recording.temperature_degc is None else means(recording.temperature_degc),
        stand_rad=None if recording.stand_rad is None else means(recording.stand_rad),
        auxiliary={name: means(values) for name, values in recording.auxiliary.items()},
    )
