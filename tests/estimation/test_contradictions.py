"""Runs of the paper's unit with something wrong in them: who is named, and whether the result stays right."""

import csv
import re
from dataclasses import astuple, replace

import numpy as np
import pytest

import imucal

RATE_HZ = 100
WORST = 5.0  # sigmas


def calibrated(run, *, force=None, rate=None, keep=slice(None)):
    """A changed run, calibrated; the result and the largest error of a parameter in its own sigmas."""
    recording = run.recording
    force = recording.specific_force if force is None else force
    rate = recording.angular_rate if rate is None else rate
    result = imucal.calibrate(
        imucal.Recording(recording.time_s[keep], force[keep], rate[keep], name="spoilt")
    )
    truth = run.truth.calibration.parameters
    errors = [(p.value - true.value) / p.std for p, true in zip(result.parameters, truth, strict=True)]
    return result, np.abs(errors).max()


def simulated(seed):
    return imucal.simulate("random", unit="paper", rate_hz=RATE_HZ, seed=seed)


def inside(run, start_s, end_s):
    return (run.truth.time_s >= start_s) & (run.truth.time_s <= end_s)


def bumped(run, moves, random):
    """The rates with 60 ms that are off by 50 to 200 deg/s on one axis in the middle of some moves."""
    rate = run.recording.angular_rate.copy()
    for k in moves:
        middle_s = (run.truth.rests[k][1] + run.truth.rests[k + 1][0]) / 2
        rate[inside(run, middle_s, middle_s + 0.06), random.integers(3)] += np.radians(
            random.uniform(50, 200)
        )
    return rate


def pushed(run, rests, random):
    """The forces with rests that are off by 0.1 m/s^2 in any direction."""
    force = run.recording.specific_force.copy()
    for k in rests:
        direction = random.normal(size=3)
        force[inside(run, *run.truth.rests[k])] += 0.1 * direction / np.linalg.norm(direction)
    return force


def left_out(result):
    """Rests by number, moves by the rest before, and why."""
    return (
        {k: rest.excluded for k, rest in enumerate(result.rests) if rest.excluded},
        {m.from_rest: m.excluded for m in result.moves if m.excluded},
    )


def turning(run, rest, rate_degps):
    """Force and rate of a run whose unit turns evenly about a slanted axis while it seems to rest."""
    recording, (start_s, end_s) = run.recording, run.truth.rests[rest]
    time_s, axis = recording.time_s, np.array([1.0, 0.5, -0.3])
    axis /= np.linalg.norm(axis)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(rate_degps) * np.clip(time_s - start_s, 0, end_s - start_s)
    # Back into the turned body, by Rodrigues' formula.
    back = (
        np.eye(3)
        - np.sin(angle)[:, None, None] * cross
        + (1 - np.cos(angle))[:, None, None] * (cross @ cross)
    )
    force, rate = (
        np.einsum("nij,nj->ni", back, rows) for rows in (recording.specific_force, recording.angular_rate)
    )
    rate[inside(run, start_s, end_s)] += np.radians(rate_degps) * axis
    return force, rate


@pytest.mark.parametrize("seed", range(302, 308))
@pytest.mark.parametrize("rate_degps", [2.0, 4.0])
def test_a_slow_turn_between_rests_of_a_hand_leaves_no_trace_in_the_bias(seed, rate_degps):
    hand = imucal.Tumble(seed=seed, poses=18, hold_s=3.0, tremor_deg=0.1, translation_mm=100.0)
    run = imucal.simulate(hand, unit="bmi088", seed=seed, rate_hz=RATE_HZ)
    force, rate = turning(run, 9, rate_degps)
    result, error = calibrated(run, force=force, rate=rate)
    start_s, end_s = run.truth.rests[9]
    cut, _ = calibrated(run, keep=~inside(run, start_s - 0.1, end_s + 0.1))
    assert error < WORST
    assert result.fit.tremor_deg[0] == pytest.approx(cut.fit.tremor_deg[0], rel=0.1)
    for own, other in zip(result.parameters, cut.parameters, strict=True):
        if own.name.startswith("gyro_bias"):
            assert abs(own.value - other.value) < other.std


