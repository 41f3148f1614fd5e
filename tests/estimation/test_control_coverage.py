"""Control recordings that do not test every axis, and large residuals within the stated uncertainty."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import imucal
from changes import changed, rate
from imucal import Program, Step
from imucal.units import STANDARD_GRAVITY_MPS2

TURNS = (90, 90, 90, 90, -90, -90, -90, 45, 45, -90, -90, -90)


@pytest.fixture(scope="module")
def calibration():
    program = Program.random(seed=1, moves=24)
    return imucal.calibrate(imucal.simulate(program, seed=1, rate_hz=100).recording).calibration


def about(axis, seed, unit="paper"):
    """Rests with turns about one axis."""
    steps = [Step([turn if k == axis else 0 for k in range(3)], 2.0, 3.0) for turn in TURNS]
    return imucal.simulate(Program(tuple(steps)), seed=seed, unit=unit, rate_hz=100).recording


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


def test_one_move_between_two_skew_poses_tests_no_axis(calibration):
    """Each scale alone would be visible, but not three scales that compensate each other."""
    control = imucal.simulate(Program.random(seed=7, moves=1), seed=7, rate_hz=100).recording
    (reason,) = imucal.evaluate(calibration, control).reasons
    assert (
        "[axes_not_tested]" in reason
        and all(f"accel_{axis}" in reason for axis in "xyz")
        and "gyro" in reason
    )


def test_moves_about_one_skew_axis_test_no_other_direction():
    program = Program.random(seed=1, moves=24)
    ideal = imucal.calibrate(imucal.simulate(program, seed=1, unit="ideal", rate_hz=100).recording)
    on_edge = about(0, 5, unit="ideal")
    skew = Rotation.from_euler("zyx", [40, 35, 20], degrees=True)
    control = changed(
        on_edge,
        specific_force=skew.apply(np.array(on_edge.specific_force)),
        angular_rate=skew.apply(np.array(on_edge.angular_rate)),
    )
    evaluation = imucal.evaluate(ideal.calibration, control)
    assert evaluation.figures.chi2_per_dof < 2
    (reason,) = evaluation.reasons
    assert "[axes_not_tested]" in reason and "gyro_y, gyro_z" in reason


@pytest.mark.parametrize(("signs", "is_tested"), [((1, -1), True), ((1,), False)])
def test_an_accelerometer_needs_axes_that_point_up_and_down(calibration, signs, is_tested):
    """Where an axis only points up, an error of its bias may compensate one of its scale."""
    random = np.random.default_rng(8)
    up = np.concatenate([sign * np.eye(3) for sign in signs])
    force = np.repeat(up, 400, axis=0) * STANDARD_GRAVITY_MPS2
    measured = force @ calibration.accelerometer.sensitivity.T + calibration.accelerometer.bias
    time_s = np.arange(len(force)) / 100
    control = imucal.Recording(time_s, measured + 0.01 * random.normal(size=force.shape), None)
    evaluation = imucal.evaluate(imucal.Calibration(calibration.accelerometer, None), control)
    assert evaluation.figures.rests == len(up)
    assert (evaluation.verdict == "good") == is_tested, evaluation.reasons


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
