"""The true state (rate, force, temperature, ...) at each sample, from which effects are computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray, as_rows
from imucal.recording.recording import Recording

__all__ = ["State"]

# Angular rate above which a unit counts as moving, rad/s (6 deg/s). It is above the noise and bias of usual
# gyroscopes, and below the rates of rotations by hand.
MOVING_RADPS: Final = 0.1


@dataclass(frozen=True, eq=False)
class State:
    """The true state at N samples, from which effects are computed. Unknown quantities are None.

    angular_rate          (N, 3)  body frame, rad/s
    specific_force        (N, 3)  body frame, m/s^2
    time_s                (N,)    since the first sample of the recording, s
    angular_acceleration  (N, 3)  derivative of the angular rate, rad/s^2
    temperature_degc      (N,)    degC
    auxiliary             name -> (N,), further columns of the recording
    rotation_wxyz         (N, 4)  attitude quaternion, maps a vector from body to world
    stand_rad             (N, 3)  angles of the stand's motors, rad: true angles in a simulation, otherwise
                                  measured angles
    stand_rate_radps      (N, 3)  derivatives of these angles, rad/s; zero if not known
    stand_direction       (N, 3)  sign of the last motion of each motor; 0 before the first motion and if
                                  not known
    rest_s                (N,)    time since the rate last exceeded 0.1 rad/s, or since the first sample, s;
                                  computed from the rate if not given

    Raises InputError if an array has another shape.
    """

    angular_rate: FloatArray
    specific_force: FloatArray
    time_s: FloatArray
    angular_acceleration: FloatArray | None = None
    temperature_degc: FloatArray | None = None
    auxiliary: Mapping[str, FloatArray] = field(default_factory=dict)
    rotation_wxyz: FloatArray | None = None
    stand_rad: FloatArray | None = None
    stand_rate_radps: FloatArray | None = None
    stand_direction: FloatArray | None = None
    rest_s: FloatArray | None = None

    def __post_init__(self) -> None:
        rows = len(as_rows(self.time_s, "time_s"))
        for name, width in (
            ("angular_rate", 3),
            ("specific_force", 3),
            ("time_s", None),
            ("angular_acceleration", 3),
            ("temperature_degc", None),
            ("rotation_wxyz", 4),
            ("stand_rad", 3),
            ("stand_rate_radps", 3),
            ("stand_direction", 3),
            ("rest_s", None),
        ):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, as_rows(values, name, width, rows))
        if self.rest_s is None:
            object.__setattr__(self, "rest_s", _rest_s(self.time_s, self.angular_rate))
        auxiliary = {
            name: as_rows(values, f"auxiliary[{name!r}]", None, rows)
            for name, values in self.auxiliary.items()
        }
        object.__setattr__(self, "auxiliary", auxiliary)

    @staticmethod
    def of(
        recording: Recording,
        angular_rate: SampleArray,
        specific_force: SampleArray,
        angular_acceleration: FloatArray | None = None,
        rest_s: FloatArray | None = None,
    ) -> State:
        """The state at each sample of a recording with the given true rate and force.

        If `angular_acceleration` is None, it is computed as the derivative of the rate, or is NaN if the
        recording has only one sample.
        """
        rate, force = as_rows(angular_rate, "angular_rate", 3), as_rows(specific_force, "specific_force", 3)
        if angular_acceleration is None:
            angular_acceleration = (
                _core.angular_acceleration(recording.time_s, rate)
                if len(recording) > 1
                else np.full((len(recording), 3), np.nan)
            )
        return State(
            rate,
            force,
            recording.time_s - recording.time_s[:1],
            angular_acceleration=angular_acceleration,
            temperature_degc=recording.temperature_degc,
            auxiliary=recording.auxiliary,
            stand_rad=recording.stand_rad,
            rest_s=rest_s,
        )


def _rest_s(time_s: FloatArray, rate: FloatArray) -> FloatArray:
    """Time since the rate last exceeded 0.1 rad/s (`MOVING_RADPS`), or since the first sample."""
    is_moving = np.einsum("ij,ij->i", rate, rate) > MOVING_RADPS**2
    last = np.maximum.accumulate(np.where(is_moving, np.arange(len(is_moving)), 0))
    rest_s: FloatArray = time_s - time_s[last]
    return rest_s
