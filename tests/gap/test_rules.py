"""Faults of the data that only the fit shows, and what must not be taken for them.

`unit_of` is used, because the public API has no function that gives a unit by its name.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import imucal
from imucal.rig.unit import unit_of

pytestmark = pytest.mark.slow

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


@pytest.mark.parametrize("seed", [4, 9, 11, 14, 15])
def test_flicker_noise_is_no_function_of_time(seed):
    """Allan deviations that are flat at 3 deg/h and 20 ug, in the calibration and the control run."""
    floor = np.sqrt(2.0 * np.log(2.0) / np.pi)
    unit = unit_of("paper")
    unit = dataclasses.replace(
        unit,
        accelerometer=dataclasses.replace(unit.accelerometer, bias_instability=20e-6 * 9.80665 / floor),
        gyroscope=dataclasses.replace(unit.gyroscope, bias_instability=np.radians(3.0 / 3600.0) / floor),
    )
    measured, control = (
        imucal.simulate(imucal.Program.random(seed=own), seed=own, unit=unit, rate_hz=100.0).recording
        for own in (seed, 1000 + seed)
    )
    gap = imucal.find_gap(measured, control=control)
    assert gap.verdict in ("nothing_missing", "stochastic"), gap.summary()
    assert "accel_bias_drift" in [score["name"] for score in gap.ranking]


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


def test_noise_in_moves_does_not_explain_a_scale_that_varies():
    unit = unit_of("paper")
    louder = dataclasses.replace(unit.gyroscope, noise_in_motion=1.5)
    unit = dataclasses.replace(unit, gyroscope=louder)
    others = ("gyro_g_sensitivity", "gyro_scale_quadratic")
    assert faults(without_encoders(run(unit=unit)), candidates=others).keys() == {"noise_grows_in_motion"}
    varies = run(unit=unit, effects={"gyro_scale_drift": 2e-5})
    gap = imucal.find_gap(without_encoders(varies), candidates=others)
    assert gap.verdict != "data_fault", gap.summary()
    assert gap.remainder.block == "gyro_scale"


@pytest.mark.parametrize("zero_rad", [0.004, -0.02])
def test_a_zero_error_of_the_second_motor_is_no_effect(zero_rad):
    recording = run(stand=FIRM)
    shifted = dataclasses.replace(recording, stand_rad=recording.stand_rad + np.array([0.0, zero_rad, 0.0]))
    gap = imucal.find_gap(shifted)
    assert gap.verdict == "nothing_missing", gap.summary()


@pytest.mark.parametrize(
    ("code", "value"),
    [
        ("clock_irregular", 2.5e-3),
        ("clock_irregular", 6e-3),
        ("noise_grows_in_motion", 2.0),
        ("noise_grows_in_motion", 4.0),
    ],
)
def test_a_fault_beside_an_effect_is_said(code, value):
    effects = {"gyro_g_sensitivity": np.radians(0.05) / 9.80665, code: value}
    gap = imucal.find_gap(without_encoders(run(effects=effects)))
    assert [effect["name"] for effect in gap.effects] == ["gyro_g_sensitivity"], gap.summary()
    assert (gap.remainder.kind, gap.remainder.pattern) == ("unknown", code)
    assert gap.remainder.matters
    assert code in [finding.code for finding in gap.findings]


def test_saturated_samples_that_are_excluded_are_no_fault_of_the_search():
    recording = without_encoders(run(effects={"gyro_saturation": np.radians(110.0)}))
    assert imucal.find_gap(recording).verdict == "data_fault"
    gap = imucal.find_gap(recording, exclude_saturated=True)
    assert gap.verdict == "nothing_missing", gap.summary()


def test_a_scale_that_drifts_without_a_name_is_smooth():
    recording = without_encoders(run())
    scale = 1.0 + np.outer(recording.time_s, [2e-5, -1e-5, 1.5e-5])
    gap = imucal.find_gap(dataclasses.replace(recording, specific_force=recording.specific_force * scale))
    assert (gap.verdict, gap.remainder.pattern) == ("unknown", "time"), gap.summary()


def test_samples_that_jump_in_moves_are_no_noise_of_moves():
    recording = without_encoders(run())
    random = np.random.default_rng(RUN_SEED)
    moving = np.linalg.norm(recording.angular_rate, axis=1) > np.radians(5.0)
    jumps = moving & (random.uniform(size=len(moving)) < 3e-3)
    noise = unit_of("paper").gyroscope.noise_density * 10.0
    rate = recording.angular_rate + jumps[:, None] * random.normal(scale=20.0 * noise, size=(len(moving), 3))
    gap = imucal.find_gap(dataclasses.replace(recording, angular_rate=rate))
    assert gap.verdict == "nothing_missing", gap.summary()


def test_spoilt_samples_are_said_before_what_no_effect_explains():
    drift = {"accel_bias_drift": 5e-4}
    others = ("gyro_g_sensitivity", "gyro_scale_quadratic")
    unknown = imucal.find_gap(without_encoders(run(effects=drift)), candidates=others)
    # A drift is no random walk: the accelerometer's bias varies smoothly with time.
    assert unknown.verdict == "unknown", unknown.summary()
    spoilt = without_encoders(run(effects={**drift, "samples_duplicated": 0.005}))
    gap = imucal.find_gap(spoilt, candidates=others)
    assert [effect["name"] for effect in gap.effects] == ["samples_duplicated"], gap.summary()
    assert gap.verdict == "data_fault"


@pytest.mark.parametrize("backlash_deg", [0.02, 0.05, 0.2])
def test_backlash_is_named_though_each_motor_turns_back_at_one_sample(backlash_deg):
    signs = np.radians(backlash_deg) * np.array([1.0, -1.0, 1.0])
    effects = [imucal.EffectValues("encoder_backlash", signs)]
    gap = imucal.find_gap(run(stand=FIRM, effects=effects))
    assert [effect["name"] for effect in gap.effects] == ["encoder_backlash"], gap.summary()
    for parameter, sign in zip(gap.effects[0]["parameters"], signs, strict=True):
        assert abs(parameter["value"] - sign) < 4.0 * parameter["std"], gap.summary()


def test_what_angular_acceleration_does_to_the_gyroscope_shows_in_moves_by_hand():
    hand = imucal.Tumble(RUN_SEED, poses=46, hold_s=5.0, move_s=2.0)
    # Not a multiple of the identity: that is a delay, and no move from rest to rest shows it.
    lag = 7e-4 * np.array([[0.0, 1.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
    effects = [imucal.EffectValues("gyro_angular_acceleration", lag.ravel())]
    gap = imucal.find_gap(imucal.simulate(hand, seed=RUN_SEED, rate_hz=100.0, effects=effects).recording)
    assert [effect["name"] for effect in gap.effects] == ["gyro_angular_acceleration"], gap.summary()
    assert "gyro_time_offset" in {item["name"] for item in gap.not_observable}
