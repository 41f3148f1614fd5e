"""Rounding errors of the C header's single-precision function, for random units without effects."""

import numpy as np
import pytest

import imucal
from c_compiler import compiled_corrections
from imucal.units import STANDARD_GRAVITY_MPS2

pytestmark = pytest.mark.slow

UNIT_COUNT = 60
SAMPLE_COUNT = 20_000
# Largest counts of one g and of one deg/s: 16384 and 131 for the ranges 2 g and 250 deg/s.
COUNTS_PER_G, COUNTS_PER_DPS = 16384.0, 131.0
LARGEST_RATE_RADPS, LARGEST_FORCE_MPS2 = 4.4, 18.0


def triad(random, gain, bias_si, zero_counts):
    """A triad with gain errors up to 10 % and misalignments of 10 mrad.

    gain         nominal sensitivity, raw unit per SI unit
    bias_si      largest bias, SI units
    zero_counts  raw counts of a sensor without bias
    """
    sensitivity = gain * (random.uniform(0.9, 1.1, (3, 1)) * (np.eye(3) + random.normal(0, 0.01, (3, 3))))
    return imucal.Triad(sensitivity, zero_counts + gain * random.uniform(-bias_si, bias_si, 3))


def random_unit(random, kind):
    in_counts = kind.startswith("counts")
    zero_counts = 32768.0 if kind == "counts_with_offset" else 0.0
    # Each larger range halves the sensitivity.
    smaller = 2.0 ** -random.integers(0, 4, 2) if in_counts else np.ones(2)
    per_force = COUNTS_PER_G / STANDARD_GRAVITY_MPS2 if in_counts else 1.0
    per_rate = COUNTS_PER_DPS * 180 / np.pi if in_counts else 1.0
    force = triad(random, smaller[0] * per_force, 0.6, zero_counts)
    rate = triad(random, smaller[1] * per_rate, 0.05, zero_counts)
    if kind == "si_swapped_axes":
        # The x axis of the gyroscope chip is along y, its y axis along -z, and its z axis along x.
        rate = imucal.Triad(rate.sensitivity[:, [2, 0, 1]] * [1.0, 1.0, -1.0], rate.bias)
    unit = "lsb" if in_counts else None
    return imucal.Calibration(force, rate, accel_unit=unit or "m/s^2", gyro_unit=unit or "rad/s")


def raw_samples(random, triad, largest, kind):
    """Raw samples as float32, of all sizes; in half of them, the bias is larger than the true values."""
    sizes = largest * 10 ** random.uniform(-3, 0, (SAMPLE_COUNT, 1))
    raw = random.uniform(-sizes, sizes, (SAMPLE_COUNT, 3)) @ triad.sensitivity.T + triad.bias
    if kind.startswith("counts"):
        return np.round(raw).astype(np.float32)
    is_smaller = random.integers(0, 2, (SAMPLE_COUNT, 1)) == 1
    return np.where(is_smaller, random.uniform(-1, 1, (SAMPLE_COUNT, 1)) * triad.bias, raw).astype(np.float32)


@pytest.mark.parametrize("kind", ["si", "si_swapped_axes", "counts", "counts_with_offset"])
def test_the_linear_correction_is_within_two_units_in_the_last_place(tmp_path, kind):
    random = np.random.default_rng(17)
    units = {f"unit{k}": random_unit(random, kind) for k in range(UNIT_COUNT)}
    correct = compiled_corrections(tmp_path, units)
    for name, unit in units.items():
        sensors = ((unit.gyroscope, LARGEST_RATE_RADPS), (unit.accelerometer, LARGEST_FORCE_MPS2))
        raw = [raw_samples(random, sensor, largest, kind) for sensor, largest in sensors]
        expected = unit.apply(*(samples.astype(np.float64) for samples in raw))
        for corrected, wanted, samples in zip(correct(name, *raw), expected, raw, strict=True):
            # For counts, the corrected sample is the only one in SI units.
            seen = [wanted] if kind.startswith("counts") else [wanted, samples]
            largest = np.abs(seen).max(axis=(0, 2)).astype(np.float32)[:, None]
            assert (np.abs(corrected - wanted) <= 2 * np.spacing(largest)).all()
