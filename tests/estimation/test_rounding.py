"""Calibration and search with noise below a step of the converter."""

import dataclasses
import math

import numpy as np
import pytest

import imucal

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
