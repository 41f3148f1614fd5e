"""Conversion of temperatures in raw counts (column temp_lsb) to degC with a slope and an offset.

degC = slope * counts + offset        MPU-6050: 1/340, 36.53;  ICM-42688-P: 1/132.48, 25;  LSM6DSO: 1/256, 25
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from imucal.errors import InputError
from imucal.io.names import RAW_TEMPERATURE
from imucal.io.remarks import remark
from imucal.recording.recording import Recording
from imucal.units import to_degc

__all__ = ["TempScale", "scale_of", "with_temperature"]

# Slope, degC per count, and offset, degC, as two numbers or as text "SLOPE,OFFSET", where the slope may be a
# fraction such as 1/340.
TempScale = str | Sequence[float]


def scale_of(given: TempScale) -> tuple[float, float]:
    """Slope and offset of a `TempScale`. Raises InputError unless it has two numbers and a nonzero slope."""
    try:
        slope, offset = map(_number, given.split(",")) if isinstance(given, str) else map(float, given)
    except (TypeError, ValueError, ZeroDivisionError):
        slope, offset = math.nan, math.nan
    if not (math.isfinite(slope) and math.isfinite(offset) and slope != 0.0):
        raise InputError(
            f"temp_scale is {given!r}: give SLOPE,OFFSET in degC per count and degC, for example 1/340,36.53 "
            "for an MPU-6050 (--temp-scale)"
        )
    return slope, offset


def with_temperature(recording: Recording, scale: tuple[float, float] | None) -> Recording:
    """The recording with the temperature from its auxiliary input temp_lsb, if it has this input.

    Without a scale, the counts remain an auxiliary input, with a finding if there is no other temperature.
    Raises InputError if a scale is given although the recording has no column temp_lsb or has another
    temperature column.
    """
    counts = recording.auxiliary.get(RAW_TEMPERATURE)
    if scale is None:
        if counts is None or recording.temperature_degc is not None:
            return recording
        finding = remark(
            recording.name,
            "temperature_raw",
            "the temperature is in raw counts (temp_lsb) without a scale, so it is not used",
            "give its scale: --temp-scale SLOPE,OFFSET in degC per count and degC, from the datasheet",
        )
        return replace(recording, findings=(*recording.findings, finding))
    if counts is None:
        raise InputError(f"{recording.name}: a temp_scale is given but there is no column {RAW_TEMPERATURE}")
    if recording.temperature_degc is not None:
        raise InputError(
            f"{recording.name}: the temperature is given twice, as {RAW_TEMPERATURE} with a temp_scale and "
            "in another unit: remove one"
        )
    rest = {name: values for name, values in recording.auxiliary.items() if name != RAW_TEMPERATURE}
    return replace(recording, temperature_degc=to_degc(counts, scale), auxiliary=rest)


def _number(text: str) -> float:
    """A number, or a fraction of two numbers."""
    numerator, bar, denominator = text.partition("/")
    return float(numerator) / float(denominator) if bar else float(text)
