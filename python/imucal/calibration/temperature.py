"""The range of temperatures of recordings, and temperatures outside the range of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.recording.recording import Recording

__all__ = ["extrapolation", "temperature_range"]

# Temperatures outside the range of the calibration are reported only if they are outside by more than this
# share of the width of the range. A smaller extrapolation is safe.
BEYOND: Final = 0.05


def temperature_range(recordings: Sequence[Recording]) -> tuple[float, float] | None:
    """The lowest and the highest temperature of recordings, degC; None if none is known."""
    columns = [r.temperature_degc for r in recordings if r.temperature_degc is not None]
    seen = np.concatenate(columns) if columns else np.array([])
    seen = seen[np.isfinite(seen)]
    return (float(seen.min()), float(seen.max())) if len(seen) else None


def extrapolation(calibration: Calibration, seen_degc: tuple[float, float] | None) -> str | None:
    """A sentence about a recording whose lowest or highest temperature is outside the range of a calibration.

    Returns None if both temperatures are within the range, if the temperatures or the range are unknown, and
    if no effect of the calibration depends on the temperature.
    """
    known, effects = calibration.temperature_range_degc, calibration.temperature_effects
    if seen_degc is None or known is None or not effects:
        return None
    margin = BEYOND * (known[1] - known[0])
    if known[0] - margin <= seen_degc[0] and seen_degc[1] <= known[1] + margin:
        return None
    return (
        f"the temperature is {seen_degc[0]:.5g} to {seen_degc[1]:.5g} degC, but the calibration covers "
        f"{known[0]:.5g} to {known[1]:.5g} degC: outside this range, {' and '.join(effects)} are extrapolated"
    )
