"""Rate, direction of change and lag of the temperature at each sample (docs/model.md (43))."""

from __future__ import annotations

import imucal._core as _core
from imucal.arrays import FloatArray

__all__ = ["TemperatureHistory"]


class TemperatureHistory:
    """Rate, direction of change and lag of the temperatures `degc`, (N,), at the times `time_s`, (N,)."""

    def __init__(self, time_s: FloatArray, degc: FloatArray) -> None:
        self.time_s, self.degc = time_s, degc
        self.duration_s = float(time_s[-1] - time_s[0])
        self.rate_kps, self.direction, _ = _core.temperature_history(time_s, degc, 1.0)

    def lag_k(self, tau_s: float) -> FloatArray:
        """T_tau - T at each sample, K; T_tau is T after a first-order lag, tau dT_tau/dt = T - T_tau."""
        return _core.temperature_history(self.time_s, self.degc, tau_s)[2]
