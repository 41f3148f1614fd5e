"""Variables of the temperature history at each sample: rate, direction, and lag.

rate        slope of a regression line through the 1 s means within 10 s on either side
direction   1 heating, -1 cooling; it reverses linearly while the temperature turns by 2 K
lag         T_tau - T,  tau dT_tau/dt = T - T_tau,  T_tau = T at the start
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["TemperatureHistory"]

# Time over which temperatures are averaged, s. Averaging suppresses the noise of a thermometer.
NODE_S: Final = 1.0
# Maximum number of means. In longer recordings the means are taken over longer times.
MOST_NODES: Final = 20_000
# Half of the interval over which the rate is computed, s.
RATE_S: Final = 10.0
# Half of the temperature change, K, after which the direction of the change counts as reversed. Smaller
# changes are noise.
REVERSAL_K: Final = 1.0


class TemperatureHistory:
    """Averages of a recorded temperature, and variables of its history: rate, direction and lag."""

    def __init__(self, time_s: FloatArray, degc: FloatArray) -> None:
        since = time_s - time_s[0]
        node_s = max(NODE_S, float(since[-1]) / MOST_NODES)
        place = np.unique((since / node_s).astype(int), return_inverse=True)[1]
        count = np.bincount(place)
        self.since = since
        self.time_s = np.bincount(place, since) / count
        self.degc = np.bincount(place, degc) / count

    def _at_samples(self, nodes: FloatArray) -> FloatArray:
        found: FloatArray = np.interp(self.since, self.time_s, nodes)
        return found

    def rate_kps(self) -> FloatArray:
        """Derivative of the temperature at each sample, K/s."""
        t, values = self.time_s, self.degc
        first = np.searchsorted(t, t - RATE_S)
        end = np.searchsorted(t, t + RATE_S, side="right")
        count = end - first

        def window(of: FloatArray) -> FloatArray:
            sums = np.concatenate(([0.0], np.cumsum(of)))
            total: FloatArray = sums[end] - sums[first]
            return total

        # Time and temperature are centred, so that differences of the cumulative sums do not lose digits.
        t, values = t - t.mean(), values - values.mean()
        mean_t, mean = window(t) / count, window(values) / count
        square = window(t * t) - count * mean_t**2
        cross = window(t * values) - count * mean_t * mean
        slope = np.divide(cross, square, out=np.zeros_like(cross), where=square > 1e-9 * (1.0 + t.max() ** 2))
        return self._at_samples(slope)

    def direction(self) -> FloatArray:
        """Direction of the last change at each sample, -1 to 1; 0 before the first change."""
        found, now = np.zeros_like(self.degc), 0.0
        for k, change in enumerate(np.diff(self.degc), start=1):
            now = min(max(now + change / REVERSAL_K, -1.0), 1.0)
            found[k] = now
        return self._at_samples(found)

    def lag_k(self, tau_s: float) -> FloatArray:
        """Lagged temperature (first order, time constant `tau_s`) minus temperature at each sample, K."""
        step = np.diff(self.time_s) / tau_s
        settled, left = -np.diff(self.degc) / step, np.exp(-step)
        found, now = np.zeros_like(self.degc), 0.0
        for k in range(len(step)):
            now = settled[k] + (now - settled[k]) * left[k]
            found[k + 1] = now
        return self._at_samples(found)
