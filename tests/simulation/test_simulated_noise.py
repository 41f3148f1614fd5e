"""The random errors of simulated sensors, judged by the Allan deviation of another program: allantools."""

import allantools
import numpy as np
import pytest
from numpy.typing import NDArray

import imucal

pytestmark = pytest.mark.slow

SEED = 20
RATE_HZ = 100.0
DURATION_S = 4 * 3600.0
# Of two-sided intervals; about a hundred are looked at for each kind of noise.
CONFIDENCE = 0.9999

# Per figure, accelerometer (m/s^2) and gyroscope (rad/s).
DENSITY = (1e-3, 1e-4)
INSTABILITY = (4e-4, 3e-5)
WALK = (np.array([1e-5, 2e-5, 4e-5]), np.array([1e-6, 2e-6, 3e-6]))
FLOOR = np.sqrt(2.0 * np.log(2.0) / np.pi)  # 0.664

# Exponent of the power density by frequency, by which allantools knows the kind of noise.
WHITE, FLICKER, RANDOM_WALK = 0, -1, -2


def run(density: bool = False, instability: bool = False, walk: bool = False) -> list[NDArray[np.float64]]:
    """Readings of both sensors of a unit at rest, less what they are of."""
    sensors = [
        imucal.Sensor(
            noise_density=DENSITY[k] * density,
            bias_instability=INSTABILITY[k] * instability,
            random_walk=WALK[k] * walk,
        )
        for k in range(2)
    ]
    simulation = imucal.simulate(
        imucal.Static(DURATION_S), unit=imucal.Unit(*sensors), rate_hz=RATE_HZ, seed=SEED
    )
    recording, truth = simulation.recording, simulation.truth
    return [
        recording.specific_force - truth.specific_force,
        recording.angular_rate - truth.angular_rate,
    ]


def check(noise: NDArray[np.float64], kind: int, expected, from_s: float) -> None:
    """Every Allan deviation is what it should be within its confidence interval."""
    wanted_s = from_s * 2.0 ** np.arange(np.log2(DURATION_S / 10 / from_s))
    tau_s, deviations, _, _ = allantools.oadev(noise, rate=RATE_HZ, data_type="freq", taus=wanted_s)
    for tau, deviation in zip(tau_s, deviations, strict=True):
        freedom = allantools.edf_greenhall(
            alpha=kind, d=2, m=round(tau * RATE_HZ), N=len(noise) + 1, overlapping=True, modified=False
        )
        low, high = allantools.confidence_interval(deviation, freedom, ci=CONFIDENCE)
        assert low < expected(tau) < high, f"{tau} s: {deviation}, not {expected(tau)}: {low} to {high}"
    assert len(tau_s) >= 7


def white(sensor: int, tau_s: float) -> float:
    return DENSITY[sensor] / np.sqrt(tau_s)


def floor(sensor: int) -> float:
    return FLOOR * INSTABILITY[sensor]


def walk(sensor: int, axis: int, tau_s: float) -> float:
    return WALK[sensor][axis] * np.sqrt(tau_s / 3.0)


CHANNELS = [(sensor, axis) for sensor in range(2) for axis in range(3)]


@pytest.fixture(scope="module")
def of_all_kinds() -> list[NDArray[np.float64]]:
    return run(density=True, instability=True, walk=True)


def test_white_noise_has_its_density() -> None:
    noise = run(density=True)
    for sensor, axis in CHANNELS:
        check(noise[sensor][:, axis], WHITE, lambda tau_s, k=sensor: white(k, tau_s), 1 / RATE_HZ)


def test_bias_instability_has_its_floor() -> None:
    noise = run(instability=True)
    for sensor, axis in CHANNELS:
        check(noise[sensor][:, axis], FLICKER, lambda _, k=sensor: floor(k), 32 / RATE_HZ)


def test_random_walk_has_its_slope() -> None:
    noise = run(walk=True)
    for sensor, axis in CHANNELS:
        check(
            noise[sensor][:, axis],
            RANDOM_WALK,
            lambda tau_s, k=sensor, a=axis: walk(k, a, tau_s),
            32 / RATE_HZ,
        )


def test_the_kinds_add_up(of_all_kinds: list[NDArray[np.float64]]) -> None:
    for sensor, axis in CHANNELS:

        def expected(tau_s: float, k: int = sensor, a: int = axis) -> float:
            return np.sqrt(white(k, tau_s) ** 2 + floor(k) ** 2 + walk(k, a, tau_s) ** 2)

        # The interval of the kind that has the widest ones.
        check(of_all_kinds[sensor][:, axis], RANDOM_WALK, expected, 32 / RATE_HZ)


def test_channels_are_independent(of_all_kinds: list[NDArray[np.float64]]) -> None:
    # Of differences over 10 s, in which nothing is slow.
    means = np.hstack(of_all_kinds).reshape(-1, 1000, 6).mean(axis=1)
    correlation = np.corrcoef(np.diff(means, axis=0), rowvar=False)
    assert np.max(np.abs(correlation - np.eye(6))) < 5.0 / np.sqrt(len(means))
