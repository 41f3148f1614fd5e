"""The gyroscope of a unit whose accelerometer is already calibrated."""

import dataclasses

import numpy as np
import pytest

import imucal


@pytest.fixture(scope="module")
def runs():
    made = [imucal.simulate("random", unit="random:bmi088:7", seed=seed, rate_hz=100.0) for seed in (1, 2)]
    return [run.recording for run in made], made[0].truth.calibration


@pytest.fixture(scope="module")
def accelerometer(runs):
    return imucal.calibrate(runs[0][0].of_sensor("accelerometer")).calibration


def short(recording):
    """A part with too few poses for the accelerometer."""
    ends = [rest.end_s for rest in imucal.inspect(recording).rests]
    return recording.between(None, ends[6] + 0.05)


def test_few_poses_are_enough_with_a_known_accelerometer(runs, accelerometer):
    (_, second), truth = runs
    part = short(second)
    result = imucal.calibrate(part, calibration=accelerometer)
    assert result.verdict in ("good", "incomplete"), result.summary()
    expected = {p.name: p.value for p in truth.parameters}
    scaled = np.array([(p.value - expected[p.name]) / p.std for p in result.parameters[:21]])
    assert (np.abs(scaled) < 5).all(), scaled
    assert "prior with its covariance" in result.summary()


def test_its_covariance_is_in_the_result(runs, accelerometer):
    part = short(runs[0][1])
    known = imucal.calibrate(part, calibration=accelerometer)
    prior = {p.name: p.std for p in accelerometer.parameters}
    for parameter in known.parameters[:9]:
        # The recording adds information, and takes none.
        assert 0.3 * prior[parameter.name] < parameter.std <= 1.001 * prior[parameter.name], parameter.name
    vague = dataclasses.replace(accelerometer, covariance=100.0 * accelerometer.covariance)
    wide = imucal.calibrate(part, calibration=vague)
    std = [{p.name: p.std for p in result.parameters} for result in (known, wide)]
    assert all(std[1][name] >= 0.99 * std[0][name] for name in std[0])
    assert std[1]["accel_bias_x"] > 1.5 * std[0]["accel_bias_x"]


def test_all_poses_agree_with_the_estimate_of_both_recordings(runs, accelerometer):
    (first, second), _ = runs
    both = imucal.calibrate([first, second])
    known = imucal.calibrate(second, calibration=accelerometer)
    for one, other in zip(known.parameters[:9], both.parameters, strict=False):
        assert abs(one.value - other.value) < 2 * other.std, one.name
        assert 0.7 < one.std / other.std < 1.5, one.name


def test_an_accelerometer_that_has_changed_is_noticed(runs, accelerometer):
    second = runs[0][1]
    changed = imucal.Recording(
        second.time_s, second.specific_force + np.array([0.5, 0.0, 0.0]), second.angular_rate
    )
    result = imucal.calibrate(changed, calibration=accelerometer)
    assert result.verdict == "poor"
    assert any("accelerometer of the given calibration" in reason for reason in result.reasons), (
        result.reasons
    )


def test_what_does_not_fit_is_refused(runs, accelerometer):
    second = runs[0][1]
    with pytest.raises(imucal.InputError, match="axes"):
        imucal.calibrate(second.with_axes("x,-y,-z"), calibration=accelerometer)
    bare = dataclasses.replace(accelerometer, covariance=None, covariance_names=())
    with pytest.raises(imucal.InputError, match="no covariance"):
        imucal.calibrate(second, calibration=bare)
    with pytest.raises(imucal.InputError, match="sensor_missing"):
        imucal.calibrate(second.of_sensor("accelerometer"), calibration=accelerometer)


@pytest.fixture(scope="module")
def read(runs, tmp_path_factory):
    """Both recordings, read from files. The first file is also read under another name."""
    folder = tmp_path_factory.mktemp("known")
    for name, recording in zip(
        ("first.csv", "second.csv", "renamed.csv"), (*runs[0], runs[0][0]), strict=True
    ):
        imucal.write(recording, folder / name)
    return [imucal.read(folder / name) for name in ("first.csv", "second.csv", "renamed.csv")]


def test_the_same_data_never_count_twice(read):
    first, second, renamed = read
    for sensors in (first, first.of_sensor("accelerometer")):
        prior = imucal.calibrate(sensors).calibration
        for recordings in (first, renamed, [second, renamed]):
            with pytest.raises(imucal.InputError, match="made from the same file") as raised:
                imucal.calibrate(recordings, calibration=prior)
            assert [finding.code for finding in raised.value.findings] == ["recordings_overlap"]
    with pytest.raises(imucal.InputError, match="control_not_independent"):
        imucal.calibrate(second, calibration=prior, control=renamed)
    # The result is made from the file of its prior, too.
    later = imucal.calibrate(second, calibration=prior).calibration
    assert later.provenance.files == (*second.sources, *first.sources)
    for recording in (first, second):
        with pytest.raises(imucal.InputError, match="recordings_overlap"):
            imucal.calibrate(recording, calibration=later)
    assert [f.code for f in imucal.evaluate(later, renamed).findings] == ["seen_by_the_fit"]


@pytest.mark.parametrize("verdict", ["incomplete", "poor"])
def test_a_result_is_no_better_than_its_prior(runs, accelerometer, verdict):
    prior = dataclasses.replace(accelerometer, verdict=verdict, reasons=("the unit was dropped",))
    result = imucal.calibrate(runs[0][1], calibration=prior)
    reason = f"the given calibration of the accelerometer is {verdict}: the unit was dropped"
    assert (result.verdict, result.reasons[0]) == (verdict, reason)
    assert result.calibration.judged == (result.verdict, result.reasons)


def test_the_calibration_of_another_unit_is_named_once(runs):
    other = imucal.simulate("random", unit="random:bmi088:8", seed=3, rate_hz=100.0).recording
    known = imucal.calibrate(other.of_sensor("accelerometer")).calibration
    result = imucal.calibrate(runs[0][0], calibration=known)
    assert result.verdict == "poor"
    (reason,) = [reason for reason in result.reasons if "prior_contradicted" in reason]
    assert "contradict the accelerometer of the given calibration by" in reason
    assert "most of all its accel_" in reason
    assert "another unit" in reason
