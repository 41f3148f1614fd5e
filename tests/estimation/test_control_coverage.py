"""Control recordings that do not test every axis, and large residuals within the stated uncertainty."""

import numpy as np
import pytest

import imucal
from changes import changed, rate
from imucal import Program, Step

TURNS = (90, 90, 90, 90, -90, -90, -90, 45, 45, -90, -90, -90)


@pytest.fixture(scope="module")
def calibration():
    program = Program.random(seed=1, moves=24)
    return imucal.calibrate(imucal.simulate(program, seed=1, rate_hz=100).recording).calibration


def about(axis, seed):
    """Rests with turns about one axis."""
    steps = [Step([turn if k == axis else 0 for k in range(3)], 2.0, 3.0) for turn in TURNS]
    return imucal.simulate(Program(tuple(steps)), seed=seed, rate_hz=100).recording


@pytest.mark.parametrize("axis", [0, 1])
def test_axes_without_rotation_are_not_tested(calibration, axis):
    evaluation = imucal.evaluate(calibration, about(axis, 5))
    assert evaluation.verdict == "incomplete"
    (reason,) = evaluation.reasons
    assert "[axes_not_tested]" in reason
    others = [f"gyro_{name}" for k, name in enumerate("xyz") if k != axis]
    assert all(name in reason for name in others) and f"gyro_{'xyz'[axis]}" not in reason


def test_an_error_about_an_axis_that_is_not_tested_is_not_good(calibration):
    control = rate(lambda w: w * [1.0, 0.5, 0.5])(about(0, 6))
    assert imucal.evaluate(calibration, control).verdict == "incomplete"


def test_rests_and_moves_about_every_axis_are_enough(calibration):
    control = imucal.simulate(Program.random(seed=7, moves=6), seed=7, rate_hz=100).recording
    assert imucal.evaluate(calibration, control).verdict == "good"


def test_the_uncertainty_of_a_calibration_explains_large_residuals():
    """Six faces determine no misalignment; its prior is wide compared with the noise of the control."""
    turns = [(0, 0, 0), (90, 0, 0), (0, 0, 90), (90, 0, 0), (0, 90, 0), (0, 0, 90)]
    faces = imucal.simulate(Program(tuple(Step(turn, 2.0, 4.0) for turn in turns)), seed=11, rate_hz=100)
    result = imucal.calibrate(changed(faces.recording), model="orthogonal")
    control = imucal.simulate(Program.random(seed=2, moves=30), seed=2, rate_hz=100)
    evaluation = imucal.evaluate(result.calibration, changed(control.recording))
    assert evaluation.verdict == "incomplete", evaluation.reasons
    assert any("[calibration_uncertain]" in reason for reason in evaluation.reasons)


def test_a_rest_that_contradicts_the_others_is_named(calibration):
    """A transient of the biases after power-on; the figures contain the first rest, the verdict does not."""
    control = imucal.simulate(Program.random(seed=7, moves=24), seed=7, rate_hz=100).recording
    transient = np.exp(-control.time_s / 2.0)[:, np.newaxis]
    warming = changed(control, specific_force=control.specific_force + 0.1 * transient)
    evaluation = imucal.evaluate(calibration, warming)
    assert evaluation.verdict == "good" and evaluation.figures.chi2_per_dof > 5
    (finding,) = [finding for finding in evaluation.findings if finding.code == "control_outliers"]
    assert "the first one begins at 0.00 s" in finding.message
    assert not imucal.evaluate(calibration, changed(control)).findings


def test_a_large_outlier_is_not_explained_by_the_uncertainty_of_the_calibration(calibration):
    control = imucal.simulate(Program.random(seed=7, moves=24), seed=7, rate_hz=100).recording
    rest = imucal.evaluate(calibration, control).rests[10]
    pushed = (control.time_s > rest.start_s - 0.5) & (control.time_s < rest.end_s + 0.5)
    force = control.specific_force + 0.5 * pushed[:, np.newaxis]
    evaluation = imucal.evaluate(calibration, changed(control, specific_force=force))
    assert evaluation.figures.chi2_per_dof > 100
    assert evaluation.verdict == "poor" and "[large_residuals]" in evaluation.reasons[0]
