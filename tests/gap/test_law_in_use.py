"""A law that a search found, in a calibration file, in C and in a simulation."""

import re

import numpy as np
import pytest

import imucal
from c_compiler import compiled_corrections

pytestmark = pytest.mark.slow

RATE_HZ = 100.0
# The hidden error: it grows with the rate up to 0.03 rad/s, and a faster rate has the same error.
HIDDEN = {"gyro: k*min(max(w, -0.03), 0.03)": [0.1, -0.08, 0.12]}
LARGEST_RADPS = (0.003, -0.0024, 0.0036)


def simulated(seed, effects):
    return imucal.simulate("random", seed=seed, rate_hz=RATE_HZ, effects=effects).recording


@pytest.fixture(scope="module")
def found():
    """A recording with the hidden error, and its search."""
    recording = simulated(5, HIDDEN)
    return recording, imucal.find_gap(recording, control=simulated(6, HIDDEN))


def test_a_simulation_with_the_law_repeats_the_recording(found):
    recording, gap = found
    (law,) = gap.laws
    repeated = simulated(5, {law.formula: [parameter["value"] for parameter in law.parameters]})
    hidden = recording.angular_rate - simulated(5, {}).angular_rate
    left = recording.angular_rate - repeated.angular_rate
    assert (np.std(left, axis=0) < 0.2 * np.std(hidden, axis=0)).all()
    # Faster than the limit of the law, the error is constant, and its coefficient has a standard deviation.
    form = re.search(r"min\(max\(w, -(.+?)\)", law.formula)
    assert form is not None, law.formula
    limit = float(form[1])
    for axis, parameter in enumerate(law.parameters):
        rate = recording.angular_rate[:, axis]
        is_fast = np.abs(rate) > 1.5 * limit
        assert is_fast.sum() > 1000
        error_radps = abs((np.sign(rate) * left[:, axis])[is_fast].mean())
        assert error_radps < min(4.0 * limit * parameter["std"], 0.1 * abs(LARGEST_RADPS[axis]))


def test_the_law_is_in_c(found, tmp_path):
    recording, gap = found
    unit = tmp_path / "unit.json"
    gap.calibration.save(unit)
    calibration = imucal.Calibration.load(unit)
    correct = compiled_corrections(tmp_path, {"unit": calibration})
    # Errors are in units in the last place of the largest component. Python subtracts the law from the raw
    # samples, which rounds a second time in double precision.
    for real, most in ((np.float64, 6.0), (np.float32, 2.0)):
        rate, force = (np.array(s, real) for s in (recording.angular_rate, recording.specific_force))
        given = rate.astype(float), force.astype(float)
        corrected_in_python = calibration.apply_recording(
            imucal.Recording(recording.time_s, specific_force=given[1], angular_rate=given[0])
        )
        expected = corrected_in_python.angular_rate, corrected_in_python.specific_force
        for corrected, wanted, raw in zip(correct("unit", rate, force), expected, given, strict=True):
            largest = np.abs([wanted, raw]).max(axis=(0, 2), keepdims=True)[0].astype(real)
            assert (np.abs(corrected - wanted) <= most * np.spacing(largest)).all()
