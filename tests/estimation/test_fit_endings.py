"""Joint fits that cannot converge end poor, with the reason."""

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.estimation.fit import triad_of_fit


@pytest.fixture(scope="module")
def run():
    program = imucal.Program.random(seed=1, moves=24)
    return imucal.simulate(program, seed=1, rate_hz=100, temperature=25.0).recording


def test_a_bound_of_five_iterations(run, tmp_path, capsys):
    """A time constant needs more iterations than five."""
    whole = imucal.calibrate(run, effects=["gyro_bias_warmup"])
    assert whole.verdict == "good" and whole.fit.joint.iterations > 5
    result = imucal.calibrate(run, effects=["gyro_bias_warmup"], max_iterations=5)
    assert result.verdict == "poor"
    assert (result.fit.joint.termination, result.fit.joint.iterations) == ("iteration_limit", 5)
    (reason,) = [reason for reason in result.reasons if "the joint fit" in reason]
    assert "reached its limit of 5 iterations" in reason and "the result is not its optimum" in reason

    path = tmp_path / "run.parquet"
    imucal.write(run, path)
    words = ["calibrate", str(path), "--effect", "gyro_bias_warmup", "--max-iterations", "5"]
    assert main(words) == 2
    assert "the joint fit reached its limit of 5 iterations" in capsys.readouterr().out


def test_a_flat_valley(run):
    """A strong drift, exactly linear in time, fitted as a warm-up: the time constant has no optimum."""
    drift = np.array([6e-5, -3e-5, 9e-5])
    drifting = imucal.Recording(
        run.time_s,
        run.specific_force,
        run.angular_rate + run.time_s[:, None] * drift,
    )
    result = imucal.calibrate(drifting, effects=["gyro_bias_warmup"])
    assert result.verdict == "poor", result.fit.joint
    assert result.fit.joint.termination != "converged"
    assert any("the joint fit" in reason for reason in result.reasons)


def test_a_residual_with_a_kink(run):
    """The field jumps where the mean of the corrected rate crosses a level, which each fit crosses."""
    drift_radps, late = 1e-3, run.time_s > 5.0
    ramp, wave = late * run.time_s / run.time_s[-1], late * np.sin(run.time_s)

    def field(state):
        column = wave if state.angular_rate[:400, 0].mean() > -drift_radps / 4 else ramp
        return column[:, None, None] * np.array([[1.0], [0.0], [0.0]])

    jump = imucal.UserEffect("gyro_jump", "gyroscope", (imucal.EffectParameter("x", "rad/s", 1e-3),), field)
    drift = drift_radps * run.time_s / run.time_s[-1]
    drifting = imucal.Recording(
        run.time_s, run.specific_force, run.angular_rate + drift[:, None] * [1.0, 0.0, 0.0]
    )
    result = imucal.calibrate(drifting, effects=[jump])
    assert result.verdict == "poor"
    assert result.fit.joint.termination == "fields_not_settled"
    assert any("or has a kink" in reason for reason in result.reasons)


@pytest.mark.parametrize("bound", [0, -1, 2.5, True, 10**6])
def test_bounds_that_are_none(run, bound):
    with pytest.raises(imucal.InputError, match="max_iterations"):
        imucal.calibrate(run, max_iterations=bound)


@pytest.mark.parametrize(
    ("sensor", "nominal", "cause"),
    [
        ("accel", 8192.0, r"accel_nominal = 8192 is in lsb per m/s\^2, not per g"),
        ("gyro", 32.75, "gyro_nominal = 32.75 is in lsb per rad/s, not per deg/s"),
        ("gyro", None, "check the units of its columns"),
    ],
)
def test_a_sensitivity_that_no_sensor_has_names_its_cause(sensor, nominal, cause):
    singular = np.array([[2.78e6, 306.0, -2.92e6], [306.0, 2103.0, 0.1], [-2.92e6, 0.1, 3.08e6]])
    with pytest.raises(imucal.InputError, match=f"that no sensor has: .*{cause}"):
        triad_of_fit(sensor, singular, np.zeros(3), nominal)
