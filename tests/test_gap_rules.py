"""Faults of the data that only the fit shows, and what must not be taken for them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import imucal
from imucal.unit import unit_of

RUN_SEED = 21
FIRM = imucal.Stand(
    mount_rotation_deg=(0.8, -1.1, 0.6),
    base_tilt_deg=(0.4, -0.3),
    non_orthogonality_deg=(0.3, -0.4),
    encoder_noise_deg=0.005,
)


def run(**arguments):
    return imucal.simulate("random", seed=RUN_SEED, rate_hz=100.0, **arguments).recording


def without_encoders(recording):
    return dataclasses.replace(recording, stand_rad=None)


def faults(recording, **arguments):
    gap = imucal.find_gap(recording, **arguments)
    assert gap.verdict == "data_fault", gap.summary()
    for name in (effect["name"] for effect in gap.effects):
        assert f"[{name}]" in gap.summary()
    return {finding.code: finding.value for finding in gap.findings}


def test_a_unit_that_slips_on_its_mount():
    slip_deg = 1.5
    said = faults(run(stand=FIRM, effects={"mount_slip": np.radians(slip_deg)}))
    assert said == {"mount_slip": pytest.approx(slip_deg, abs=0.05)}


@pytest.mark.parametrize(
    "effects",
    [
        {"encoder_eccentricity": 1e-3},
        {"encoder_backlash": 1e-3},
        {"accel_bias_drift": 5e-4},
        [imucal.EffectValues("accel_bias_warmup", [0.1, -0.1, 0.1], shape=30.0)],
    ],
)
def test_an_effect_is_no_slip(effects):
    gap = imucal.find_gap(run(stand=FIRM, effects=effects))
    assert gap.verdict != "data_fault", gap.summary()


def test_a_hand_that_trembles_is_no_fault():
    hand = imucal.Tumble(RUN_SEED, translation_mm=0.0)
    shaken = imucal.simulate(hand, seed=RUN_SEED, rate_hz=100.0, effects={"rest_not_still": 2e-3}).recording
    assert imucal.find_gap(shaken).verdict == "nothing_missing"


def test_time_stamps_that_are_not_those_of_the_samples():
    even = without_encoders(run())
    # Stamps of a busy computer, in order.
    jitter_s = np.random.default_rng(RUN_SEED).normal(scale=1.5e-3, size=len(even.time_s))
    time_s = np.maximum.accumulate(even.time_s + jitter_s) + 1e-7 * np.arange(len(jitter_s))
    said = faults(dataclasses.replace(even, time_s=time_s))
    assert said["clock_irregular"] == pytest.approx(1.5, rel=0.1)
    # Stamps that are rounded to a millisecond do no harm.
    rounded = dataclasses.replace(even, time_s=np.round(even.time_s * 1.0071, 3))
    assert imucal.find_gap(rounded).verdict == "nothing_missing"


def test_samples_that_are_not_at_their_time_stamps():
    said = faults(without_encoders(run(effects={"clock_irregular": 2.5e-3})))
    assert said == {"clock_irregular": pytest.approx(2.5, rel=0.2)}


def test_noise_that_is_louder_in_moves():
    unit = unit_of("paper")
    loud = dataclasses.replace(
        unit,
        accelerometer=dataclasses.replace(unit.accelerometer, noise_in_motion=2.0),
        gyroscope=dataclasses.replace(unit.gyroscope, noise_in_motion=2.0),
    )
    said = faults(without_encoders(run(unit=loud)))
    assert said == {"noise_grows_in_motion": pytest.approx(2.0, rel=0.1)}
