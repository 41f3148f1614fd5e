"""Limits derived from a sample of good units: mean +- k standard deviations over the units.

min, max = mean -+ k s        s: standard deviation over the units
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.calibration.verdict import worst
from imucal.errors import InputError
from imucal.limits.limit import COUNTS, FIGURES, FigureLimit, ParameterLimit
from imucal.limits.limits import Limits

__all__ = ["DEVIATIONS", "limits_from"]

# Default half width of the ranges, in standard deviations over the units. With 3 standard deviations, each of
# 21 parameters would be outside its range with a probability of 0.27 %, and one of 18 good units would fail.
# With 4 standard deviations, one of 750 good units fails.
DEVIATIONS: Final = 4.0
# `max_std` of a parameter is the largest standard deviation of this parameter in the calibrations of the
# units, multiplied by this factor. A small factor is sufficient, because the standard deviations depend on
# motion and noise and hardly differ between units.
STD_MARGIN: Final = 2.0


def limits_from(calibrations: Sequence[Calibration], *, deviations: float = DEVIATIONS) -> Limits:
    """Derive limits for units of the same kind as the calibrated units.

    The limits of a parameter are its mean over the units plus and minus `deviations` standard deviations over
    the units. The limit of a figure is its mean plus `deviations` standard deviations. The limit for the
    standard deviation of a parameter is twice the largest standard deviation of this parameter among the
    units. The minimum numbers of rests and moves are the smallest numbers of any unit. Effects are permitted
    if any unit has them, and the worst permitted verdict is that of the worst unit. Figures of the
    calibration and control sets get limits if all units have these figures.

    Raises InputError for fewer than two units, a unit given twice, a unit with poor figures, and units with
    different parameters.
    """
    if not (math.isfinite(deviations) and deviations > 0):
        raise InputError(f"the number of standard deviations is {deviations}: a positive number is needed")
    if len(calibrations) < 2:
        raise InputError(f"{len(calibrations)} unit has no spread: give the calibrations of two or more")
    names = [(parameter.name, parameter.unit) for parameter in calibrations[0].parameters]
    for number, calibration in enumerate(calibrations[1:], start=2):
        if [(parameter.name, parameter.unit) for parameter in calibration.parameters] != names:
            raise InputError(
                f"unit {number} has other parameters than unit 1: give units of the same type, calibrated "
                "with the same options"
            )
    values = np.array([[parameter.value for parameter in c.parameters] for c in calibrations])
    for number, own in enumerate(values):
        for other in range(number):
            if np.array_equal(own, values[other]):
                raise InputError(
                    f"unit {other + 1} and unit {number + 1} have the same parameter values: give every unit "
                    "once"
                )
    serials = Counter(c.serial_number for c in calibrations if c.serial_number is not None)
    twice = sorted(serial for serial, count in serials.items() if count > 1)
    if twice:
        raise InputError(
            f"the serial number {twice[0]} occurs {serials[twice[0]]} times: give every unit once"
        )
    for number, calibration in enumerate(calibrations, start=1):
        verdict, reasons = calibration.judged
        if verdict == "poor":
            raise InputError(
                f"unit {number} is not good ({reasons[0]}): limits are computed only from good units"
            )
    return Limits(
        tuple(_parameters(calibrations, values, deviations)),
        tuple(_figures(calibrations, deviations)),
        tuple(dict.fromkeys(effect.name for c in calibrations for effect in c.effects)),
        worst(*(calibration.judged[0] for calibration in calibrations)),
        f"mean +- {deviations:g} standard deviations of {len(calibrations)} units",
    )


def _parameters(
    calibrations: Sequence[Calibration], values: np.ndarray[Any, Any], deviations: float
) -> list[ParameterLimit]:
    limits = []
    for index, parameter in enumerate(calibrations[0].parameters):
        half = deviations * float(values[:, index].std(ddof=1))
        if half == 0:
            raise InputError(f"{parameter.name} is the same in all units: it has no spread")
        mean = float(values[:, index].mean())
        std = [c.parameters[index].std for c in calibrations]
        known = [number for number in std if number]
        limits.append(
            ParameterLimit(
                parameter.name,
                parameter.unit,
                _rounded(mean - half, half),
                _rounded(mean + half, half),
                None if len(known) < len(std) else _rounded(STD_MARGIN * max(known), max(known)),
            )
        )
    return limits


def _figures(calibrations: Sequence[Calibration], deviations: float) -> list[FigureLimit]:
    limits = []
    sets: dict[str, list[Mapping[str, Any]]] = {
        "calibration_set": [c.calibration_set or {} for c in calibrations],
        "control_set": [c.control_set or {} for c in calibrations],
    }
    for of, figures in sets.items():
        for name in FIGURES[of]:
            seen = [each.get(name) for each in figures]
            numbers = [float(number) for number in seen if number]
            if len(numbers) < len(seen):
                continue
            half = deviations * float(np.std(numbers, ddof=1))
            most = _rounded(float(np.mean(numbers)) + half, half)
            limits.append(FigureLimit(of, name, int(min(numbers)) if name in COUNTS else most))
    return limits


def _rounded(number: float, scale: float) -> float:
    """`number` rounded to the decimal place of the third significant digit of `scale`."""
    return round(number, 2 - math.floor(math.log10(scale))) if scale > 0 else number
