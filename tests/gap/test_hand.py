"""Units that a hand turns, and that it moves sideways by a little, by more, or not at all."""

import dataclasses

import numpy as np
import pytest

import imucal

pytestmark = pytest.mark.slow

G_SENSITIVITY = np.radians([0.05, 0.0, 0.0, 0.0, -0.03, 0.0, 0.0, 0.0, 0.04]) / 9.80665


def by_hand(seed: int, translation_mm: float, **arguments: object) -> imucal.Recording:
    motion = imucal.Tumble(seed, translation_mm=translation_mm)
    return imucal.simulate(motion, seed=seed, rate_hz=100.0, **arguments).recording


@pytest.mark.parametrize("translation_mm", [0.0, 5.0, 10.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_hand_that_also_translates_a_unit_is_no_effect(seed: int, translation_mm: float):
    gap = imucal.find_gap(by_hand(seed, translation_mm), control=by_hand(100 + seed, translation_mm))
    assert gap.verdict == "nothing_missing", gap.summary()
    assert gap.is_hand_moved == (translation_mm > 0.0)


@pytest.mark.parametrize("translation_mm", [5.0, 20.0])
def test_an_effect_is_named_beside_a_hand_and_nothing_else(translation_mm: float):
    effects = {"gyro_g_sensitivity": G_SENSITIVITY}
    measured, control = (by_hand(seed, translation_mm, effects=effects) for seed in (4, 104))
    gap = imucal.find_gap(measured, control=control)
    assert [effect["name"] for effect in gap.effects] == ["gyro_g_sensitivity"], gap.summary()
    assert gap.remainder.kind == "nothing", gap.summary()


def test_a_short_lever_arm_that_is_no_candidate_is_not_taken_for_a_hand():
    program = imucal.Program.random(seed=5)
    run = imucal.simulate(
        program, seed=5, rate_hz=100.0, effects={"accel_lever_arm": [0.003, -0.002, 0.0025]}
    )
    recording = dataclasses.replace(run.recording, stand_rad=None)
    gap = imucal.find_gap(recording, candidates=("gyro_g_sensitivity", "accel_scale_quadratic"))
    assert gap.verdict == "unknown", gap.summary()
    assert not gap.is_hand_moved
    assert (gap.remainder.block, gap.remainder.pattern) == ("accel_bias", "rate")
