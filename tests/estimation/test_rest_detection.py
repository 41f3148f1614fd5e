"""Rests without an initial rest and without a threshold: noise from 1/10 to 10 times, 25 Hz to 8 kHz."""

from dataclasses import replace

import numpy as np
import pytest

import imucal
from changes import after_table_rest, hand_run
from imucal import Program, Step

# Datasheet noise of the paper's sensors, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
DENSITY = np.array([np.radians(0.025), 126e-6 * 9.80665])
# Ends of a rest: a window of half a second decides, in blocks of 0.05 s.
OVERLAP_S = 0.25
LOST_S = 0.25


@pytest.fixture
def run(measured):
    """A recording with `noise` times the paper's noise, and the true rests (rests, 2)."""

    def make(rate_hz, noise, seed, *, steps=None, tremor_deg=0.0, steady_rests=0):
        steps = steps or Program.random(seed=seed, moves=8, hold_s=3.0).steps
        truth = imucal.simulate(Program(tuple(steps)), rate_hz=rate_hz, seed=seed).truth
        time_s = np.arange(len(truth.angular_rate)) / rate_hz
        rate, force = truth.angular_rate, truth.specific_force
        if tremor_deg:
            rate, force = trembling(time_s, rate, force, truth.rests[steady_rests:], tremor_deg, seed)
        sigma = noise * DENSITY * rate_hz**0.5
        return measured(truth.calibration, time_s, rate, force, sigma=sigma, seed=seed), np.array(truth.rests)

    return make


def trembling(time_s, rate, force, rests, amplitude_deg, seed):
    """Motion with a hand's tremor in these rests: small turns phi about each axis, R exp(phi)."""
    random = np.random.default_rng(seed)
    hertz, phase = random.uniform(3, 9, (3, 5)), random.uniform(0, 2 * np.pi, (3, 5))
    share = random.uniform(0.5, 1, (3, 5))
    share *= np.radians(amplitude_deg) / share.sum(axis=1, keepdims=True)
    held = np.zeros_like(time_s)
    for start_s, end_s in rests:
        held = np.maximum(held, np.clip(np.minimum(time_s - start_s, end_s - time_s) / 0.2, 0, 1))
    wave = (share * np.sin(2 * np.pi * hertz * time_s[:, None, None] + phase)).sum(axis=-1)
    turn = held[:, None] * wave
    return rate + np.gradient(turn, time_s, axis=0), force - np.cross(turn, force)


def require_true_rests(inspection, true):
    found = np.array([(rest.start_s, rest.end_s) for rest in inspection.rests])
    assert len(found) == len(true), inspection.explanation
    outside = np.maximum(true[:, 0] - found[:, 0], found[:, 1] - true[:, 1])
    lost = np.maximum(found[:, 0] - true[:, 0], true[:, 1] - found[:, 1])
    assert outside.max() < OVERLAP_S
    assert lost.max() < LOST_S


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [25, 100, 400, 1000, 8000])
@pytest.mark.parametrize("noise", [0.1, 1.0, 10.0])
def test_on_a_stand(run, rate_hz, noise):
    for seed in (1, 2, 3) if rate_hz <= 1000 else (1,):
        recording, true = run(rate_hz, noise, seed)
        require_true_rests(imucal.inspect(recording), true)


@pytest.mark.parametrize("rate_hz", [25, 100, 400])
@pytest.mark.parametrize("noise", [0.1, 1.0, 10.0])
def test_in_a_hand(run, rate_hz, noise):
    """Every rest trembles by 0.3 deg at 3 to 9 Hz."""
    for seed in (1, 2, 3):
        steps = Program.random(seed=seed, moves=12, hold_s=4.0).steps
        recording, true = run(rate_hz, noise, seed, steps=steps, tremor_deg=0.3)
        require_true_rests(imucal.inspect(recording), true)


@pytest.mark.parametrize("rate_hz", [25, 100, 400])
@pytest.mark.parametrize("noise", [0.1, 1.0])
@pytest.mark.parametrize("tremor_deg", [0.1, 0.3])
def test_in_a_hand_after_a_rest_on_the_table(run, rate_hz, noise, tremor_deg):
    """The one quiet rest must not be all that is found: a hundred times quieter than a hand."""
    for seed in (1, 2, 3):
        steps = [Step((0, 0, 0), 0.0, 15.0), *Program.random(seed=seed, moves=15, hold_s=4.0).steps]
        recording, true = run(rate_hz, noise, seed, steps=steps, tremor_deg=tremor_deg, steady_rests=1)
        require_true_rests(imucal.inspect(recording), true)


