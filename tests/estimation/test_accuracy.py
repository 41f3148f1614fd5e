"""A small part of `make accuracy`: the bound, the fit beside it, and that its scoring can fail."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import accuracy.contaminated
import accuracy.page
import imucal
from children import HANGS_S, with_path

pytestmark = pytest.mark.slow

BENCHES = Path(__file__).resolve().parents[2] / "benches"
RUNS = 40
SPOILT_RUNS = 6


# --- the bound ---


def deviations(covariance):
    return np.sqrt(np.diag(covariance))


def test_the_bound_is_that_of_finite_differences():
    """Another program of the same bound: data predicted from the parameters, and differences of them."""
    import bound

    run = accuracy.scene.PAPER.run(3)
    ours = deviations(accuracy.bound.bound(run.truth, accuracy.scene.PAPER.sample_noise))
    theirs = deviations(bound.bound(run, bound.paper_unit_noise(200.0)))
    # Its moves are one sample of 400 longer.
    np.testing.assert_allclose(ours, theirs, rtol=2e-3)


def test_a_hand_takes_nothing_from_the_size_of_gravity():
    """Without a gyroscope that is all there is, and a tremor does not change it."""
    scene = accuracy.scene.HELD
    run = scene.run(1)
    noise = replace(scene.sample_noise, gyro=1e4 * scene.sample_noise.gyro)
    held = deviations(accuracy.bound.bound(run.truth, noise, held=True))
    still = deviations(accuracy.bound.bound(run.truth, noise))
    np.testing.assert_allclose(held[:9], still[:9], rtol=1e-3)


def test_what_a_hand_hides_is_the_rate_about_the_vertical():
    """With a perfect accelerometer a held rest tells two components of the bias, a still one all three."""
    scene = accuracy.scene.HELD
    run = scene.run(1)
    noise = replace(scene.sample_noise, accel=1e-6 * scene.sample_noise.accel)
    # No moves: rests alone tell of the bias.
    between = [(a[1], b[0]) for a, b in zip(run.truth.rests, run.truth.rests[1:], strict=False)]
    held = accuracy.bound.bound(run.truth, noise, held=True, rests=run.truth.rests, lost=between)
    seconds = sum(end - start for start, end in run.truth.rests)
    of_still = noise.gyro**2 / 200.0 / seconds
    turned = np.linalg.inv(run.truth.calibration.gyroscope.sensitivity)
    information = np.trace(np.linalg.inv(turned @ held[9:12, 9:12] @ turned.T))
    assert information * of_still == pytest.approx(2.0, rel=0.1)


def test_less_data_is_a_larger_bound():
    scene = accuracy.scene.PAPER
    run = scene.run(2)
    whole = deviations(accuracy.bound.bound(run.truth, scene.sample_noise))
    half = deviations(accuracy.bound.bound(run.truth, scene.sample_noise, rests=run.truth.rests[:23]))
    lost = deviations(accuracy.bound.bound(run.truth, scene.sample_noise, lost=[(10.0, 80.0)]))
    assert (half > 1.1 * whole).all()
    assert (lost[12:] > 1.05 * whole[12:]).all()
    np.testing.assert_allclose(lost[:9], whole[:9], rtol=0.02)


def test_how_many_nodes_follow_a_hand_does_not_matter(monkeypatch):
    scene = accuracy.scene.HELD
    run = scene.run(1)
    ours = deviations(accuracy.bound.bound(run.truth, scene.sample_noise, held=True))
    monkeypatch.setattr(accuracy.bound, "NODE_S", accuracy.bound.NODE_S / 4.0)
    finer = deviations(accuracy.bound.bound(run.truth, scene.sample_noise, held=True))
    np.testing.assert_allclose(ours, finer, rtol=1e-3)


# --- runs ---


@pytest.fixture(scope="module")
def paper():
    scene = accuracy.scene.PAPER
    return accuracy.figures.SceneFigures(
        scene, [accuracy.trial.trial(scene, seed) for seed in range(1, RUNS)]
    )


def test_the_joint_fit_is_at_the_bound_and_says_so(paper):
    assert [gate.what for gate in paper.gates() if not gate.met] == []
    square, error = paper.mean_square_score
    assert abs(square - 1.0) < 4.0 * error


def test_the_joint_fit_beats_the_two_stage_one(paper):
    """The bias of the gyroscope is also seen in the moves."""
    gain = paper.two_stage.rmse / paper.joint.rmse
    assert np.sqrt((gain[9:12] ** 2).mean()) > 1.03
    assert np.sqrt((gain**2).mean()) > 1.0


def test_a_run_by_hand_is_at_the_bound():
    scene = accuracy.scene.HELD
    trials = [accuracy.trial.trial(scene, seed) for seed in range(1, 1 + RUNS // 2)]
    gates = accuracy.figures.SceneFigures(scene, trials).gates()
    assert [gate.what for gate in gates if not gate.met] == []


def test_flicker_is_the_same_with_and_without_white_noise():
    scene = replace(accuracy.scene.PAPER, flicker=10.0)
    run = scene.run(1)
    wandering = scene.true_parameters(run) - replace(scene, flicker=0.0).true_parameters(run)
    assert 1e-6 < np.abs(wandering[9:12]).max() < 3e-4
    assert not wandering[:9].any() and not wandering[12:].any()
    exact = run.truth.angular_rate @ run.truth.calibration.gyroscope.sensitivity.T
    off = run.recording.angular_rate - exact - run.truth.calibration.gyroscope.bias
    # White noise of 0.35 deg/s over 64,000 samples.
    assert np.abs(off.mean(axis=0) - wandering[9:12]).max() < 5.0 * 6.2e-3 / np.sqrt(64_000)


# --- contaminated runs ---


@pytest.mark.parametrize(
    "name",
    ["clean", "slip", "nudge", "bad rests", "bad moves", "heavy tails"],
)
def test_contaminated_runs_do_little_harm_and_are_named(name):
    runs = [accuracy.contaminated.spoilt(name, seed) for seed in range(1, 1 + SPOILT_RUNS)]
    gates = accuracy.contaminated.Contamination.of(name, runs).gates()
    assert [gate.what for gate in gates if not gate.met] == []


def test_a_fault_is_the_same_in_every_run():
    for name in accuracy.faults.FAULTS:
        one, again = (accuracy.faults.contaminated(name, 5) for _ in range(2))
        assert np.array_equal(one.recording.angular_rate, again.recording.angular_rate)
        assert one.bad == again.bad


@pytest.mark.parametrize("name", ["slip", "nudge", "bad rests", "bad moves"])
def test_what_is_said_to_be_bad_is_where_the_recording_is_bad(name):
    """Outside of it, and of the moves beside it, the recording is what the truth makes of it."""
    case = accuracy.faults.contaminated(name, 4)
    unit = case.truth.calibration
    kept = np.isin(case.truth.time_s, case.recording.time_s)
    rate = case.truth.angular_rate[kept] @ unit.gyroscope.sensitivity.T + unit.gyroscope.bias
    force = case.truth.specific_force[kept] @ unit.accelerometer.sensitivity.T + unit.accelerometer.bias
    off = np.abs(case.recording.angular_rate - rate).max(axis=1) > 6.5 * 6.2e-3
    off |= np.abs(case.recording.specific_force - force).max(axis=1) > 6.5 * 1.75e-2
    inside = [(bad.start_s - 1e-9, bad.end_s + 1e-9) for bad in case.bad]
    time_s = case.recording.time_s[off]
    assert all(any(a <= t <= b for a, b in inside) for t in time_s)
    assert len(case.bad) >= 1


# --- the scoring can fail ---


def made(*, runs=4000, rmse=1.0, sigma=1.0, bias=0.0, chi2=1.0):
    """Trials of an estimator with this RMSE and these stated sigmas, in units of the bound."""
    random = np.random.default_rng(1)
    trials = []
    for _ in range(runs):
        error = rmse * random.normal(size=21) + bias
        estimate = accuracy.trial.Estimate(error, np.full(21, sigma), chi2 * random.chisquare(253) / 253, 253)
        trials.append(accuracy.trial.Trial(("p",) * 21, estimate, estimate, np.ones(21), 0))
    return accuracy.figures.SceneFigures(accuracy.scene.PAPER, trials)


@pytest.mark.parametrize(
    ("wrong", "missed"),
    [
        ({}, []),
        ({"sigma": 0.9}, ["coverages"]),
        ({"sigma": 1.1}, ["coverages"]),
        ({"rmse": 1.12, "sigma": 1.12}, ["RMSE", "efficiency"]),
        ({"bias": 0.2}, ["bias"]),
        ({"chi2": 1.02}, ["mean of the reduced chi2"]),
    ],
)
def test_a_wrong_estimator_misses_its_gates(wrong, missed):
    figures = made(**wrong)
    whats = [gate.what.removeprefix("paper: ") for gate in figures.gates() if not gate.met]
    assert [what.split(",")[0].split(" / ")[0].split(" outside")[0] for what in whats] == missed


def test_figures_that_are_missed_are_printed_so():
    good, bad = made(runs=500), made(runs=500, rmse=2.0)
    assert "**missed**" not in accuracy.page.page([good], [], 0.0)
    assert "**missed**" in accuracy.page.page([bad], [], 0.0)


def result(rests, moves):
    """What a calibration says of rests (start, end, reason) and of moves between them (reason)."""
    return SimpleNamespace(
        rests=[SimpleNamespace(start_s=a, end_s=b, excluded=reason) for a, b, reason in rests],
        moves=[
            SimpleNamespace(from_rest=k, to_rest=k + 1, excluded=reason) for k, reason in enumerate(moves)
        ],
        findings=[],
    )


def test_names_are_compared_with_what_is_bad():
    Bad, Named, score = accuracy.naming.Bad, accuracy.naming.Named, accuracy.naming.score
    rest, move = Bad("rest", 7.0, 12.0), Bad("move", 12.5, 12.6)
    plain = [(0.0, 5.0, None), (7.0, 12.0, None), (14.0, 19.0, None)]
    assert score(result(plain, [None, None]), [rest]) == Named(1, 0, 2, 0)
    left_out = [plain[0], (7.0, 12.0, "contradicts_other_rests"), plain[2]]
    assert score(result(left_out, [None, None]), [rest]) == Named(1, 1, 2, 0)
    both = ["contradicts_other_moves"] * 2
    assert score(result(plain, both), [rest]) == Named(1, 1, 2, 0)
    assert score(result(plain, [None, both[1]]), [rest]) == Named(1, 0, 2, 0)
    # The rest was not taken for one.
    assert score(result([plain[0], plain[2]], [None]), [rest]) == Named(1, 1, 2, 0)
    assert score(result(plain, [None, "contradicts_other_moves"]), [move]) == Named(1, 1, 4, 0)
    # The other move is named instead.
    assert score(result(plain, ["contradicts_other_moves", None]), [move]) == Named(1, 0, 4, 1)
    # It need not be named, but may be.
    harmless = replace(move, to_see=False)
    assert score(result(plain, [None, "encoders_disagree"]), [harmless]) == Named(0, 0, 4, 0)


def test_runs_without_a_result_are_missed():
    def refuse(recording):
        raise imucal.InputError("refused")

    run = accuracy.contaminated.spoilt("clean", 1, by=refuse)
    gates = accuracy.contaminated.Contamination.of("clean", [run]).gates()
    assert not any(gate.met for gate in gates)


def test_one_wild_run_is_not_forgiven():
    """The margin of a gate is that of a perfect estimator, and does not grow with the errors."""
    runs = [accuracy.contaminated.spoilt("clean", seed) for seed in range(1, 6)]
    runs[0] = replace(runs[0], error=100.0 * runs[0].error)
    gates = accuracy.contaminated.Contamination.of("clean", runs).gates()
    assert [gate.met for gate in gates if "RMSE" in gate.what] == [False, False]


def test_the_program_runs(tmp_path):
    page = tmp_path / "page.md"
    done = subprocess.run(
        [sys.executable, "-m", "accuracy", "paper", "contaminated", "--runs", "2", "--output", page],
        env=with_path(BENCHES),
        capture_output=True,
        text=True,
        timeout=HANGS_S,
    )
    assert done.returncode == 0, done.stderr
    text = page.read_text(encoding="utf-8")
    assert "## Parameter by parameter: paper" in text
    assert "| heavy tails: RMSE / bound, all parameters |" in text
