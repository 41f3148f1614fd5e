"""Recordings of several units, and of a unit whose biases moved: findings and the results of their advice."""

import dataclasses

import numpy as np
import pytest
from advice import of_code

import imucal


def of(unit, seed, **options):
    program = imucal.Program.random(seed=seed, moves=24)
    return imucal.simulate(program, unit=unit, seed=seed, rate_hz=50, **options)


@pytest.fixture(scope="module")
def runs():
    return [of(f"random:paper:{seed}", seed) for seed in (1, 2, 3)]


def test_three_units_are_named_and_each_is_right_by_itself(runs):
    recordings = [run.recording for run in runs]
    with pytest.raises(imucal.InputError) as raised:
        imucal.calibrate(recordings)
    (finding,) = raised.value.findings
    assert finding.code == of_code("several_units")
    assert "3 different units" in finding.message and "sigma" in finding.message
    assert finding.way_out.startswith("calibrate each unit from its own recordings")
    assert all(recording.name in finding.message for recording in recordings)
    for run in runs:
        result = imucal.calibrate(run.recording)
        truth = {p.name: p.value for p in run.truth.calibration.parameters}
        assert all(abs(p.value - truth[p.name]) < 5 * p.std for p in result.parameters)


def test_units_are_named_in_a_search(runs):
    gap = imucal.find_gap([run.recording for run in runs[:2]])
    assert gap.verdict == "data_fault"
    assert [finding.code for finding in gap.findings] == ["several_units"], gap.summary()


def test_two_recordings_of_one_of_two_units(runs):
    again = of("random:paper:1", 11)
    with pytest.raises(imucal.InputError, match="2 different units") as raised:
        imucal.calibrate([runs[0].recording, runs[1].recording, again.recording])
    names = f"({runs[0].recording.name} and {again.recording.name}; {runs[1].recording.name})"
    assert names in str(raised.value)


def test_a_short_recording_of_another_unit_is_said_to_be_unused(runs):
    """Too short for a fit of its own, so it is no evidence of a second unit."""
    other = of("random:paper:7", 3).recording
    short = imucal.Recording(
        other.time_s[:1000], other.specific_force[:1000], other.angular_rate[:1000], name="short"
    )
    result = imucal.calibrate([runs[0].recording, short])
    (finding,) = [finding for finding in result.findings if finding.code == of_code("recording_unused")]
    assert finding.recording == "short" and finding.way_out.startswith(
        "check that this recording is of the same unit"
    )
    # Followed: without it.
    result = imucal.calibrate(runs[0].recording)
    assert result.verdict == "good" and not result.findings


def test_moved_biases_are_those_of_one_unit(runs):
    recording = of("random:paper:1", 12).recording
    moved = dataclasses.replace(recording, angular_rate=recording.angular_rate + np.array([0.02, 0.0, 0.0]))
    result = imucal.calibrate([runs[0].recording, moved])
    (finding,) = [finding for finding in result.findings if finding.code == of_code("biases_moved")]
    assert "gyroscope bias x by 1.1 deg/s" in finding.message, finding
    assert "record without switching the unit off" in finding.way_out
    # Followed: recordings without a switch in between, here those of the biases that did not move.
    result = imucal.calibrate([runs[0].recording, recording])
    assert result.verdict == "good" and not result.findings


def test_a_unit_at_another_temperature_is_no_other_unit():
    scale = {"gyro_scale_temperature": (2e-4, -1e-4, 1.5e-4)}
    runs = [of("paper", seed, temperature=degc, effects=scale) for seed, degc in ((1, 20.0), (2, 50.0))]
    result = imucal.calibrate([run.recording for run in runs])
    assert "several_units" not in {finding.code for finding in result.findings}
    result = imucal.calibrate([run.recording for run in runs], effects=list(scale))
    assert result.verdict == "good", result.reasons
