"""Instants of reported positions from the bounds of query and arrival."""

import math

import numpy as np

from imucal.stand.grbl_times import Instants, one_way_s

RATE_DPS = 45.0


def test_positions_whose_instant_stays_uncertain_are_left_out():
    instants = Instants()
    # From rest to rest, with one report on the way that is late by 60 ms: 1.35 deg at 45 deg/s.
    for asked_s, late_s, angle in ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.06, 5.0), (1.0, 0.0, 20.0)):
        instants.add(asked_s, asked_s + late_s, (angle, 0.0, 0.0), RATE_DPS)
    assert [angle for _, angle, *_ in instants.settled(math.inf)] == [0.0, 0.0, 20.0]
    # A late report of a stand at rest is as good as any.
    for asked_s in (2.0, 2.1, 2.2):
        instants.add(asked_s, asked_s + 0.06, (20.0, 0.0, 0.0), RATE_DPS)
    assert len(instants.settled(math.inf)) == 3


def run(delays, *, up_s=0.005, down_s=0.01, rate_dps=RATE_DPS, commanded_dps=RATE_DPS, every_s=0.04):
    """Errors of the instants, s, of positions at a constant rate; delays before and after each, s."""
    instants, true_s = Instants(), []
    settled = []
    for number, (before_s, after_s) in enumerate(delays):
        asked_s = number * every_s
        at_s = asked_s + up_s + before_s
        arrived_s = at_s + after_s + down_s
        instants.add(asked_s + up_s, arrived_s - down_s, (rate_dps * at_s, 0.0, 0.0), commanded_dps)
        true_s.append(at_s)
        settled += instants.settled(arrived_s)
    settled += instants.settled(math.inf)
    assert len(settled) == len(delays)
    return np.array([at[0] for at in settled]) - true_s


def test_the_characters_of_a_report_take_their_time():
    up_s, down_s = one_way_s(0.02, 64, 115200)
    assert math.isclose(down_s - up_s, 640 / 115200) and math.isclose(up_s + down_s, 0.02)
    # A port of USB has no baud rate.
    assert one_way_s(0.002, 64, 115200) == (0.001, 0.001)


def test_prompt_reports_decide_about_late_ones_whichever_way_was_late():
    random = np.random.default_rng(5)
    late = random.uniform(0.0, 0.025, 200)
    prompt = random.uniform(size=200) < 0.2
    late[prompt] = 0.0
    none = np.zeros(200)
    for delays in (np.column_stack([late, none]), np.column_stack([none, late])):
        alone = np.abs(run(delays, rate_dps=0.0)).max()
        error = np.abs(run(delays)).max()
        assert alone > 0.012 and error < 0.001, (alone, error)


def test_motors_that_exceed_the_commanded_rate_do_not_shift_instants():
    # An override of the feed to 200 %: the bounds would contradict each other.
    error = run(np.zeros((200, 2)), rate_dps=2 * RATE_DPS)
    assert np.abs(error).max() < 0.011


def test_positions_wait_for_half_a_second():
    instants = Instants()
    for number in range(20):
        instants.add(number * 0.1, number * 0.1 + 0.01, (0.0, 0.0, 0.0), RATE_DPS)
    assert len(instants.settled(1.915)) == 15
    assert len(instants.settled(math.inf)) == 5
    assert instants.settled(math.inf) == []
