"""Known effects beside unknown and random ones, and sessions whose biases differ.

The recordings come from `gap.analytic` of the benchmark, which shares no formula with the simulator.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

import imucal
from gap import known
from gap.analytic import DEG, G, Sensors, heading, measured, random_motion, walk

SEED = 1


def pair(rate=lambda _: (), force=lambda _: (), *, step=None, temperatures=(None, None), seed=SEED):
    """Two recordings of one unit; `step` are the changes of both biases before the second one."""
    random = np.random.default_rng(seed)
    unit = Sensors.random(random)
    rate_error, force_error = (make(random) for make in (rate, force))
    runs = []
    for name, degc in zip(("run", "control"), temperatures, strict=True):
        if runs and step is not None:
            unit = Sensors(
                unit.force_matrix, unit.force_bias + step[0], unit.rate_matrix, unit.rate_bias + step[1]
            )
        runs.append(
            measured(
                unit,
                random_motion(random),
                random,
                rate_error=rate_error,
                force_error=force_error,
                temperature_degc=degc,
                name=name,
            )
        )
    return runs


def quadratic(_):
    """1 % per g."""
    return (lambda motion: 0.01 / G * np.array([1.0, -0.8, 0.6]) * motion.force**2,)


def names(gap):
    return [effect["name"] for effect in gap.effects]


@pytest.fixture(scope="module")
def beside_heading():
    run, control = pair(lambda random: (heading(random, 0.05 * DEG),), quadratic)
    return imucal.find_gap(run, control=control)


def test_a_known_effect_is_added_beside_an_unknown_one(beside_heading):
    gap = beside_heading
    assert (gap.verdict, names(gap)) == ("named", ["accel_scale_quadratic"])
    before, after = (gap.control_set[when]["gravity_norm_rms_mps2"] for when in ("before", "after"))
    # 0.012 m/s^2 a sample at 100 Hz over 5 s: 0.0005 m/s^2.
    assert before > 0.02 and after < 0.002
    remainder = gap.remainder
    assert (remainder.kind, remainder.block) == ("unknown", "gyro_bias")
    assert remainder.pattern == "attitude"
    assert remainder.matters and remainder.p_value < 1e-6
    assert gap.effects[0]["closed"]["rest_norm"] > 0.98
    assert gap.effects[0]["closed"]["rest_rate"] < 0.2


def test_the_remainder_is_in_text_and_in_the_document(beside_heading):
    gap = beside_heading
    assert "remainder: unknown: gyro_bias on axis" in gap.summary()
    document = json.loads(json.dumps(gap.to_dict()))
    assert document["remainder"]["kind"] == "unknown"
    assert document["remainder"]["session"] is None


def test_a_known_effect_is_added_beside_a_random_walk():
    def rate(random):
        matrix = random.normal(size=(3, 3)) * 1e-4
        return (lambda motion: motion.force @ matrix.T, walk(random, 2e-3 * DEG))

    run, control = pair(rate)
    gap = imucal.find_gap(run, control=control)
    assert (gap.verdict, names(gap)) == ("named", ["gyro_g_sensitivity"])
    remainder = gap.remainder
    assert (remainder.kind, remainder.block, remainder.pattern) == ("stochastic", "gyro_bias", "random_walk")
    assert gap.gap["closed"] > 0.4


def test_nothing_remains_beside_the_effect_that_was_hidden():
    run, control = pair(force=quadratic)
    gap = imucal.find_gap(run, control=control)
    assert (gap.verdict, names(gap)) == ("named", ["accel_scale_quadratic"])
    assert (gap.remainder.kind, gap.remainder.block, gap.remainder.matters) == ("nothing", None, False)
    assert gap.remainder.p_value > 1e-3
    assert "remainder: nothing; residuals of control recordings: p " in gap.summary()


STEP = (np.array([0.03, -0.02, 0.01]), np.array([2e-3, -1e-3, 1.5e-3]))


@pytest.mark.parametrize(
    ("temperatures", "words"),
    [
        ((None, None), "record temp_degc in both sessions"),
        ((25.0, 45.0), "the temperature changed by 20.0 K, which would be"),
        ((25.0, 25.0), "so time or a switch-on explains it"),
    ],
)
def test_biases_that_moved_between_sessions_are_said(temperatures, words):
    run, control = pair(step=STEP, temperatures=temperatures)
    gap = imucal.find_gap(run, control=control, candidates=["gyro_g_sensitivity"])
    assert gap.verdict == "unknown"
    assert (gap.remainder.block, gap.remainder.pattern) == ("biases", "between_sessions")
    session = gap.remainder.session
    np.testing.assert_allclose(session.accelerometer_mps2, STEP[0], atol=2e-3)
    np.testing.assert_allclose(session.gyroscope_radps, STEP[1], atol=1e-4)
    assert session.chi2_per_dof > 50.0 > 4.0 > session.chi2_per_dof_own
    assert "biases moved between sessions by gyroscope " in gap.summary()
    assert words in gap.summary()


def test_biases_that_hardly_moved_are_nothing():
    run, control = pair(step=tuple(0.03 * step for step in STEP))
    gap = imucal.find_gap(run, control=control, candidates=["gyro_g_sensitivity"])
    assert (gap.verdict, gap.remainder.session) == ("nothing_missing", None)


def test_a_moved_bias_does_not_hide_an_effect():
    def rate(random):
        matrix = random.normal(size=(3, 3)) * 1e-4
        return (lambda motion: motion.force @ matrix.T,)

    run, control = pair(rate, step=STEP)
    gap = imucal.find_gap(run, control=control)
    assert (gap.verdict, names(gap)) == ("named", ["gyro_g_sensitivity"])
    assert gap.gap["closed"] > 0.9
    assert gap.remainder.pattern == "between_sessions"


@pytest.mark.slow
@pytest.mark.parametrize("group", known.GROUPS)
def test_families_of_the_benchmark(group):
    """The first case of each family of recordings."""
    makers = (
        known.known_and_unknown,
        known.known_and_random,
        known.two_sessions,
        known.cancelling,
    )
    case = next(case for make in makers for case in make(1) if case.group == group)
    run, control, sealed = case.pose()
    gap = imucal.find_gap(run, control=control)
    answer = sealed.open(gap)
    assert gap.verdict in answer.verdicts
    assert set(names(gap)) == {effect.name for effect in answer.effects}
