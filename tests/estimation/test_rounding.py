"""Calibration and search with noise below a step of the converter."""

import dataclasses
import math
import statistics

import numpy as np
import pytest

import imucal
from changes import changed, coarse_run

DEG = math.pi / 180
STEP_DPS = 0.07
SEEDS = range(1, 9)


def unit_of(seed: int) -> imucal.Unit:
    """An LSM6DSO at ±2000 deg/s with biases anywhere between two steps."""
    unit = imucal.Unit.random("lsm6dso", seed)
    return imucal.Unit(unit.accelerometer, dataclasses.replace(unit.gyroscope, lsb=STEP_DPS * DEG))


def run_of(unit: imucal.Unit, seed: int, poses: int = 20) -> imucal.Recording:
    motion = imucal.Tumble(seed=seed, poses=poses, hold_s=3.0, move_s=1.5)
    return imucal.simulate(motion, seed=seed, unit=unit, rate_hz=100, filter_hz=10).recording


@pytest.fixture(scope="module")
def results() -> dict[int, imucal.CalibrationResult]:
    return {seed: imucal.calibrate(run_of(unit_of(seed), seed)) for seed in SEEDS}


def test_the_biases_are_within_their_standard_deviations(
    results: dict[int, imucal.CalibrationResult],
) -> None:
    errors = []
    for seed, result in results.items():
        std = {parameter.name: parameter.std for parameter in result.parameters}
        error = result.calibration.gyroscope.bias - unit_of(seed).gyroscope.bias
        errors += [error[i] / std[f"gyro_bias_{x}"] for i, x in enumerate("xyz")]
    assert np.max(np.abs(errors)) < 5.0
    # The standard deviation of a mean square of 24 errors is 0.29.
    assert 0.3 < np.mean(np.square(errors)) < 3.0


def test_the_finding_names_axis_step_and_noise(results: dict[int, imucal.CalibrationResult]) -> None:
    for result in results.values():
        (finding,) = [finding for finding in result.findings if finding.code == "noise_below_lsb"]
        assert finding.severity == "warning"
        assert list(finding.columns) == ["gyro_x", "gyro_y", "gyro_z"]
        assert "step of 0.07 deg/s" in finding.message
        # White noise of the datasheet behind a filter of 10 Hz, in steps.
        noise = unit_of(1).gyroscope.noise_density * math.sqrt(2 * 1.11 * 10) / (STEP_DPS * DEG)
        assert finding.value == pytest.approx(noise, rel=0.5)


def test_inspect_predicts_the_standard_deviation_of_the_bias(
    results: dict[int, imucal.CalibrationResult],
) -> None:
    seen = imucal.inspect(run_of(unit_of(1), 1))
    assert "noise_below_lsb" in [finding.code for finding in seen.findings]
    predicted = {sigma.name: sigma.std for sigma in seen.predicted_sigma}
    for parameter in results[1].parameters:
        if parameter.name.startswith("gyro_bias"):
            assert predicted[parameter.name] == pytest.approx(parameter.std, rel=0.6)


def test_a_linear_unit_is_given_no_effect_and_rounding_comes_first() -> None:
    unit = unit_of(3)
    gap = imucal.find_gap(run_of(unit, 31), control=run_of(unit, 32, poses=14))
    assert gap.verdict not in ("named", "ambiguous")
    lines = gap.summary().splitlines()
    assert "noise_below_lsb" in lines[1]
    assert sum("noise_below_lsb" in line for line in lines) == 2


@pytest.mark.parametrize("seed", [13, 20, 21, 22, 36])
def test_a_step_near_the_noise_leaves_a_good_result(seed: int) -> None:
    noise = imucal.Unit.random("paper", seed).accelerometer.noise_density * math.sqrt(100.0)
    result = imucal.calibrate(coarse_run(seed).recording)
    assert result.verdict == "good"
    # The mean of about 300 samples, with rounding noise of the variance step^2 / 12.
    expected = noise * math.sqrt((1 + 1.5**2 / 12) / 300)
    assert statistics.median(rest.norm_sigma_mps2 for rest in result.rests) == pytest.approx(
        expected, rel=0.3
    )


