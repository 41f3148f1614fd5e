"""The joint fit beside a SciPy program of the same equations, docs/model.md (17) to (19)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import imucal
from exact_covariance import normalised, variance_of_white_noise

pytestmark = pytest.mark.slow

# What no standard deviation is finer than, m/s^2, rad and rad/s.
FINEST_NORM, FINEST_DIRECTION, FINEST_RATE = 1e-5, 2e-5, 1e-6
STANDARD_GRAVITY_MPS2 = 9.80665


class Residuals:
    """Norms, rates and moves of the rests and moves that `result` found in `recording`, whitened."""

    def __init__(self, recording, result):
        self.recording, self.moves = recording, result.moves
        rests = [slice(rest.first, rest.end) for rest in result.rests]
        self.force = np.array([recording.specific_force[rest].mean(axis=0) for rest in rests])
        self.rate = np.array([recording.angular_rate[rest].mean(axis=0) for rest in rests])
        count = np.array([[rest.stop - rest.start] for rest in rests])
        variance = variance_of_white_noise(recording.specific_force, recording.time_s, rests) / count
        samples = variance_of_white_noise(recording.angular_rate, recording.time_s, rests)
        self.rate_sigma = np.sqrt(samples / count + FINEST_RATE**2)
        self.before = np.array([m.from_rest for m in self.moves])
        self.after = np.array([m.to_rest for m in self.moves])

        # At the solution: two directions across gravity after each move, and the covariance.
        model, g_sensitivity = unpacked(packed(result))
        up, turn = self.directions(model), self.turns(model, g_sensitivity)
        self.across = np.linalg.svd(up[self.after][:, None, :])[2][:, 1:]
        inverse = np.linalg.inv(model.accelerometer.sensitivity)
        plane = np.eye(3) - up[:, :, None] * up[:, None, :]
        by_mean = plane @ inverse / np.linalg.norm(self.forces(model), axis=1)[:, None, None]
        rests_count, moves_count = len(rests), len(self.moves)
        shared = np.zeros((rests_count + 2 * moves_count, rests_count, 3))
        for k in range(rests_count):
            shared[k, k] = inverse.T @ up[k]
        for k, (before, after) in enumerate(zip(self.before, self.after, strict=True)):
            rows = slice(rests_count + 2 * k, rests_count + 2 * k + 2)
            shared[rows, before] = self.across[k] @ turn[k].T @ by_mean[before]
            shared[rows, after] = -self.across[k] @ by_mean[after]
        shared = (shared * np.sqrt(variance)).reshape(len(shared), -1)
        density = np.median(samples, axis=0) * np.median(np.diff(recording.time_s))
        inverse = np.linalg.inv(model.gyroscope.sensitivity)
        walk = (inverse**2 @ density).sum() / 3 * np.array([m.duration_s for m in self.moves])
        own = np.concatenate([np.full(rests_count, FINEST_NORM**2), np.repeat(walk + FINEST_DIRECTION**2, 2)])
        self.whiten = np.linalg.inv(np.linalg.cholesky(np.diag(own) + shared @ shared.T))

    def forces(self, model):
        return true_of(model.accelerometer, self.force)

    def directions(self, model):
        force = self.forces(model)
        return force / np.linalg.norm(force, axis=1, keepdims=True)

    def turns(self, model, g_sensitivity):
        """Rotation of each move, body at the end to body at the start, with a cubic through four samples."""
        time_s = self.recording.time_s
        rate = true_of(model.gyroscope, self.recording.angular_rate)
        rate -= true_of(model.accelerometer, self.recording.specific_force) @ g_sensitivity.T
        mean = (-rate[:-3] + 13 * rate[1:-2] + 13 * rate[2:-1] - rate[3:]) / 24
        step_s = np.diff(time_s)[1:-1, None]
        turn = step_s * mean + step_s**2 / 12 * np.cross(rate[1:-2], rate[2:-1])
        # All moves are filled up to a power of two with steps that turn nothing, and multiplied pair by pair.
        steps = 1 << int(np.ceil(np.log2(max(m.last - m.first for m in self.moves))))
        vectors = np.zeros((len(self.moves), steps, 3))
        for k, m in enumerate(self.moves):
            vectors[k, : m.last - m.first] = turn[m.first - 1 : m.last - 1]
        rotation = Rotation.from_rotvec(vectors.reshape(-1, 3))
        while len(rotation) > len(self.moves):
            rotation = rotation[::2] * rotation[1::2]
        return rotation.as_matrix()

    def __call__(self, parameters):
        model, g_sensitivity = unpacked(parameters)
        up, forces = self.directions(model), self.forces(model)
        norms = np.linalg.norm(forces, axis=1) - STANDARD_GRAVITY_MPS2
        carried = np.einsum("kji,kj->ki", self.turns(model, g_sensitivity), up[self.before])
        moves = np.einsum("kci,ki->kc", self.across, carried - up[self.after])
        at_rest = forces @ (model.gyroscope.sensitivity @ g_sensitivity).T + model.gyroscope.bias
        rates = (self.rate - at_rest) / self.rate_sigma
        return np.concatenate([self.whiten @ np.concatenate([norms, moves.ravel()]), rates.ravel()])


def true_of(triad, readings):
    return (readings - triad.bias) @ np.linalg.inv(triad.sensitivity).T


def packed(result):
    return np.array([parameter.value for parameter in result.parameters])


def unpacked(parameters):
    """A calibration of the 21 parameters, in the order of `result.parameters`, and the g-sensitivity."""
    xx, yy, zz, xy, xz, yz = parameters[3:9]
    symmetric = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    gyroscope = imucal.Triad(parameters[12:21].reshape(3, 3), parameters[9:12])
    g_sensitivity = np.reshape(parameters[21:] if len(parameters) > 21 else np.zeros(9), (3, 3))
    return imucal.Calibration(imucal.Triad(symmetric, parameters[:3]), gyroscope), g_sensitivity


@pytest.mark.parametrize(("seed", "effects"), [(1, []), (2, ["gyro_g_sensitivity"])])
def test_scipy_finds_the_same_minimum_and_the_same_covariance(seed, effects):
    recording = imucal.simulate("random", unit="paper", rate_hz=100, seed=seed).recording
    joint = imucal.calibrate(recording, effects=effects)
    residuals = Residuals(recording, joint)
    two_stages = np.zeros(len(joint.parameters))
    two_stages[:21] = packed(imucal.calibrate(recording, joint=False))
    std = np.array([parameter.std for parameter in joint.parameters])
    found = least_squares(residuals, two_stages, x_scale=std, method="lm")
    assert joint.fit.joint.inflation == 1.0
    assert np.abs((packed(joint) - found.x) / std).max() < 1e-3
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    assert normalised(joint.calibration.covariance, covariance) == pytest.approx(
        normalised(covariance, covariance), abs=1e-3
    )
    assert joint.fit.joint.chi2 == pytest.approx(2 * found.cost, rel=1e-3)
    assert joint.fit.joint.degrees_of_freedom == len(found.fun) - len(std)
    # Another estimate is told apart.
    assert np.abs((packed(joint) - two_stages) / std).max() > 0.3


@pytest.mark.parametrize("seed", [1, 2])
def test_uneven_steps_are_integrated_at_their_own_times(seed):
    """Up to 2 ms early or late at 50 Hz, and stamped so: straight lines make the scales 0.01 % too small."""
    unit = imucal.Unit.named("paper")
    quiet = {
        name: replace(sensor, noise_density=0.01 * sensor.noise_density)
        for name, sensor in {"gyroscope": unit.gyroscope, "accelerometer": unit.accelerometer}.items()
    }
    run = imucal.simulate("random", unit=replace(unit, **quiet), rate_hz=1000, seed=seed)
    dense = run.recording
    chosen = np.arange(20, len(dense.time_s) - 20, 20)
    chosen = chosen + np.random.default_rng(seed).integers(-2, 3, len(chosen))
    uneven = imucal.Recording(dense.time_s[chosen], dense.specific_force[chosen], dense.angular_rate[chosen])
    scales = np.diag(imucal.calibrate(uneven).calibration.gyroscope.sensitivity)
    assert scales == pytest.approx(np.diag(run.truth.calibration.gyroscope.sensitivity), rel=4e-5)


# --- a bias that wanders, no profile given ---


@pytest.mark.parametrize(("rate_hz", "codes"), [(100, []), (50, ["noise_overestimated"])])
def test_a_tremor_that_is_taken_for_noise_is_said(rate_hz, codes):
    hand = imucal.Tumble(seed=1, poses=25, tremor_deg=0.1)
    result = imucal.calibrate(imucal.simulate(hand, seed=1, rate_hz=rate_hz).recording)
    assert [finding.code for finding in result.findings] == codes


def wandering(seed, bias_instability_degph):
    """A run of the paper's unit whose gyroscope wanders by so much, and its calibration without a profile."""
    unit = imucal.Unit.named("paper")
    instability = np.radians(bias_instability_degph) / 3600.0
    unit = replace(unit, gyroscope=replace(unit.gyroscope, bias_instability=instability))
    run = imucal.simulate("random", seed=seed, unit=unit)
    return run, imucal.calibrate(run.recording)


