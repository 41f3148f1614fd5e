"""Inference of units from the first numbers of a file whose header states no units.

Acceleration that includes gravity has a median magnitude of 1 g. The unit of a gyroscope is inferred from the
size of its counts, such as 131 per deg/s, and from its noise, which is 0.01 to 0.3 deg/s per sample for MEMS
sensors.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from imucal.arrays import FloatArray
from imucal.units import (
    COLUMN_UNITS,
    DEGREE_RAD,
    STANDARD_GRAVITY_MPS2,
    TICKS_PER_S,
    UNIT_TEXT,
    significant,
)

__all__ = [
    "Reading",
    "accel_reading",
    "epoch_unit",
    "excludes_radps",
    "gravity_g",
    "gyro_reading",
    "is_constant",
    "is_still",
    "is_whole",
    "time_reading",
]

# Range of the median magnitude of an accelerometer, g, that is accepted as gravity. It allows for motion.
GRAVITY_G: Final = (0.7, 1.4)
# If the median magnitude of acceleration is below this number, g, the acceleration does not include gravity.
NO_GRAVITY_G: Final = 0.3
# Resolutions of gyroscopes from datasheets, counts per deg/s: 16.4 times powers of two (MPU-60x0, ICM and BMI
# series), 16 (BNO055), and the inverse of the resolution in mdps per count (LSM6 and L3G).
COUNTS_PER_DPS: Final = (
    *(16.4, 32.8, 65.6, 65.5, 131.0, 131.072, 262.4, 16.384, 32.768, 65.536, 262.144, 16.0, 14.375),
    *(1000 / 4.375, 1000 / 8.75, 1000 / 17.5, 1000 / 35.0, 1000 / 70.0),
)
# Typical noise per sample of a MEMS gyroscope, rad/s. A unit is unlikely if the noise of a column in this
# unit differs from the typical noise by more than a factor UNLIKELY_FACTOR. For comparison, rad/s and deg/s
# differ by a factor of 57.
USUAL_NOISE_RADPS: Final = 0.05 * DEGREE_RAD
UNLIKELY_FACTOR: Final = 12.0
# Largest rate that MEMS gyroscopes measure, rad/s.
LARGEST_RATE_RADPS: Final = 4100 * DEGREE_RAD
# Plausible range of sampling rates, Hz.
RATES_HZ: Final = (5.0, 40_000.0)
# Whole numbers can be accelerations in mg if their median magnitude is in this range. Gravity is 1000 mg, and
# biases of MEMS sensors reach 50 mg.
MG: Final = (900, 1100)
# Numbers that can be mg can also be counts of 0.01 m/s^2 (BNO055), in which 1 g is 981 counts. The unit is
# ambiguous if their median magnitude is in the first range (whole numbers) or in the second range (all other
# numbers).
MG_OR_CM_PER_S2: Final = ((900, 1030), (971, 991))
# Acceleration may lack gravity if the interquartile range of its magnitude exceeds this share of the median
# magnitude, and the length of its mean vector is below this share of the median magnitude. For random motion
# without gravity, these ratios are 0.6 and 0.
UNSTEADY: Final = 0.5
# If at least this share of the time stamps are repeated, the clock is too coarse or rows were written twice.
REPEATED: Final = 0.25
# Largest share of time steps that may be negative in a column of time.
MOST_BACKWARDS: Final = 0.1
# Standard deviation of the accelerometer's samples, g, above which the sensor cannot be at rest.
STILL_G: Final = 0.02
# Number of consecutive samples in a block. The noise is estimated from the blocks with the least variation.
BLOCK: Final = 20
# Numbers in this range, s, are accepted as times since 1970: years 2001 to 2103.
EPOCH_S: Final = (1.0e9, 4.2e9)


class Reading(NamedTuple):
    """An interpretation of numbers without a unit.

    likely  suffix of the canonical names for the likely unit, or None
    text    sentence that explains the interpretation, with the typical size of the values in each unit
    either  suffixes of the canonical names for the units, if several units are equally likely
    """

    likely: str | None
    text: str
    either: tuple[str, ...] = ()


def gravity_g(values: FloatArray, unit: str) -> float:
    """The median magnitude of the accelerometer samples, g; NaN for counts."""
    if unit == "lsb":
        return math.nan
    return _median_magnitude(values) * COLUMN_UNITS["accel"][unit] / STANDARD_GRAVITY_MPS2


def _median_magnitude(values: FloatArray) -> float:
    """The median magnitude of the samples without missing values; NaN if there are none."""
    magnitude = np.linalg.norm(values, axis=1) if len(values) else np.empty(0)
    magnitude = magnitude[~np.isnan(magnitude)]
    return float(np.median(magnitude)) if len(magnitude) else math.nan


def accel_reading(values: FloatArray) -> Reading:
    """The interpretation of an accelerometer's first samples, (N, 3)."""
    size = _median_magnitude(values)
    in_g = {unit: significant(gravity_g(values, unit), 3) for unit in ("mps2", "g", "mg")}
    shown = ", ".join(f"{value} g as {UNIT_TEXT[unit]}" for unit, value in in_g.items())
    text = f"accelerometer: median magnitude {significant(size, 4)}, which is {shown}"
    low, high = GRAVITY_G
    likely = next((unit for unit in ("mps2", "g", "mg") if low < gravity_g(values, unit) < high), None)
    are_whole = is_whole(values)
    low, high = MG_OR_CM_PER_S2[0 if are_whole else 1]
    if likely == "mg" and low < size < high:
        return Reading(None, f"{text}, and {size / 981:.3g} g as counts of 0.01 m/s^2 (lsb)", ("mg", "lsb"))
    if likely == "mg" and are_whole and not MG[0] < size < MG[1]:
        likely = None
    if likely in ("g", "mg") and (doubt := _without_gravity(values, size)):
        return Reading(None, text + doubt, (likely, "mps2"))
    if likely is None and are_whole and size > 50:
        likely, text = "lsb", f"{text}; whole numbers, so probably counts ({size:.0f} per g)"
    elif likely is None and size * 1.0 < NO_GRAVITY_G * STANDARD_GRAVITY_MPS2:
        text += "; it seems not to include gravity, which a calibration needs"
    return Reading(likely, text)


