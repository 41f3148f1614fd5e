"""The true state of samples, on which the fields of effects depend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray, as_rows
from imucal.recording.recording import Recording

__all__ = ["State"]


@dataclass(frozen=True, eq=False)
class State:
    """The true state of N samples, the input of fields. A quantity that is not known is None.

    angular_rate          (N, 3)  body frame, rad/s
    specific_force        (N, 3)  body frame, m/s^2
    time_s                (N,)    since the first sample of the recording, s
    angular_acceleration  (N, 3)  derivative of the angular rate, rad/s^2
    temperature_degc      (N,)    degC
    auxiliary             name -> (N,), further columns of the recording
    rotation_wxyz         (N, 4)  attitude quaternion, maps a vector from body to world
    stand_rad             (N, 3)  angles of the stand's motors, rad; true ones in a simulation, else measured
    stand_rate_radps      (N, 3)  their derivatives, rad/s; zero if not known
    stand_direction       (N, 3)  sign of the last motion of each motor, 0 before any; zero if not known

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
        ):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, as_rows(values, name, width, rows))
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
    ) -> State:
        """The state at each sample of a recording with the given true rate and force.

        Without `angular_acceleration`, it is computed as the derivative of the rate; NaN for a single sample.
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
        )
