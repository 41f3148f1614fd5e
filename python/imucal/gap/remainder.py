"""Classes for the residuals that accepted effects do not explain, and for bias changes between sessions."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

__all__ = ["SIGNIFICANT", "Remainder", "SessionStep"]

# Residuals exceed their noise significantly if their p-value is below this threshold. The compiled library
# uses the same threshold.
SIGNIFICANT: Final = 1e-5


@dataclass(frozen=True)
class SessionStep:
    """Change of the biases from the calibration recordings to the control recordings.

    accelerometer_mps2      change of the accelerometer's bias on x, y and z, m/s^2; None if not significant
    gyroscope_radps         change of the gyroscope's bias, rad/s; None if not significant
    p_value                 the smaller p-value of the two changes
    temperature_change_k    mean temperature of the control recordings minus mean temperature of the
                            calibration recordings, K; None without temperatures
    cause                   "temperature" if temperature coefficients of usual sizes explain the change;
                            otherwise "switch_on", a change with time or at a switch-on; "not_known"
                            without temperatures
    chi2_per_dof            chi2 per degree of freedom of the control recordings under the accepted model,
                            with the biases of the calibration
    chi2_per_dof_own        the same chi2 with biases that are estimated from the control recordings
    """

    accelerometer_mps2: tuple[float, float, float] | None
    gyroscope_radps: tuple[float, float, float] | None
    p_value: float
    temperature_change_k: float | None
    cause: str
    chi2_per_dof: float
    chi2_per_dof_own: float


@dataclass(frozen=True)
class Remainder:
    """Residuals that the accepted effects, or the model without effects if none was accepted, do not explain.

    kind           "nothing" (no residuals exceed twice their noise with a p-value below 1e-5), "unknown"
                   (systematic deviation) or "stochastic" (random deviation)
    block          the part of the model or of the data that varies, for example gyro_bias; None if nothing
                   remains
    pattern        the pattern of the variation, for example attitude, random_walk, time, switching or
                   between_sessions; None if nothing remains
    description    a sentence with sizes, and the rests or moves concerned; None if nothing remains
    p_value        p-value of the pattern under the hypothesis that noise is the only error. Without a
                   pattern: p-value of the residuals on control or held-out data, given noise and the
                   uncertainty of the calibration
    matters        whether these residuals limit the use of the calibration. `imucal gap` then exits with
                   code 2
    session        change of the biases between sessions; None if it is not significant
    """

    kind: str
    block: str | None
    pattern: str | None
    description: str | None
    p_value: float
    matters: bool
    session: SessionStep | None = None

    def to_dict(self) -> dict[str, Any]:
        """The field `remainder` of the JSON document."""
        return asdict(self)
