"""Instants of reported positions."""

import math

import numpy as np
import pytest

from imucal.stand.grbl_times import Instants, one_way_s

RATE_DPS = 45.0


def errors_s(late_s, *, rate_dps=RATE_DPS, commanded_dps=RATE_DPS):
    """Errors of the instants of positions at a constant rate, whose reports are late by these times."""
    at_s = np.arange(len(late_s)) * 0.04
    instants, settled = Instants(), []
    for true_s, late in zip(at_s.tolist(), late_s.tolist(), strict=True):
        instants.add(true_s + late, (rate_dps * true_s, 0.0, 0.0), commanded_dps)
        settled += instants.settled(true_s + late)
    settled += instants.settled(math.inf)
    return np.array([position[0] for position in settled]) - at_s


def test_the_characters_of_a_report_take_their_time():
    up_s, down_s = one_way_s(0.02, 64, 115200)
    assert math.isclose(down_s - up_s, 640 / 115200) and math.isclose(up_s + down_s, 0.02)
    # A port of USB has no baud rate.
    assert one_way_s(0.002, 64, 115200) == (0.001, 0.001)


def test_one_prompt_report_decides_about_late_ones_before_it():
    random = np.random.default_rng(5)
    late_s = random.uniform(0.0, 0.03, 200)
    late_s[random.uniform(size=200) < 0.3] = 0.0
    late_s[-1] = 0.0
    assert np.abs(errors_s(late_s)).max() < 1e-9
    # At rest nothing is known, and nothing is needed.
    assert np.abs(errors_s(late_s, rate_dps=0.0)).max() > 0.02


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_an_override_of_the_feed_does_not_shift_instants(times):
    assert np.abs(errors_s(np.zeros(100), rate_dps=times * RATE_DPS)).max() <= 0.05


def test_positions_wait_for_half_a_second():
    instants = Instants()
    for number in range(20):
        instants.add(number * 0.1, (0.0, 0.0, 0.0), RATE_DPS)
    assert len(instants.settled(1.92)) == 15
    assert len(instants.settled(math.inf)) == 5
    assert instants.settled(math.inf) == []