def test_a_steady_bias_is_not_said_to_wander():
    for seed in range(1, 6):
        _, result = wandering(seed, 0.0)
        assert result.fit.bias_instability_radps is None
        assert not any("bias instability of" in note for note in result.notes)


def test_a_large_bias_instability_is_seen_and_standard_deviations_are_true():
    found, squares = [], []
    for seed in range(1, 16):
        run, result = wandering(seed, 60.0)
        found.append(result.fit.bias_instability_radps)
        truth = np.array([parameter.value for parameter in run.truth.calibration.parameters])
        estimate, sigma = np.array([(p.value, p.std) for p in result.calibration.parameters]).T
        squares.append(((estimate - truth) / sigma)[12:] ** 2)
        notes = [note for note in result.notes if "bias instability of" in note]
        assert len(notes) == (found[-1] is not None)
        assert all("those of the mean over the recording" in note for note in notes)
    seen = np.degrees([b for b in found if b is not None]) * 3600.0
    # 46 rests are some 40 degrees of freedom on each of three axes; one run in ten may look like white noise.
    assert len(seen) >= 12
    assert np.median(seen) == pytest.approx(60.0, rel=0.15)
    # Nine parameters and fifteen runs: chi2 of 135 degrees of freedom, a band of 99.9 %.
    assert 0.66 < np.mean(squares) < 1.45


@pytest.mark.parametrize("seed", [1, 3, 5, 6])
def test_a_filter_does_not_make_a_stand_a_hand(seed):
    """Filtered noise has hardly any of the high frequencies by which sensors are told from a hand."""
    result = imucal.calibrate(imucal.simulate("random", seed=seed, filter_hz=15.0).recording)
    assert result.fit.tremor_deg == (None,)
    chi2, free = result.fit.joint.chi2, result.fit.joint.degrees_of_freedom
    # Four standard deviations of what noise leaves.
    assert chi2 < free + 4.0 * (2.0 * free) ** 0.5


def test_the_acceleration_by_a_hand_is_named_beside_a_poor_verdict():
    hand = imucal.Tumble(seed=1, poses=18, hold_s=3.0, tremor_deg=0.1)
    result = imucal.calibrate(imucal.simulate(hand, seed=1, rate_hz=100).recording)
    assert result.verdict == "good"
    for judged, is_named in ((result, False), (replace(result, verdict="poor"), True)):
        (note,) = [note for note in judged.notes if "hand-held with a tremor" in note]
        assert ("hold the unit against something rigid" in note) == is_named
