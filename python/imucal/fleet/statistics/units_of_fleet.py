"""Selection of the measurements that a statistic uses."""

from __future__ import annotations

import numpy as np

from imucal.fleet.measurements import Measurements

__all__ = ["POOR", "first_of_each_unit", "usable"]

# Verdict of calibrations whose parameters are not used in statistics.
POOR = "poor"


def usable(measurements: Measurements) -> tuple[Measurements, int]:
    """The measurements without poor calibrations, and the number of poor calibrations."""
    poor = measurements.verdicts == POOR
    return measurements.where(~poor), int(poor.sum())


def first_of_each_unit(measurements: Measurements) -> tuple[Measurements, int]:
    """The first usable measurement of each unit in order of time, and the number of poor measurements.

    Measurements without a date come after those with a date.
    """
    kept, poor = usable(measurements)
    # NaT sorts last, so measurements without a date come last.
    in_time = kept.where(np.argsort(kept.dates, kind="stable"))
    _, first = np.unique(in_time.serials, return_index=True)
    return in_time.where(np.sort(first)), poor