def _without_gravity(values: FloatArray, size: float) -> str:
    """The end of a sentence if the samples vary like acceleration without gravity; otherwise empty."""
    values = values[np.isfinite(values).all(axis=1)]
    low, high = np.quantile(np.linalg.norm(values, axis=1), (0.25, 0.75)) / size
    mean = float(np.linalg.norm(values.mean(axis=0))) / size
    if high - low < UNSTEADY or mean > UNSTEADY:
        return ""
    return (
        f"; the middle half of the magnitudes spreads by {100 * (high - low):.0f} %, and the magnitude of "
        f"the mean is {100 * mean:.0f} %, so it may be acceleration without gravity in m/s^2"
    )


def is_still(accel: FloatArray, unit: str | None) -> bool:
    """Whether an accelerometer can be at rest in the quietest blocks of these samples; True for counts."""
    size = gravity_g(accel, unit) if unit is not None else math.nan
    if not math.isfinite(size):
        return True
    return _noise(accel)[0] * COLUMN_UNITS["accel"][unit or ""] / STANDARD_GRAVITY_MPS2 < STILL_G


def excludes_radps(values: FloatArray) -> bool:
    """Whether a gyroscope's samples, (N, 3), are too large for rates in rad/s."""
    return float(np.nanmax(np.abs(values), initial=0.0)) > LARGEST_RATE_RADPS


