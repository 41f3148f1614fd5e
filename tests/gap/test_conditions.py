"""What a search makes of the conditions that a user finds at home: a hand, a warm room, a long lever arm."""

import dataclasses

import numpy as np
import pytest

import imucal
from imucal import Tumble, find_gap, simulate

pytestmark = pytest.mark.slow


def by_hand(seed, translation_mm, unit="bmi088", **arguments):
    motion = Tumble(seed=seed, poses=20, hold_s=3.0, tremor_deg=0.1, translation_mm=translation_mm)
    return simulate(motion, seed=seed, unit=unit, rate_hz=100.0, **arguments).recording


def on_a_stand(seed, **arguments):
    recording = simulate("random", seed=seed, **arguments).recording
    return dataclasses.replace(recording, stand_rad=None)


@pytest.mark.parametrize(
    ("unit", "translation_mm"), [("bmi088", 20.0), ("bmi088", 100.0), ("mpu6050", 100.0)]
)
def test_a_hand_that_carries_the_unit_a_little_is_no_effect(unit, translation_mm):
    gap = find_gap(by_hand(1, translation_mm, unit), control=by_hand(2, translation_mm, unit))
    assert gap.verdict == "nothing_missing", gap.summary()
    assert "translated during the moves" in gap.summary()


def test_a_nonlinear_converter_of_the_gyroscope_is_no_hand():
    """A triangular error of 0.35 deg/s with a period of 65 deg/s, which no effect describes."""
    period_radps, peak_radps = np.deg2rad([65.0, 0.35])

    def run(seed):
        recording = on_a_stand(seed, rate_hz=100.0)
        phase = 2.0 * np.pi * recording.angular_rate / period_radps + [0.5, 1.5, 2.5]
        wave = peak_radps * 2.0 / np.pi * np.arcsin(np.sin(phase))
        return dataclasses.replace(recording, angular_rate=recording.angular_rate + wave)

    gap = find_gap(run(51), control=run(52))
    assert not gap.is_hand_moved, gap.summary()
    assert gap.verdict == "unknown", gap.summary()
    assert [law.sensor for law in gap.laws] == ["gyroscope"], gap.summary()


def test_a_stand_that_shakes_is_no_hand():
    shaking = imucal.Stand(vibration_deg=0.01, vibration_mm=0.02, vibration_hz=37.0)
    measured, control = (on_a_stand(seed, rate_hz=100.0, stand=shaking) for seed in (11, 12))
    gap = find_gap(measured, control=control)
    assert gap.verdict == "nothing_missing", gap.summary()
    assert "accel_lever_arm" not in {row["name"] for row in gap.not_observable}


def test_what_a_hand_hides_is_not_estimated():
    recording = by_hand(1, 100.0)
    with pytest.raises(imucal.NotEnoughMotionError, match="accel_lever_arm is not observable: use a stand"):
        imucal.calibrate(recording, effects=["accel_lever_arm"])


@pytest.mark.parametrize(("degc", "noise_k"), [(30.0, 0.0), (40.0, 0.1)])
def test_a_temperature_that_stays_is_no_effect(degc, noise_k):
    random = np.random.default_rng(5)

    def run(seed):
        recording = on_a_stand(seed, rate_hz=100.0)
        noise = noise_k * random.standard_normal(len(recording))
        return dataclasses.replace(recording, temperature_degc=degc + noise)

    gap = find_gap(run(21), control=run(22))
    assert gap.verdict == "nothing_missing", gap.summary()
    needs = {row["name"]: row["needs"] for row in gap.not_observable}
    assert "changes by 0.5 K or more" in needs["accel_scale_temperature"]


def test_an_effect_of_a_small_change_in_a_warm_room_is_named_as_at_the_reference():
    def run(seed, room_degc):
        effects = {"gyro_bias_temperature": [2e-4, -3e-4, 1e-4]}
        time_s = np.arange(0.0, 400.0, 10.0)
        cycle = imucal.Temperature(time_s, room_degc + 2.0 * np.sin(time_s / 30.0))
        return on_a_stand(seed, rate_hz=100.0, temperature=cycle, effects=effects)

    for room_degc in (25.0, 60.0):
        gap = find_gap(run(31, room_degc), control=run(32, room_degc))
        assert [effect["name"] for effect in gap.effects] == ["gyro_bias_temperature"], gap.summary()


SIX_CM, SIXTEEN_CM = [0.06, 0.05, -0.04], [0.16, -0.112, 0.16]


@pytest.mark.parametrize(
    ("lever_arm_m", "rate_hz", "unit"),
    [
        (SIX_CM, 100.0, "paper"),
        (SIX_CM, 400.0, "paper"),
        (SIX_CM, 400.0, "bmi088"),
        (SIXTEEN_CM, 37.0, "paper"),
        (SIXTEEN_CM, 100.0, "paper"),
        (SIXTEEN_CM, 400.0, "bmi088"),
    ],
)
def test_a_long_lever_arm_is_named_whatever_the_noise_of_the_gyroscope(lever_arm_m, rate_hz, unit):
    runs = [
        on_a_stand(seed, rate_hz=rate_hz, unit=unit, effects={"accel_lever_arm": lever_arm_m})
        for seed in (31, 32)
    ]
    gap = find_gap(runs[0], control=runs[1])
    assert gap.verdict == "named", gap.summary()
    (effect,) = gap.effects
    off = [
        (p["value"] - truth) / p["std"] for p, truth in zip(effect["parameters"], lever_arm_m, strict=True)
    ]
    assert np.abs(off).max() < 4.0, off


def test_taking_a_lever_arm_away_adds_little_noise_to_the_force():
    recording = on_a_stand(3, rate_hz=400.0)
    lever_arm = imucal.EffectValues("accel_lever_arm", [0.06, 0.05, -0.04])
    calibrated = imucal.calibrate(recording)
    unit = dataclasses.replace(calibrated.calibration, effects=(lever_arm,))

    def noise(force):
        """Standard deviation within the rests; their first and last 50 ms may belong to the moves."""
        rests = [force[rest.first + 20 : rest.end - 20] for rest in calibrated.rests]
        return np.sqrt(np.mean([rest.var(axis=0) for rest in rests], axis=0))

    before, after = (noise(made.specific_force) for made in (recording, unit.apply_recording(recording)))
    assert (after < 1.5 * before).all(), (before, after)
