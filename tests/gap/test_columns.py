"""Further columns of a recording, such as a supply voltage, are candidates of every search."""

import numpy as np
import pytest

import imucal
from imucal.gap.columns import column_effects


def columns(seed):
    """A supply voltage with noise and a load, a motor, a counter, and a copy of a sensor's column."""
    noise = np.random.default_rng(seed)
    return {
        "supply_v": lambda t: 3.5 - 1e-3 * t - 0.1 * (np.sin(t / 30) > 0.5) + noise.normal(0, 0.01, len(t)),
        "motor": lambda t: (np.sin(t / 11 + seed) > 0.3).astype(float),
        "counter": lambda t: np.arange(len(t), dtype=float),
        "constant": lambda t: np.full(len(t), 7.0),
        "not a name": lambda t: np.sin(t / 17),
        "w": lambda t: np.sin(t / 19),
    }


def run(seed, motion="tumble", **effects):
    return imucal.simulate(
        motion, seed=seed, rate_hz=50.0, effects=effects.pop("effects", {}), auxiliary=columns(seed)
    ).recording


def test_only_what_varies_on_its_own_is_a_candidate():
    first = run(1)
    copied = {**first.auxiliary, "copy": first.angular_rate[:, 1] * 57.3, "clock_ms": first.time_s * 1e3 + 5}
    recording = imucal.Recording(
        first.time_s,
        first.specific_force,
        first.angular_rate,
        auxiliary={**copied, "bad": np.nan * first.time_s},
    )
    effects = column_effects([recording])
    assert {effect.name for effect in effects} == {
        "gyro_bias_supply_v",
        "accel_bias_supply_v",
        "gyro_bias_motor",
        "accel_bias_motor",
    }


def test_a_column_that_another_recording_lacks_is_no_candidate():
    without = imucal.simulate("tumble", seed=2, rate_hz=50.0).recording
    assert column_effects([run(1), without]) == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formula", "size", "named"),
    [
        ("gyro: k*motor", [1e-3, -5e-4, 8e-4], "gyro_bias_motor"),
        ("accel: k*(supply_v - 3.4)", [0.1, 0.05, -0.1], "accel_bias_supply_v"),
    ],
)
def test_a_bias_that_follows_a_column_is_named(formula, size, named):
    first, control = (run(seed, effects={formula: size}) for seed in (1, 2))
    gap = imucal.find_gap(first, control=control)
    assert gap.summary().startswith(f"verdict: named\n{named} (")


@pytest.mark.slow
def test_columns_that_do_nothing_change_no_answer():
    for effects, verdict in (({}, "nothing_missing"), ({"gyro_scale_asymmetry": 5e-3}, "named")):
        first, control = (run(seed, effects=effects) for seed in (3, 4))
        gap = imucal.find_gap(first, control=control)
        assert gap.verdict == verdict
        assert "supply" not in gap.summary() and "motor" not in gap.summary()