def gyro_reading(values: FloatArray, *, is_moving: bool = False) -> Reading:
    """The interpretation of a gyroscope's first samples, (N, 3).

    is_moving  whether the sensor never rests, so that its motion could be mistaken for noise
    """
    (noise, least), largest = _noise(values), float(np.nanmax(np.abs(values), initial=0.0))
    text = (
        f"gyroscope: noise per sample {noise:.2g}, which is {noise:.2g} deg/s as deg/s, "
        f"{noise / DEGREE_RAD:.2g} deg/s as rad/s"
    )
    if is_whole(values) and largest > 5:
        return Reading("lsb", f"gyroscope: whole numbers up to {largest:.0f}, so probably counts")
    for unit, factor in (("dps", 1.0), ("radps", 1 / DEGREE_RAD), ("mdps", 1e-3)):
        counts = _counts_per_dps(values * factor)
        if counts is not None:
            return Reading(unit, f"{text}; its steps are {counts:.4g} counts per deg/s as {UNIT_TEXT[unit]}")
    if excludes_radps(values):
        return Reading(
            "dps" if largest < 6000 else "mdps", f"{text}; rates up to {largest:.4g} exclude rad/s"
        )
    likely = _unit_of_noise(noise)
    # If the sensor moves most of the time, `noise` is the variation due to the motion, and at most a few
    # blocks contain only noise. No unit of measurement is therefore returned if the quietest block indicates
    # another unit of measurement than `noise` does.
    if likely is None or _unit_of_noise(least) not in (None, likely) or (is_moving and likely == "dps"):
        return Reading(None, f"{text}: the data do not tell which unit is right")
    return Reading(likely, text)


def _unit_of_noise(noise: float) -> str | None:
    """The unit in which the noise per sample is typical of a MEMS gyroscope; None if it is ambiguous."""
    if not noise > 0:
        return None
    as_radps, as_dps = (abs(math.log(noise * factor / USUAL_NOISE_RADPS)) for factor in (1.0, DEGREE_RAD))
    if as_radps > math.log(UNLIKELY_FACTOR) > as_dps:
        return "dps"
    return "radps" if as_dps > math.log(UNLIKELY_FACTOR) > as_radps else None


def time_reading(values: Any) -> Reading:
    """The interpretation of a time column without a unit, from its time step."""
    times = np.asarray(values, dtype=np.float64)
    if is_constant(times):
        return Reading(None, f"the first {len(times)} time stamps are all {times[0]:g}, so they are no time")
    unit = epoch_unit(values)
    if unit is not None:
        return Reading(unit, f"time: stamps since 1970 in {unit}")
    steps = np.diff(_without_copies(times))
    if _are_whole_seconds(times):
        return Reading(None, "time: whole seconds since 1970, several samples in each second")
    if len(steps) and (steps < 0).mean() > MOST_BACKWARDS:
        return Reading(None, "the column of the time does not increase")
    if len(steps) and (steps == 1).all():
        return Reading(None, "the column of the time counts by 1, so it can be the number of the sample")
    positive = steps[steps > 0]
    if len(positive) and (positive == 1).all() and (steps == 0).mean() > REPEATED:
        return Reading(
            None,
            f"time: {100 * (steps == 0).mean():.0f} % of the stamps repeat the stamp before, and the others "
            "count by 1, so they are too coarse",
        )
    step = float(np.median(positive)) if len(positive) else math.nan
    rates = {unit: ticks / step for unit, ticks in TICKS_PER_S.items()}
    fitting = [unit for unit, rate in rates.items() if RATES_HZ[0] <= rate <= RATES_HZ[1]]
    shown = ", ".join(f"{rates[unit]:.4g} Hz as {unit}" for unit in rates if 0.01 < rates[unit] < 1e7)
    # Times with fractions are assumed to be in s, because counters in ms or us are integers.
    are_whole = bool(len(steps)) and is_whole(times)
    fitting = [unit for unit in fitting if (unit == "s") != are_whole or len(fitting) == 1]
    return Reading(fitting[0] if fitting else None, f"time: steps of {step:.4g}, {shown}")


