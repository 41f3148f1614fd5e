"""A unit that rests on the faces of a box alone: rests and moves together determine all parameters."""

import dataclasses

import numpy as np
import pytest

import imucal
from bench_module import bench_module

OFF_DIAGONAL = tuple(f"accel_sensitivity_{pair}" for pair in ("xy", "xz", "yz"))


@pytest.fixture(scope="module")
def bench():
    """The bench of `make faces`."""
    with bench_module("faces") as module:
        yield module


def skewed(seed):
    """The paper's unit with scale errors and misalignments of several degrees."""
    random = np.random.default_rng(seed)
    paper = imucal.Unit.named("paper")
    skew = random.uniform(-0.08, 0.08, (3, 3))
    accel = np.diag(random.uniform(0.95, 1.05, 3)) + np.triu(skew, 1) + np.triu(skew, 1).T
    gyro = np.diag(random.uniform(0.95, 1.05, 3)) + random.uniform(-0.08, 0.08, (3, 3)) * (1 - np.eye(3))
    return dataclasses.replace(
        paper,
        accelerometer=dataclasses.replace(
            paper.accelerometer, sensitivity=accel, bias=random.uniform(-0.5, 0.5, 3)
        ),
        gyroscope=dataclasses.replace(paper.gyroscope, sensitivity=gyro),
    )


def faces(seed=1, unit=None, **options):
    return imucal.simulate(imucal.Program.faces(**options), unit=unit or skewed(seed), rate_hz=100, seed=seed)


def require_truth(result, truth, sigmas=4.5):
    for found, true in zip(result.parameters, truth.calibration.parameters, strict=True):
        assert abs(found.value - true.value) < sigmas * found.std, found.name


def rows(recording, keep):
    return dataclasses.replace(
        recording,
        time_s=recording.time_s[keep] - recording.time_s[keep][0],
        specific_force=recording.specific_force[keep],
        angular_rate=recording.angular_rate[keep],
    )


@pytest.mark.parametrize("seed", range(1, 7))
def test_all_parameters_are_determined_from_a_start_without_misalignment(seed):
    run = faces(seed)
    result = imucal.calibrate(run.recording)
    assert result.verdict == "good"
    require_truth(result, run.truth)


def test_inspect_predicts_the_sigmas_and_names_what_the_moves_determine():
    run = faces()
    seen = imucal.inspect(run.recording)
    result = imucal.calibrate(run.recording)
    assert seen.missing is None
    assert seen.through_moves == OFF_DIAGONAL
    stated = [found.std for found in result.parameters]
    assert [p.std for p in seen.predicted_sigma] == pytest.approx(stated, rel=0.5)
    everywhere = imucal.simulate(imucal.Program.random(seed=1, moves=20), seed=1, rate_hz=100)
    assert imucal.inspect(everywhere.recording).through_moves == ()


def test_raw_counts_without_a_nominal_sensitivity():
    run = faces(3)
    g_counts, dps_counts = 8192 / 9.80665, 64 * 180 / np.pi
    counts = dataclasses.replace(
        run.recording,
        specific_force=np.round(run.recording.specific_force * g_counts),
        angular_rate=np.round(run.recording.angular_rate * dps_counts),
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    result = imucal.calibrate(counts)
    truth = [p.value for p in run.truth.calibration.parameters]
    scale = np.r_[np.full(9, g_counts), np.full(12, dps_counts)]
    for found, true in zip(result.parameters, truth * scale, strict=True):
        assert abs(found.value - true) < 5 * found.std, found.name


@pytest.mark.parametrize(("what", "size"), [("specific_force", 0.4), ("angular_rate", 0.3)])
def test_one_spoilt_rest_or_move_is_excluded(what, size):
    """A rest with a wrong mean force, or a move with a jolt of the gyroscope."""
    run = faces(2, rounds=2)
    start, end = run.truth.rests[6]
    first, last = np.searchsorted(run.recording.time_s, (start, end))
    spoilt = getattr(run.recording, what).copy()
    if what == "specific_force":
        spoilt[first:last] += size
    else:
        spoilt[last + 40 : last + 80] += size
    result = imucal.calibrate(dataclasses.replace(run.recording, **{what: spoilt}))
    require_truth(result, run.truth)
    assert [r.excluded for r in (*result.rests, *result.moves) if r.excluded]


def test_six_faces_once_are_refused_with_what_is_missing():
    turns = [(90.0, 0.0, 0.0)] * 3 + [(90.0, 90.0, 0.0), (0.0, 180.0, 0.0)]
    steps = [imucal.Step((0, 0, 0), 0, 3), *(imucal.Step(turn, 1.5, 3.0) for turn in turns)]
    run = imucal.simulate(imucal.Program(tuple(steps)), unit=skewed(1), rate_hz=100, seed=1)
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(run.recording)
    message = str(caught.value)
    assert "6 rests do not determine the accelerometer's misalignment" in message
    assert "add rests with edges and corners up" in message
    assert "four turns of 90 deg about each axis" in message
    seen = imucal.inspect(run.recording)
    assert seen.missing == message
    assert seen.through_moves == ()


def test_the_two_stage_fit_alone_refuses():
    with pytest.raises(imucal.NotEnoughMotionError, match="the joint fit determines them from the moves"):
        imucal.calibrate(faces().recording, joint=False)


def test_coverage_and_errors_over_the_bound(bench):
    """The bench of docs/results/faces.md with fewer seeds."""
    trials = [bench.trial(scene, seed) for scene in bench.SCENES for seed in range(1, 11)]
    assert [trial.reason for trial in trials if trial.is_determined and trial.estimate is None] == []
    found = [trial for trial in trials if trial.estimate is not None]
    assert len(found) > 40
    errors = np.array([trial.estimate.error for trial in found])
    inside = np.abs(errors) < 1.959964 * np.array([trial.estimate.std for trial in found])
    assert 0.92 < inside.mean() < 0.98
    assert np.sqrt(np.mean((errors / np.array([trial.bound for trial in found])) ** 2)) < 1.05
