"""Simulated runs of the paper's unit: parameters are judged against the truth, in their own stated sigmas.

`convert_frame` of `imucal._core` gives the truth in the frame of the calibration, and `in_frame` converts a
calibration, because the public API has no function for either.
"""

import numpy as np
import pytest

import imucal
import imucal._core as _core
from exact_covariance import normalised
from imucal import Program, Step
from imucal.calibration.frame import in_frame

pytestmark = pytest.mark.slow

SEEDS = range(1, 21)
WORST = 5.0  # sigmas; 420 normal numbers pass it once in 4000 tries
WORST_DISTURBED = 6.0


def errors_in_sigma(result, truth):
    """Error of each of the 21 parameters over its own stated standard deviation."""
    pairs = list(zip(result.parameters, truth.parameters, strict=True))
    assert all(ours.name == true.name for ours, true in pairs)
    return np.array([(ours.value - true.value) / ours.std for ours, true in pairs])


def in_triangular_frame(unit):
    accel, gyro = _core.convert_frame(
        unit.accelerometer.sensitivity, unit.gyroscope.sensitivity, "triangular"
    )
    assert np.triu(accel, 1).tolist() == np.zeros((3, 3)).tolist()
    return imucal.Calibration(
        imucal.Triad(accel, unit.accelerometer.bias),
        imucal.Triad(gyro, unit.gyroscope.bias),
        frame="triangular",
    )


# --- the paper's program, undisturbed ---


@pytest.fixture(scope="module")
def paper_runs():
    """Errors in sigma (seeds, 21), chi2 per degree of freedom and the number of rests and moves left out."""
    errors, chi2, left_out = [], [], []
    for seed in SEEDS:
        run = imucal.simulate("random", unit="paper", rate_hz=200, seed=seed)
        result = imucal.calibrate(run.recording)
        assert len(result.rests) == len(run.truth.rests) == 46
        errors.append(errors_in_sigma(result, run.truth.calibration))
        chi2.append([fit.chi2 / fit.degrees_of_freedom for fit in fits(result)])
        left_out.append(sum(item.excluded is not None for item in (*result.rests, *result.moves)))
    return np.array(errors), np.array(chi2), left_out


def fits(result):
    return result.fit.accelerometer, result.fit.gyroscope


def test_every_parameter_is_within_its_own_sigmas(paper_runs):
    errors, _, _ = paper_runs
    assert errors.shape == (20, 21)
    assert np.abs(errors).max() < WORST


def test_stated_sigmas_are_neither_too_small_nor_too_large(paper_runs):
    errors, _, _ = paper_runs
    mean_square = (errors**2).mean(axis=0)
    assert mean_square.min() > 0.3
    assert mean_square.max() < 2.5
    assert mean_square.mean() == pytest.approx(1, abs=0.25)


def test_noise_explains_the_residuals(paper_runs):
    _, chi2, _ = paper_runs
    # 37 and 81 degrees of freedom, 20 runs: the mean scatters by 0.052 and 0.035.
    assert chi2[:, 0].mean() == pytest.approx(1, abs=0.21)
    assert chi2[:, 1].mean() == pytest.approx(1, abs=0.14)


def test_good_rests_and_moves_are_kept(paper_runs):
    _, _, left_out = paper_runs
    assert sum(left_out) == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_triangular_frame(seed):
    run = imucal.simulate("random", unit="paper", rate_hz=200, seed=seed)
    result = imucal.calibrate(run.recording, frame="triangular")
    truth = in_triangular_frame(run.truth.calibration)
    assert np.abs(errors_in_sigma(result, truth)).max() < WORST
    assert np.triu(result.calibration.accelerometer.sensitivity, 1).any() == np.False_
    # Another program of the propagation: numerical derivatives instead of those of model.md (2).
    converted = in_frame(imucal.calibrate(run.recording).calibration, "triangular").covariance
    assert normalised(result.calibration.covariance, converted) == pytest.approx(
        normalised(converted, converted), abs=1e-4
    )


def test_two_recordings_of_one_unit_are_better_than_one():
    random = imucal.simulate("random", unit="paper", rate_hz=200, seed=1)
    grid = imucal.simulate("grid", unit="paper", rate_hz=200, seed=2)
    alone = imucal.calibrate(random.recording)
    together = imucal.calibrate([random.recording, grid.recording])
    assert np.abs(errors_in_sigma(together, random.truth.calibration)).max() < WORST
    gain = np.array([b.std / a.std for a, b in zip(alone.parameters, together.parameters, strict=True)])
    # 236 rests instead of 46: sqrt(46 / 236) = 0.44 for the nine of the accelerometer and the gyroscope's
    # bias if all poses told the same; the grid crowds at its poles, so some gain less.
    assert gain[:12].mean() == pytest.approx(0.44, abs=0.06)
    assert gain[:12].max() < 0.6
    # Its moves say little more of the gyroscope; standard deviations follow the scatter of the residuals.
    assert gain[12:].max() < 1.15
    assert gain[12:].mean() < 1
    assert {rest.recording for rest in together.rests} == {"simulated-1", "simulated-2"}