@pytest.mark.parametrize("tremor_deg", [0.3, 0.5])
@pytest.mark.parametrize("duration_s", [10.0, 20.0, 40.0])
def test_a_rest_on_a_table_does_not_hide_the_rests_in_a_hand(tremor_deg, duration_s):
    """The level of the hand is nearer to that of the moves than to that of the table."""
    for seed in (1, 2, 3):
        alone = hand_run(seed, tremor_deg).recording
        after = after_table_rest(seed, duration_s)(alone)
        inspection = imucal.inspect(after)
        assert len(inspection.rests) == len(imucal.inspect(alone).rests) == 20, inspection.explanation
        # The rest on the table is the steadiest of all, and not a slow rotation.
        rests = imucal.calibrate(after).rests
        assert rests[0].unsteadiness < 2 < rests[1].unsteadiness
        assert rests[0].excluded is None


@pytest.mark.parametrize("tremor_deg", [0.1, 0.3])
@pytest.mark.parametrize("seed", [2, 4, 5])
def test_a_unit_held_by_hand_is_calibrated(run, tremor_deg, seed):
    steps = [Step((0, 0, 0), 0.0, 15.0), *Program.random(seed=seed, moves=25, hold_s=4.0).steps]
    recording, _ = run(100, 1.0, seed, steps=steps, tremor_deg=tremor_deg, steady_rests=1)
    truth = imucal.simulate(Program(tuple(steps)), rate_hz=100, seed=seed).truth.calibration
    result = imucal.calibrate(recording)
    for ours, true in zip(result.parameters, truth.parameters, strict=True):
        assert abs(ours.value - true.value) < 6 * ours.std, ours.name
    # A sensitivity within 0.5 %: tremor is taken for noise, so these figures are on the safe side.
    gyroscope = [p.std for p in result.parameters if p.name.startswith("gyro_sensitivity")]
    assert max(gyroscope) < 5e-3


def test_a_static_recording_is_one_rest(run):
    recording, true = run(100, 1.0, 1, steps=[Step((0, 0, 0), 0.0, 30.0)])
    inspection = imucal.inspect(recording)
    assert true.tolist() == [[0, 30]]
    require_true_rests(inspection, true)
    assert "1 rest does not determine" in inspection.missing


def test_it_says_which_threshold_and_why(run):
    recording, true = run(100, 1.0, 1)
    inspection = imucal.inspect(recording)
    threshold = inspection.threshold
    assert threshold.stable_from <= threshold.factor <= threshold.stable_to
    assert f"below {threshold.factor:.1f} times the noise variance" in inspection.explanation
    assert f"gives {len(true)} rests" in inspection.explanation
    # The field noise_floor is the standard deviation of a sample that was put in.
    put_in = np.repeat(DENSITY, 3) * 10
    assert threshold.noise_floor == pytest.approx(put_in, rel=0.15)
    assert threshold.window_s == pytest.approx(0.5)


def test_min_rest_s_decides_what_is_a_rest(run):
    """Holds of 3 s are rests for 2.5 s and not for 4 s."""
    recording, true = run(100, 1.0, 1)
    require_true_rests(imucal.inspect(recording, min_rest_s=2.5), true)
    inspection = imucal.inspect(recording, min_rest_s=4.0)
    assert inspection.rests == ()
    assert "no rest of 4 s or more" in inspection.explanation
    with pytest.raises(imucal.NotEnoughMotionError, match=r"no rest of 4 s or more in \d+ samples: hold"):
        imucal.calibrate(recording, min_rest_s=4.0)


def test_by_the_command(run, command, tmp_path):
    recording, true = run(100, 1.0, 1)
    imucal.write(recording, tmp_path / "run.csv")
    done = command("inspect", tmp_path / "run.csv")
    assert f"{len(true)} rests" in done.stdout
    assert "times the noise variance" in " ".join(done.stdout.split())


def test_a_noisy_gyroscope_is_not_too_insensitive():
    """What rests keep of the moves next to them is missing in every scale."""
    paper = imucal.Unit.named("paper")
    sensors = {
        name: replace(getattr(paper, name), noise_density=3.0 * getattr(paper, name).noise_density)
        for name in ("accelerometer", "gyroscope")
    }
    errors = []
    for seed in range(1, 31):
        run = imucal.simulate("random", seed=seed, unit=replace(paper, **sensors), rate_hz=128)
        result = imucal.calibrate(run.recording)
        true = run.truth.calibration.gyroscope.sensitivity
        stds = {p.name: p.std for p in result.parameters}
        error = np.diag(result.calibration.gyroscope.sensitivity - true)
        errors.append(error / [stds[f"gyro_sensitivity_{axis}{axis}"] for axis in "xyz"])
    # 90 numbers of standard deviation one.
    assert abs(np.mean(errors)) < 0.3
