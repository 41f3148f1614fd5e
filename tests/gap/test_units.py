"""Variations in time that are deterministic or random, strong effects, and causes of moved biases.

The recordings come from `gap.unit_cases` of the benchmark, which shares no formula with the simulator.
"""

from __future__ import annotations

import re

import pytest

import imucal
from gap.unit_cases import SESSIONS, pose
from gap.units import asked, is_named, is_taken_away

# A search with given candidates looks for no laws, which these tests do not need.
CANDIDATES = ["gyro_g_sensitivity", "accel_scale_quadratic"]


@pytest.mark.parametrize(
    ("family", "kind", "pattern"),
    [
        ("gyroscope bias switches", "unknown", "switching"),
        ("accelerometer bias switches", "unknown", "switching"),
        ("gyroscope bias swings", "unknown", "time"),
        ("random walk of the gyroscope", "stochastic", "random_walk"),
        ("random walk of the accelerometer", "stochastic", "random_walk"),
    ],
)
def test_a_variation_in_time_is_random_only_if_its_increments_are(family, kind, pattern):
    run, control, truth = pose(family, 0)
    gap = imucal.find_gap(run, control=control, candidates=CANDIDATES)
    remainder = gap.remainder
    assert (gap.verdict, remainder.kind, remainder.pattern) == (kind, kind, pattern)
    assert remainder.block in truth.blocks
    assert (kind == "stochastic") == truth.is_random
    words = {"switching": "between two levels", "time": "smoothly with time"}
    assert words.get(pattern, "as a random walk in time") in gap.summary()


def test_a_gyroscope_that_is_louder_in_moves_is_said_to_be_that():
    run, control, truth = pose("gyroscope louder in moves", 0)
    gap = imucal.find_gap(run, control=control, candidates=CANDIDATES)
    assert truth.blocks == ("noise",)
    assert gap.verdict == "data_fault", gap.summary()
    assert [effect["name"] for effect in gap.effects] == ["noise_grows_in_motion"]


@pytest.mark.slow
@pytest.mark.parametrize("family", ["lever arm of 0.3 m", "gyroscope cubic", "gyroscope quadratic", "delay"])
def test_a_strong_effect_is_named_and_taken_away(family):
    row = asked((family, 0))
    assert is_named(row) and is_taken_away(row), row
    assert not row["asks_for_more"]


def test_a_low_pass_filter_is_no_delay():
    run, control, _ = pose("low pass", 0)
    gap = imucal.find_gap(run, control=control, candidates=["gyro_time_offset"])
    assert (gap.verdict, list(gap.effects)) == ("unknown", [])
    found = re.search(r"low-pass filter with the time constant ([\d.]+) ms", gap.summary())
    assert found is not None
    # The benchmark draws time constants between 12 and 20 ms. The delay gives the same time constant.
    delay = re.search(r"late by ([\d.]+) ms on average", gap.summary())
    assert delay is not None
    assert 12.0 < float(delay[1]) < 20.0
    assert float(found[1]) == pytest.approx(float(delay[1]), rel=0.15)


@pytest.mark.parametrize("family", SESSIONS)
def test_the_cause_of_moved_biases_is_the_temperature_or_a_switch_on(family):
    run, control, truth = pose(family, 0)
    gap = imucal.find_gap(run, control=control, candidates=CANDIDATES)
    session = gap.to_dict()["remainder"]["session"]
    assert gap.verdict == "unknown"
    assert session["cause"] == ("temperature" if truth.blocks == ("temperature",) else "switch_on")