def test_the_grid_alone_does_not_determine_the_gyroscope():
    """It turns about one body axis but for eight small steps."""
    grid = imucal.simulate("grid", unit="paper", rate_hz=100, seed=2)
    with pytest.raises(imucal.NotEnoughMotionError, match="hardly any rotation about body x"):
        imucal.calibrate(grid.recording)


# --- disturbed rests ---

DISTURBED = 20  # index of the disturbed rest
HOLD_S = 5.0


def run_with(steps_in_rest, seed):
    """The paper's program with a shorter rest and further steps in place of one rest."""
    steps = list(Program.random(seed=seed).steps)
    turn = steps[DISTURBED]
    assert turn.hold_s == HOLD_S
    steps[DISTURBED] = Step(turn.turn_deg, turn.move_s, steps_in_rest[0])
    steps[DISTURBED + 1 : DISTURBED + 1] = steps_in_rest[1:]
    return imucal.simulate(Program(tuple(steps)), rate_hz=200, seed=seed)


def changed(recording, *, force=None, rate=None):
    return imucal.Recording(
        recording.time_s,
        recording.specific_force if force is None else force,
        recording.angular_rate if rate is None else rate,
        name="disturbed",
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_nudge_does_no_harm(seed):
    """A bump of 0.3 s in the middle of a rest: 1 deg on each motor, and back."""
    nudge = [2.4, Step((1.0, 1.0, 1.0), 0.15, 0.0), Step((-1.0, -1.0, -1.0), 0.15, 2.3)]
    run = run_with(nudge, seed)
    result = imucal.calibrate(run.recording)
    assert np.abs(errors_in_sigma(result, run.truth.calibration)).max() < WORST_DISTURBED
    before = run.truth.rests[DISTURBED]
    bump = (before[1] + 0.05, before[1] + 0.25)
    for rest in result.rests:
        assert rest.end_s < bump[0] or rest.start_s > bump[1] or rest.excluded


def slipped(turn_deg, seed):
    """A run in which the unit slips within a rest and the gyroscope says nothing of it; the slip's time."""
    run = run_with([2.5, Step((turn_deg,) * 3, 0.1, 2.4)], seed)
    start_s = run.truth.rests[DISTURBED][1]
    end_s = run.truth.rests[DISTURBED + 1][0]
    time_s = run.recording.time_s
    jump = np.flatnonzero((time_s >= start_s - 0.01) & (time_s <= end_s + 0.01))
    rate = run.recording.angular_rate.copy()
    rate[jump] = rate[jump - 100]
    return changed(run.recording, rate=rate), run.truth, (start_s, end_s)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_large_slip_is_left_out(seed):
    recording, truth, (start_s, end_s) = slipped(10.0, seed)
    result = imucal.calibrate(recording)
    assert np.abs(errors_in_sigma(result, truth.calibration)).max() < WORST_DISTURBED
    (left_out,) = (m for m in result.moves if m.excluded is not None)
    assert left_out.excluded == "contradicts_other_moves"
    assert recording.time_s[left_out.first] < end_s
    assert recording.time_s[left_out.last] > start_s


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_small_slip_does_no_harm_and_shows(seed):
    """Gravity turns by 0.6 to 1.8 deg: the rest stays one, and is named by its unsteadiness."""
    recording, truth, (start_s, _) = slipped(2.0, seed)
    result = imucal.calibrate(recording)
    assert np.abs(errors_in_sigma(result, truth.calibration)).max() < WORST_DISTURBED
    unsteady = [rest for rest in result.rests if rest.unsteadiness > 10]
    assert [rest.start_s < start_s < rest.end_s for rest in unsteady] == [True]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_bad_rest_is_left_out(seed):
    """One rest reads 0.1 m/s^2 too much along the axis that is nearest to the vertical."""
    run = imucal.simulate("random", rate_hz=200, seed=seed)
    start_s, end_s = run.truth.rests[DISTURBED]
    time_s = run.recording.time_s
    inside = (time_s >= start_s) & (time_s <= end_s)
    up = run.truth.specific_force[inside][0]
    axis = np.abs(up).argmax()
    force = run.recording.specific_force.copy()
    force[inside, axis] += 0.1 * np.sign(up[axis])
    result = imucal.calibrate(changed(run.recording, force=force))
    assert np.abs(errors_in_sigma(result, run.truth.calibration)).max() < WORST_DISTURBED
    left_out = [(k, rest.excluded) for k, rest in enumerate(result.rests) if rest.excluded is not None]
    assert left_out == [(DISTURBED, "contradicts_other_rests")]


def test_bad_rests_that_are_too_many_show_in_the_figures():
    run = imucal.simulate("random", rate_hz=200, seed=1)
    force = run.recording.specific_force.copy()
    for start_s, end_s in run.truth.rests[::2]:
        force[(run.recording.time_s >= start_s) & (run.recording.time_s <= end_s)] += 0.1
    quiet, loud = (
        imucal.calibrate(r).calibration_set for r in (run.recording, changed(run.recording, force=force))
    )
    assert loud.chi2_per_dof > 100 * quiet.chi2_per_dof