def is_constant(values: Any) -> bool:
    """Whether two or more time stamps are all equal."""
    times = np.asarray(values, dtype=np.float64)
    return len(times) > 1 and bool((times == times[0]).all())


def _without_copies(times: FloatArray) -> FloatArray:
    """The time stamps without repetitions if blocks of rows were written twice; otherwise all time stamps.

    A logger that writes a block of rows again, for example after a lost connection, also repeats the earlier
    time stamps of this block.
    """
    finite = times[np.isfinite(times)]
    if not (np.diff(finite) < 0).any():
        return times
    first = finite[np.sort(np.unique(finite, return_index=True)[1])]
    are_copies = 1 < len(first) <= (1 - REPEATED) * len(finite)
    return first if are_copies and (np.diff(first) < 0).mean() <= MOST_BACKWARDS else times


def epoch_unit(values: Any) -> str | None:
    """The unit of time stamps that can only be times since 1970; None for other time stamps."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return None
    for unit, ticks in TICKS_PER_S.items():
        if EPOCH_S[0] <= finite[0] / ticks <= EPOCH_S[1] and (unit != "s" or not is_whole(finite)):
            # Integers near 1e9 are not accepted as s since 1970, because they can also be an uptime of a
            # quarter of an hour in us.
            return unit if unit != "ns" or finite[0] > 1e18 else None
    return None


def _are_whole_seconds(values: FloatArray) -> bool:
    """Whether time stamps are times since 1970 in whole seconds, of which most occur more than once."""
    finite = values[np.isfinite(values)]
    if not (len(finite) and is_whole(finite) and EPOCH_S[0] <= finite[0] <= EPOCH_S[1]):
        return False
    steps = np.diff(finite)
    return bool(np.isin(steps, (0, 1)).all() and 2 * (steps == 0).sum() > len(steps))


def is_whole(values: FloatArray) -> bool:
    """Whether all finite values are whole numbers, and there are any."""
    finite = values[np.isfinite(values)]
    return bool(len(finite)) and bool((finite == np.round(finite)).all())


def _noise(values: FloatArray) -> tuple[float, float]:
    """Two estimates of the standard deviation of the noise per sample, from short blocks of samples.

    The first estimate is the 10 % quantile of the standard deviations of all blocks. The second estimate is
    the smallest nonzero standard deviation of a block.
    """
    # Rows without a sample of this sensor are skipped, because the sensors may have separate rows.
    steps = np.diff(values[~np.isnan(values).all(axis=1)], axis=0)
    steps = steps[np.isfinite(steps).all(axis=1)]
    if len(steps) < 2:
        return 0.0, 0.0
    blocks = [
        steps[at : at + BLOCK].std() / math.sqrt(2) for at in range(0, max(len(steps) - BLOCK, 1), BLOCK)
    ]
    return float(np.quantile(blocks, 0.1)), float(min(filter(None, blocks), default=0.0))


def _counts_per_dps(values_dps: FloatArray) -> float | None:
    """The counts per deg/s of a known sensor, if all values are multiples of one count; otherwise None."""
    finite = values_dps[np.isfinite(values_dps)]
    distinct = np.unique(np.abs(finite[finite != 0]))
    if len(distinct) < 4:
        return None
    # If all values have at most two decimals, such as 0.25, no scale is returned, because rounded values can
    # be multiples of a scale by coincidence.
    if np.allclose(distinct * 100, np.round(distinct * 100), atol=1e-9):
        return None
    smallest = float(distinct[0])
    for counts in COUNTS_PER_DPS:
        multiples = distinct * counts
        if (
            smallest * counts > 0.5
            and (np.abs(multiples - np.round(multiples)) < 0.02).all()
            and distinct[-1] * counts < 33000
        ):
            return counts
    return None