@pytest.mark.parametrize("seed", range(1, 11))
def test_a_turn_about_the_vertical_in_a_rest_of_a_hand_leaves_no_trace_in_the_bias(seed):
    hand = imucal.Tumble(seed=seed, poses=30, tremor_deg=0.2)
    run = imucal.simulate(hand, unit="bmi088", seed=seed, rate_hz=RATE_HZ)
    start_s, end_s = run.truth.rests[15]
    middle_s = (start_s + end_s) / 2
    turning = inside(run, middle_s - 1, middle_s + 1)
    # Ten degrees in two seconds: gravity does not show them, nor always the mean rate.
    w, x, y, z = run.truth.rotation_wxyz[turning].T
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    profile = 1 - np.cos(np.pi * (run.truth.time_s[turning] - middle_s + 1))
    rate = run.recording.angular_rate.copy()
    rate[turning] += np.radians(10) / 2 * profile[:, None] * up
    result, _ = calibrated(run, rate=rate)
    cut, _ = calibrated(run, keep=~inside(run, start_s - 0.1, end_s + 0.1))
    assert result.rests[15].excluded in ("rest_not_still", "contradicts_other_rests")
    for own, other in zip(result.parameters, cut.parameters, strict=True):
        if own.name.startswith("gyro_bias"):
            assert abs(own.value - other.value) < 2 * other.std


@pytest.mark.parametrize("seed", range(1, 7))
def test_bad_rests_and_bad_moves_are_named_and_no_others(seed):
    run, random = simulated(seed), np.random.default_rng(seed)
    # Any rests but those at the ends; moves that no bad rest makes one longer move of.
    rests = random.choice(np.arange(2, 22), 2, replace=False)
    moves = 24 + 2 * random.choice(10, 2, replace=False)
    result, error = calibrated(run, force=pushed(run, rests, random), rate=bumped(run, moves, random))
    assert left_out(result) == (
        dict.fromkeys(sorted(rests), "contradicts_other_rests"),
        dict.fromkeys(sorted(moves), "contradicts_other_moves"),
    )
    assert error < WORST
    for k in rests:
        assert any(f"rest {k} (" in note and "contradicts_other_rests" in note for note in result.notes)
    for k in moves:
        assert any(f"from rest {k} to {k + 1} " in note for note in result.notes)
    # What is left is noise: nothing is widened to make room for what was bad.
    assert set(astuple(result.fit.joint.scales)) == {1.0}


def test_a_move_with_a_gap_is_left_out():
    run = simulated(1)
    middle_s = (run.truth.rests[20][1] + run.truth.rests[21][0]) / 2
    result, error = calibrated(run, keep=~inside(run, middle_s, middle_s + 0.2))
    assert left_out(result) == ({}, {20: "samples_missing"})
    assert error < WORST


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_heavy_tails_are_no_contradiction(seed):
    """Student's t with three degrees of freedom instead of normal noise."""
    unit = imucal.Unit.named("paper")
    sensors = {name: getattr(unit, name) for name in ("accelerometer", "gyroscope")}
    silent = replace(
        unit, **{name: replace(s, noise_density=0.0, lsb=None, bits=None) for name, s in sensors.items()}
    )
    run = imucal.simulate("random", unit=silent, rate_hz=RATE_HZ, seed=seed)
    random = np.random.default_rng(seed)

    def noisy(exact, std):
        return exact + std * random.standard_t(3, size=exact.shape) / np.sqrt(3)

    force, rate = run.recording.specific_force, run.recording.angular_rate
    result, error = calibrated(run, force=noisy(force, 0.02), rate=noisy(rate, 2e-3))
    assert left_out(result) == ({}, {})
    assert error < WORST


@pytest.mark.slow
def test_the_command_lists_what_it_leaves_out_and_what_it_widens(command, tmp_path):
    run, random = simulated(2), np.random.default_rng(2)
    force = pushed(run, [10], random)
    # All rests read a little wrong: noise does not explain the norms.
    for start_s, end_s in run.truth.rests:
        force[inside(run, start_s, end_s)] += random.normal(scale=2e-3, size=3)
    path = tmp_path / "run.csv"
    names = [
        f"{sensor}_{axis}_{unit}" for sensor, unit in (("accel", "mps2"), ("gyro", "radps")) for axis in "xyz"
    ]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *names])
        writer.writerows(np.column_stack([run.recording.time_s, force, bumped(run, [30], random)]).tolist())
    done = command("calibrate", path, "--json", tmp_path / "result.json")
    assert done.returncode == 0, done.stderr
    for line in (
        r"rest 10 \(\d+\.\d\d s to \d+\.\d\d s\) of \S* excluded: contradicts_other_rests",
        r"move from rest 30 to 31 of \S* excluded: contradicts_other_moves",
        r"standard deviations of the norm of gravity at the rests are widened by the factor \d\.\d, .*",
    ):
        assert re.search(f"^{line}$", done.stdout, re.MULTILINE), f"{line}\n{done.stdout}"
