"""Covariances of the two-stage fit and of an accelerometer against errors propagated through the data.

Each independent error of docs/model.md (9) is added to the recording with its standard deviation, and the
recording is calibrated again. The sum of the outer products of the changes is the covariance.
"""

import numpy as np
import pytest

import imucal
from exact_covariance import covariance_of_norms, normalised, variance_of_white_noise


def values(result):
    return np.array([parameter.value for parameter in result.parameters])


@pytest.fixture(scope="module")
def recording():
    """A run in which noise explains all residuals, so no standard deviation is multiplied by a factor."""
    program = imucal.Program.random(seed=89, moves=24, hold_s=3.0)
    return imucal.simulate(program, unit="paper", rate_hz=40.0, seed=89).recording


def test_the_two_stage_fit_propagates_all_errors(recording):
    result = imucal.calibrate(recording, joint=False)
    assert (result.fit.accelerometer.inflation, result.fit.gyroscope.inflation) == (1.0, 1.0)
    time_s, rests = recording.time_s, [slice(rest.first, rest.end) for rest in result.rests]
    count = np.array([[rest.stop - rest.start] for rest in rests])
    force_variance = variance_of_white_noise(recording.specific_force, time_s, rests) / count
    rate_variance = variance_of_white_noise(recording.angular_rate, time_s, rests)
    # The mean rates scatter by less than their noise on each axis, so there is no variance between rests.
    mean_rates = np.array([recording.angular_rate[rest].mean(axis=0) for rest in rests])
    weights = count / rate_variance
    deviations = mean_rates - np.average(mean_rates, axis=0, weights=weights)
    assert ((weights * deviations**2).sum(axis=0) < len(rests) - 1).all()

    def change(channel, rows, error):
        columns = {name: getattr(recording, name).copy() for name in ("specific_force", "angular_rate")}
        columns[channel][rows] += error
        return values(imucal.calibrate(imucal.Recording(time_s, **columns), joint=False)) - values(result)

    step_s = np.median(np.diff(time_s))
    density = np.median(rate_variance, axis=0) * step_s
    changes = [
        change(channel, rest, sigma * axis)
        for channel, variances in (
            ("specific_force", force_variance),
            ("angular_rate", rate_variance / count),
        )
        for rest, variance in zip(rests, variances, strict=True)
        for sigma, axis in zip(np.sqrt(variance), np.eye(3), strict=True)
    ]
    # A rotation of one sample in the move, with the random walk of the whole move, equal about all axes.
    changes += [
        change("angular_rate", move.last - 3, np.sqrt(density.mean() * move.duration_s) / step_s * axis)
        for move in result.moves
        for axis in np.eye(3)
    ]
    covariance = result.calibration.covariance
    # The errors are not infinitesimal, and a fit ends within a few per cent of a standard deviation.
    assert normalised(np.transpose(changes) @ changes, covariance) == pytest.approx(
        normalised(covariance, covariance), abs=0.04
    )


def test_an_accelerometer_alone_has_the_errors_of_its_norms(recording):
    result = imucal.calibrate(recording.of_sensor("accelerometer"))
    assert result.fit.accelerometer.inflation == 1.0
    rests = [slice(rest.first, rest.end) for rest in result.rests]
    force = np.array([recording.specific_force[rest].mean(axis=0) for rest in rests])
    variance = variance_of_white_noise(recording.specific_force, recording.time_s, rests)
    count = [[rest.stop - rest.start] for rest in rests]
    expected = covariance_of_norms(force, variance / count, result.calibration.accelerometer)
    covariance = result.calibration.covariance
    assert normalised(covariance, expected) == pytest.approx(normalised(expected, expected), abs=1e-3)
