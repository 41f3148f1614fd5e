"""A control recording that is a part or an altered copy of the calibration recording is refused.

benches/copies.py repeats this with more seeds, alterations and conditions.
"""

import dataclasses

import numpy as np
import pytest

import copies
import imucal

SEED, CONTROL_SEED = 3, 4


@pytest.fixture(scope="module")
def made():
    conditions = copies.conditions()
    return {name: conditions[name] for name in ("stand, the same program", "hand at 50 Hz")}


@pytest.fixture(scope="module")
def run(made):
    return made["stand, the same program"](SEED)


@pytest.mark.parametrize("alteration", copies.ALTERATIONS)
def test_an_altered_copy_has_the_noise_of_the_recording(made, alteration):
    for make in made.values():
        recording = make(SEED)
        assert copies.common_noise(recording, copies.altered(recording, alteration, SEED)) > 20


@pytest.mark.parametrize("condition", copies.conditions())
def test_another_run_is_independent(condition):
    make = copies.conditions()[condition]
    assert copies.common_noise(make(SEED), make(CONTROL_SEED)) is None


@pytest.mark.parametrize(
    ("condition", "seed"),
    [
        ("one knock", 78),
        ("single wrong samples", 2),
        ("single wrong samples", 251),
        ("stand and hum of 12.5 Hz", 70),
        ("stand and hum of 12.5 Hz", 88),
    ],
)
def test_short_pulses_and_periodic_vibration_are_not_common_noise(condition, seed):
    make = copies.conditions()[condition]
    assert copies.common_noise(make(seed), make(seed + copies.CONTROL_SEEDS)) is None


@pytest.mark.parametrize("alteration", ["half of it", "every second sample", "0.8 times the rate"])
def test_calibrate_refuses_a_copy_as_control(run, alteration):
    with pytest.raises(imucal.InputError, match="make the control recording anew") as raised:
        imucal.calibrate(run, control=copies.altered(run, alteration, SEED))
    (finding,) = raised.value.findings
    assert (finding.code, finding.recording) == ("control_not_independent", "copy")
    assert finding.place is not None
    assert "1 times" not in finding.message


def test_a_copy_among_several_control_recordings_is_named(made, run):
    control = [
        dataclasses.replace(made["stand, the same program"](CONTROL_SEED), name="true control"),
        copies.altered(run, "single precision", SEED),
    ]
    with pytest.raises(imucal.InputError) as raised:
        imucal.calibrate(run, control=control)
    assert [finding.recording for finding in raised.value.findings] == ["copy"]


def test_gap_refuses_a_copy_as_control(run):
    gap = imucal.find_gap(run, control=copies.altered(run, "rounded to 4 decimals", SEED))
    assert gap.verdict == "data_fault"
    assert [effect["name"] for effect in gap.effects] == ["control_not_independent"]


def test_recordings_that_are_calibrated_together_are_independent(made, run):
    part = copies.altered(run, "a gain of 1.001", SEED)
    with pytest.raises(imucal.InputError, match="give every recording once") as raised:
        imucal.calibrate([run, part])
    assert [finding.code for finding in raised.value.findings] == ["recordings_overlap"]
    result = imucal.calibrate([run, made["stand, the same program"](CONTROL_SEED)])
    assert result.verdict == "good"


def test_the_halves_of_one_real_recording_are_independent(data_file):
    files = [data_file(f"xsens_mti/xsens_{sensor}.mat") for sensor in ("acc", "gyro")]
    whole = imucal.read(*files, format="imu_tk")
    middle = len(whole) // 2
    first, second = (
        imucal.Recording(
            np.array(whole.time_s[part]),
            np.array(whole.specific_force[part]),
            np.array(whole.angular_rate[part]),
            accel_unit="lsb",
            gyro_unit="lsb",
            name=name,
        )
        for part, name in ((slice(middle), "first"), (slice(middle, None), "second"))
    )
    assert imucal.calibrate(first, control=second).control_set is not None
    with pytest.raises(imucal.InputError, match="control_not_independent"):
        imucal.calibrate(first, control=dataclasses.replace(whole, name="whole"))
