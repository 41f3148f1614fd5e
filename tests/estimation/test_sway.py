"""Standard deviations of a hand-held unit that sways during its rests, or whose sensors are filtered."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import imucal


def swaying(recording: imucal.Recording, std_mps2: float, band_hz: tuple[float, float], seed: int):
    """The recording with added accelerations in a band of frequencies; `std_mps2` is for each axis."""
    generator = np.random.default_rng(seed)
    waves = 30
    sway = np.zeros_like(recording.specific_force)
    for _ in range(waves):
        hz, phase = generator.uniform(*band_hz, 3), generator.uniform(0.0, 2 * np.pi, 3)
        sway += np.sin(2 * np.pi * hz * recording.time_s[:, None] + phase)
    force = recording.specific_force + sway * std_mps2 / np.sqrt(waves / 2)
    return dataclasses.replace(recording, specific_force=force)


def deviations(change: Callable[[imucal.Recording, int], imucal.Recording], hold_s: float) -> np.ndarray:
    """Errors of all parameters in units of their standard deviations, for ten units in a hand with tremor."""
    values = []
    for seed in range(1, 11):
        unit = imucal.Unit.random("paper", seed)
        motion = imucal.Tumble(seed=seed, poses=15, hold_s=hold_s, tremor_deg=0.2, translation_mm=0.0)
        run = imucal.simulate(motion, unit=unit, seed=seed, rate_hz=100.0)
        result = imucal.calibrate(change(run.recording, seed))
        truth = run.truth.calibration
        assert result.verdict in ("good", "incomplete")
        values += [
            (one.value - true.value) / one.std
            for one, true in zip(result.calibration.parameters, truth.parameters, strict=True)
            if one.std
        ]
    return np.array(values)


@pytest.mark.parametrize("hold_s", [2.0, 3.0, 6.0])
@pytest.mark.parametrize(
    ("std_mps2", "band_hz"), [(0.01, (0.3, 3.0)), (0.03, (0.3, 3.0)), (0.03, (0.3, 1.0))]
)
def test_standard_deviations_contain_the_sway_of_a_hand(std_mps2, band_hz, hold_s):
    """With the noise of the sensors alone, single parameters are wrong by up to seven standard deviations."""
    errors = deviations(lambda recording, seed: swaying(recording, std_mps2, band_hz, seed), hold_s)
    rms = np.sqrt(np.mean(errors**2))
    worst = np.abs(errors).max()
    assert 0.6 < rms < 1.2 and worst < 4.5, (rms, worst)


def filtered(recording: imucal.Recording, pole: float):
    """The recording with both sensors behind two equal low-pass filters of first order in series."""

    def filter_axes(rows: np.ndarray) -> np.ndarray:
        for _ in range(2):
            rows, state = np.array(rows), rows[0]
            for row in rows:
                state = pole * state + (1.0 - pole) * row
                row[:] = state
        return rows

    return dataclasses.replace(
        recording,
        specific_force=filter_axes(recording.specific_force),
        angular_rate=filter_axes(recording.angular_rate),
    )


def test_standard_deviations_contain_the_noise_below_the_corner_of_a_filter():
    """With the noise of the fourth differences, accelerometer errors are twice the standard deviations."""
    corner_hz, rate_hz = 20.0, 100.0
    pole = np.exp(-2 * np.pi * corner_hz / rate_hz)
    errors = deviations(lambda recording, _: filtered(recording, pole), 3.0)
    rms = np.sqrt(np.mean(errors**2))
    worst = np.abs(errors).max()
    assert 0.6 < rms < 1.3 and worst < 4.5, (rms, worst)
