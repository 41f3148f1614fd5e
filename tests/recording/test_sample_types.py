"""Samples in float32 and int16: every answer is that for the same numbers in float64, bit for bit.

`to_json` is used, because equal text means equal bits.
"""

import numpy as np
import pytest

import imucal
from imucal.document.json_document import to_json

RATE_HZ = 100.0
UNITS = {"accel_unit": "lsb", "gyro_unit": "lsb"}


def counts(motion, seed, **more):
    """A run in counts that 16 bits hold."""
    run = imucal.simulate(motion, unit="bmi088", rate_hz=RATE_HZ, seed=seed, **more).recording
    return run.time_s, np.round(run.specific_force * 1000.0), np.round(run.angular_rate * 5000.0)


@pytest.fixture(scope="module")
def runs():
    motions = [imucal.Program.random(seed=seed, moves=16, hold_s=3.0, move_s=2.0) for seed in (1, 2)]
    return [counts(motion, seed) for seed, motion in enumerate(motions, 1)]


def in_type(run, kind, name):
    time_s, force, rate = run
    return imucal.Recording(time_s, force.astype(kind), rate.astype(kind), name=name, **UNITS)


def calibrated(runs, kind, joint):
    run, control = (in_type(run, kind, name) for run, name in zip(runs, ("run", "control"), strict=True))
    return imucal.calibrate(run, control=control, joint=joint, gravity_mps2=9.81)


def said(answer):
    """All that an answer says, but for when it was made."""
    return to_json({key: value for key, value in answer.to_dict().items() if key != "provenance"})


@pytest.mark.parametrize("kind", [np.float32, np.int16])
class TestAsInFloat64:
    @pytest.mark.parametrize("joint", [True, False])
    def test_calibration(self, runs, kind, joint):
        ours, wide = calibrated(runs, kind, joint), calibrated(runs, np.float64, joint)
        for one, other in zip(ours.parameters, wide.parameters, strict=True):
            assert (one.value, one.std) == (other.value, other.std)
        assert ours.control_set == wide.control_set

    def test_correction(self, runs, kind):
        unit = calibrated(runs, np.float64, joint=False).calibration
        ours, wide = (unit.apply_recording(in_type(runs[0], each, "run")) for each in (kind, np.float64))
        assert ours.specific_force.dtype == np.float64
        np.testing.assert_array_equal(ours.specific_force, wide.specific_force)
        np.testing.assert_array_equal(ours.angular_rate, wide.angular_rate)

    def test_search(self, runs, kind):
        ours, wide = (
            imucal.find_gap(in_type(runs[0], each, "run"), control=in_type(runs[1], each, "control"))
            for each in (kind, np.float64)
        )
        assert said(ours) == said(wide)

    def test_noise_and_inspection(self, kind):
        still = counts(imucal.Static(300.0), 3)
        for answer in (imucal.noise, imucal.inspect):
            ours, wide = (answer(in_type(still, each, "still")) for each in (kind, np.float64))
            assert said(ours) == said(wide)


def test_faults_are_found_in_counts_of_16_bits(runs):
    time_s, force, rate = runs[0]
    # The lowest count has no counterpart above zero.
    railed = np.clip(rate * 20.0, -32768, 32767).astype(np.int16)
    recording = imucal.Recording(time_s, force.astype(np.int16), railed, **UNITS)
    assert "gyro_saturation" in [finding.code for finding in imucal.inspect(recording).findings]
    with pytest.raises(imucal.InputError, match="extreme value"):
        imucal.calibrate(recording)
