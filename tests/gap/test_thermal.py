"""Lag and hysteresis of the temperature in the search.

The recordings come from `gap.thermal_cases` of the benchmark, which shares no formula with the simulator.
"""

import numpy as np
import pytest

import imucal
import imucal._core as _core
from gap.thermal import asked, error_of, has_degree, is_right, page
from gap.thermal_cases import CLEAN, behind, of_relays, pose

DEGC = 25.0 + 20.0 * np.sin(np.arange(60_000) / 100.0 / 40.0)


def test_the_lag_is_that_of_the_differential_equation():
    state, step = DEGC[0], 0.01
    for degc in DEGC[1:]:
        state += step * (degc - state) / 30.0
    assert behind(DEGC, 30.0)[-1] == pytest.approx(state, abs=0.01)
    _, _, lag = _core.temperature_history(np.arange(60_000) / 100.0, DEGC, 30.0)
    np.testing.assert_allclose(lag, behind(DEGC, 30.0) - DEGC, atol=0.02)


def test_relays_switch_behind_the_temperature():
    loop = of_relays(DEGC, np.array([1.0]))
    rate = np.gradient(DEGC)
    settled = np.abs(rate) > 0.5 * np.abs(rate).max()
    np.testing.assert_allclose(
        loop[20_000:][settled[20_000:]], np.sign(rate)[20_000:][settled[20_000:]], atol=0.05
    )


@pytest.mark.parametrize("family", ["lag", "lead"])
def test_a_lag_is_named_with_its_time_constant(family):
    row = asked((family, 0))
    assert is_right(row), row
    assert error_of(row) < 0.25 and abs(row["found_tau_s"] - row["tau_s"]) < 4.0 * row["tau_std_s"]
    assert row["after"] < row["floor"] + 0.1 * (row["before"] - row["floor"])


def test_the_time_constant_of_a_strong_lag_is_within_a_tenth():
    row = asked(("strong lag", 0))
    assert is_right(row) and error_of(row) < 0.1, row


def test_hysteresis_is_named():
    row = asked(("hysteresis", 0))
    assert is_right(row), row
    assert "| hysteresis | 100.0 % (1/1;" in page([row])


def test_a_lag_that_predicts_only_beside_the_temperature_is_named():
    row = asked(("lag", 64))
    assert is_right(row), row


# In case 4 a lag as long as the recording explains the line as well.
@pytest.mark.parametrize(
    ("family", "index"),
    [
        ("clean", 0),
        ("line in the temperature", 0),
        ("line in the temperature", 4),
        ("quadratic in the temperature", 0),
        ("cubic in the temperature", 0),
    ],
)
def test_a_sensor_without_memory_gets_none(family, index):
    row = asked((family, index))
    assert has_degree(row, CLEAN[family]), row


def curved(kind, degree):
    """A run whose accelerometer or gyroscope follows a polynomial of this degree, and its control."""
    measured, control, _, _ = pose("clean", 1)
    random, d = np.random.default_rng(7), [own.temperature_degc - 28.0 for own in (measured, control)]
    size = {"force": 4e-3, "rate": 4e-4}[kind] * random.choice([-1.0, 1.0], size=(degree, 3))
    added = [sum(size[k] * (own[:, None] / 10.0) ** k * own[:, None] for k in range(degree)) for own in d]
    field = {"force": "specific_force", "rate": "angular_rate"}[kind]
    return [
        imucal.Recording(
            own.time_s,
            own.specific_force + (more if field == "specific_force" else 0.0),
            own.angular_rate + (more if field == "angular_rate" else 0.0),
            temperature_degc=own.temperature_degc,
            name=own.name,
        )
        for own, more in zip((measured, control), added, strict=True)
    ]


@pytest.mark.parametrize(
    ("kind", "name"), [("rate", "gyro_bias_temperature"), ("force", "accel_bias_temperature")]
)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_degree_is_that_of_the_bias(kind, name, degree):
    run, control = curved(kind, degree)
    gap = imucal.find_gap(run, control=control)
    (effect,) = [own for own in gap.effects if own["parameters"]]
    assert (effect["name"], len(effect["parameters"])) == (name, 3 * degree)
