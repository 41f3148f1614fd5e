"""Figures, standard deviations and bands of noise against the likelihood of one cosine transform in SciPy.

The transform is that of docs/model.md (31). A record of fewer than 2048 samples has one window.
"""

import numpy as np
import pytest
from scipy.fft import dct
from scipy.linalg import toeplitz
from scipy.optimize import minimize

import imucal

SAMPLES, RATE_HZ = 2000, 10.0
KINDS = ("noise_density", "bias_instability", "random_walk")
# Figure of a process whose samples have the parameter theta = 1.
UNITS = np.array([RATE_HZ**-0.5, 1.0, RATE_HZ**0.5])
# 95 % quantile of chi-square with one degree of freedom.
BAND = 3.841


@pytest.fixture(scope="module")
def recording():
    """A unit at rest, in whose noise all three processes are significant on each axis of the gyroscope."""
    sensor = imucal.Sensor(noise_density=1e-3, bias_instability=2e-3, random_walk=np.full(3, 1e-3))
    motion = imucal.Static(SAMPLES / RATE_HZ)
    return imucal.simulate(motion, unit=imucal.Unit(sensor, sensor), rate_hz=RATE_HZ, seed=1).recording


@pytest.fixture(scope="module")
def found(recording):
    found = imucal.noise(recording)
    assert found.samples == len(recording) == SAMPLES
    return found


@pytest.fixture(scope="module")
def powers():
    """Expected power of each cosine for theta = 1, from the variogram of each process."""
    lag = np.arange(SAMPLES)
    odd = np.concatenate([[0.0], np.cumsum(1.0 / (2.0 * lag[1:] - 1.0))])
    covariances = (np.where(lag == 0, 1.0, 0.0), -2.0 / np.pi * odd, -lag / 2.0)
    return np.array(
        [
            dct(dct(toeplitz(of_lag), axis=0, norm="ortho"), axis=1, norm="ortho").diagonal()[1:]
            for of_lag in covariances
        ]
    )


@pytest.mark.parametrize("axis", range(3))
def test_figures_and_their_uncertainties_are_those_of_the_likelihood(axis, recording, found, powers):
    noise = found.triad("gyro")[axis]
    figures = [getattr(noise, kind) for kind in KINDS]
    value, std = np.array([(figure.value, figure.std) for figure in figures]).T
    squares = dct(recording.angular_rate[:, axis], norm="ortho")[1:] ** 2

    def deviance(logarithms):
        expected = np.exp(logarithms) @ powers
        return np.sum(np.log(expected) + squares / expected)

    theta = (value / UNITS) ** 2
    best = minimize(deviance, np.log(theta), method="BFGS")
    # The library averages the powers over bands of 3 % of the frequency.
    assert UNITS * np.exp(best.x / 2.0) / std == pytest.approx(value / std, abs=0.03)

    # Fisher information of the logarithms of theta. A figure is proportional to the root of theta.
    share = theta[:, None] * powers / (theta @ powers)
    of_logarithms = np.linalg.inv(share @ share.T / 2.0)
    assert value / 2.0 * np.sqrt(of_logarithms.diagonal()) == pytest.approx(std, rel=1e-3)

    for kind, figure in enumerate(figures):
        for end in (figure.low, figure.high):
            at_end = 2.0 * np.log(end / UNITS[kind])

            def of_others(others, kind=kind, at_end=at_end):
                return deviance(np.insert(others, kind, at_end))

            others = minimize(of_others, np.delete(best.x, kind), method="BFGS")
            # The excess is 10 % larger at the ends of a band that is wider by 5 %.
            assert others.fun - best.fun == pytest.approx(BAND, rel=0.03)