def test_a_fine_converter_has_no_finding() -> None:
    unit = imucal.Unit.random("lsm6dso", 1)
    fine = imucal.Unit(unit.accelerometer, dataclasses.replace(unit.gyroscope, lsb=None, bits=None))
    result = imucal.calibrate(run_of(fine, 1))
    assert "noise_below_lsb" not in [finding.code for finding in result.findings]


def test_a_plan_contains_the_error_of_rounding() -> None:
    unit = imucal.Unit.named("lsm6dso")
    std = []
    for lsb in (0.02 * DEG, 3 * STEP_DPS * DEG):
        coarse = imucal.Unit(unit.accelerometer, dataclasses.replace(unit.gyroscope, lsb=lsb))
        plan = imucal.plan("random", unit=coarse, rate_hz=100.0)
        std.append({p.name: p.std for p in plan.parameters}["gyro_bias_x"])
    assert std[1] > 3 * std[0]


@pytest.mark.parametrize("seed", [33, 51])
def test_poses_that_read_one_level_by_chance_do_not_contradict_each_other(seed: int) -> None:
    """An accelerometer of 8 bit reads one level in several poses, whose forces differ by up to a step."""
    unit = imucal.Unit.random("lsm6dso", seed)
    coarse = dataclasses.replace(unit.accelerometer, lsb=9.80665 / 64, bits=8)
    motion = imucal.Tumble(seed=2 * seed, poses=20, hold_s=3.0, move_s=1.5)
    run = imucal.simulate(motion, seed=2 * seed, unit=imucal.Unit(coarse, unit.gyroscope), rate_hz=100.0)
    result = imucal.calibrate(run.recording)
    assert "noise_below_lsb" in [finding.code for finding in result.findings]
    assert result.verdict == "good"
    assert {residuals.kind: residuals.ratio for residuals in result.residuals}["norms"] < 2.0


def test_the_end_of_a_move_behind_a_filter_is_not_taken_for_noise() -> None:
    """A filter of 5 Hz delays the end of a move into the rest by 0.2 s."""
    values = []
    for seed in range(1, 6):
        unit = imucal.Unit.random("mpu6050", seed)
        gyroscope = dataclasses.replace(unit.gyroscope, lsb=DEG / 16.4)
        motion = imucal.Tumble(seed=2 * seed, poses=20, hold_s=3.0, move_s=1.5)
        coarse = imucal.Unit(unit.accelerometer, gyroscope)
        run = imucal.simulate(motion, seed=2 * seed, unit=coarse, rate_hz=100.0, filter_hz=5.0)
        (finding,) = [f for f in imucal.inspect(run.recording).findings if f.code == "noise_below_lsb"]
        values.append(finding.value)
    noise = gyroscope.noise_density * math.sqrt(2 * 1.11 * 5.0) / gyroscope.lsb
    # With a fifth of a step of noise, an estimate depends on how far the bias is from the next step.
    assert statistics.median(values) == pytest.approx(noise, rel=0.15)
    assert max(values) < 1.15 * noise


@pytest.mark.parametrize("lively", [1, 2])
def test_few_lively_rests_do_not_hide_the_rounding_of_the_others(lively: int) -> None:
    """Their large noise dithers their own samples, and the quiet rests still have an error in common."""
    recording = imucal.simulate("random", seed=1).recording
    fine = imucal.calibrate(recording)
    rates = recording.angular_rate.copy()
    noise = np.median([rates[rest.first : rest.end].std(axis=0) for rest in fine.rests])
    random = np.random.default_rng(5)
    for rest in fine.rests[20 : 20 + lively]:
        rates[rest.first : rest.end] += random.normal(0.0, 6 * noise, (rest.end - rest.first, 3))
    results = [
        imucal.calibrate(changed(recording, angular_rate=values))
        for values in (rates, np.rint(rates / (3 * noise)) * 3 * noise)
    ]
    assert "noise_below_lsb" in [finding.code for finding in results[1].findings]
    std = [parameter.std for parameter in results[1].parameters if parameter.name.startswith("gyro_bias")]
    exact, rounded = (result.calibration.gyroscope.bias for result in results)
    assert np.max(np.abs(rounded - exact) / std) < 4.0
