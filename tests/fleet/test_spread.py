"""Spread of units apart from measuring noise, and the capability that follows from it."""

import numpy as np
import pytest

import imucal
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.capability import capability, proposed_limits
from imucal.fleet.statistics.spread import spread_of


@pytest.mark.parametrize("noise", [0.3, 1.0, 2.0])
def test_the_spread_without_noise_is_within_3_percent(noise):
    random = np.random.default_rng(11)
    sigmas = noise * random.uniform(0.7, 1.3, 60_000)
    values = 4.0 + random.normal(size=60_000) + sigmas * random.normal(size=60_000)
    spread = spread_of(values, sigmas)
    assert spread.spread == pytest.approx(1.0, rel=0.03)
    assert spread.low < 1.0 < spread.high
    assert spread.mean == pytest.approx(4.0, abs=4 * spread.mean_std)
    # The standard deviation of the values themselves is 41 % too large where noise equals spread.
    assert values.std() > np.sqrt(1 + 0.9 * noise**2)
    assert spread.odd < 1e-3


def test_a_few_odd_units_do_not_widen_the_spread():
    random = np.random.default_rng(12)
    values = random.normal(size=20_000) + random.normal(size=20_000)
    values[:200] = random.normal(size=200) * 15
    spread = spread_of(values, np.ones(20_000))
    assert spread.spread == pytest.approx(1.0, rel=0.05)
    assert spread.odd == pytest.approx(0.01, abs=0.004)


@pytest.mark.parametrize("units", [10, 30, 300])
def test_the_interval_covers_the_truth(units):
    random = np.random.default_rng(13)
    covered = 0
    for _ in range(200):
        sigmas = random.uniform(0.5, 1.5, units)
        spread = spread_of(random.normal(size=units) + sigmas * random.normal(size=units), sigmas)
        covered += spread.low <= 1.0 <= spread.high
    assert covered >= 180


@pytest.mark.parametrize(("units", "low"), [(5, 0.8), (10, 0.92)])
def test_the_spread_of_few_units_is_not_too_small(units, low):
    random = np.random.default_rng(17)
    spreads = [
        spread_of(random.normal(size=units), np.full(units, 0.02), interval=False).spread for _ in range(300)
    ]
    assert low < np.median(spreads) < 1.05


def test_two_equal_units_are_not_the_only_normal_ones():
    # gyro_sensitivity_yz of seven units, two of which are the same unit under two serial numbers, in mrad.
    values = np.array([-2.041, 2.336, 6.146, -3.368, -1.711, -2.041, -12.398])
    spread = spread_of(values, np.full(7, 0.11))
    assert spread.spread == pytest.approx(values.std(ddof=1), rel=0.05)
    assert spread.odd < 0.1


def test_units_without_a_spread():
    random = np.random.default_rng(14)
    spread = spread_of(3e-5 * random.normal(size=5000), np.full(5000, 3e-5))
    assert spread.low == 0.0 and spread.spread < 1e-5
    assert spread_of(np.ones(5), np.zeros(5)).spread == 0.0
    with pytest.raises(imucal.InputError, match="2 units have a value"):
        spread_of([1.0, 2.0, np.nan], [0.1, 0.1, 0.1])
    with pytest.raises(imucal.InputError, match="negative or not known"):
        spread_of([1.0, 2.0, 3.0], [0.1, np.nan, 0.1])


def fleet_of(values, sigmas, **fields):
    none = np.full(len(values), "")
    return Measurements(
        np.array([f"U{k:05d}" for k in range(len(values))]),
        np.datetime64("2026-03-01T08:00:00") + np.arange(len(values)).astype("timedelta64[m]"),
        *(none, none, none, none),
        np.full(len(values), "good"),
        ("gyro_bias_x",),
        ("rad/s",),
        np.asarray(values)[:, None],
        np.asarray(sigmas)[:, None],
        **fields,
    )


def test_the_share_out_of_limits_is_that_of_the_true_values():
    random = np.random.default_rng(15)
    true = 0.01 * random.normal(size=40_000)
    measurements = fleet_of(
        true + 0.01 * random.normal(size=40_000),
        np.full(40_000, 0.01),
        figures={"control_gravity_direction_rms_deg": random.uniform(0.1, 0.2, 40_000)},
    )
    limits = imucal.Limits(
        (imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.025, 0.025),),
        (imucal.FigureLimit("control_set", "gravity_direction_rms_deg", 0.19),),
    )
    parameter, figure = capability(measurements, limits).rows
    share = float((np.abs(true) > 0.025).mean())
    assert parameter.out_true == pytest.approx(share, rel=0.1)
    assert parameter.out_low < share < parameter.out_high
    assert parameter.out_measured > 4 * share
    assert parameter.indices.cp.value == pytest.approx(0.05 / (6 * 0.01 * 2**0.5), rel=0.02)
    assert parameter.indices.ppk.low < parameter.indices.ppk.value < parameter.indices.ppk.high
    assert figure.out_measured == pytest.approx(0.1, abs=0.01)
    assert figure.out_true is None


def test_proposed_limits_pass_nearly_all_units(tmp_path):
    random = np.random.default_rng(16)
    measurements = fleet_of(0.01 * random.normal(size=2000), np.full(2000, 0.001))
    proposed = proposed_limits(capability(measurements), measurements)
    (limit,) = proposed.parameters
    assert limit.high == pytest.approx(4 * np.hypot(0.01, 0.001), rel=0.05)
    assert limit.max_std == pytest.approx(0.002)
    proposed.save(tmp_path / "limits.json")
    assert imucal.Limits.load(tmp_path / "limits.json").parameters == proposed.parameters


def test_poor_calibrations_and_later_ones_do_not_count():
    measurements = fleet_of(np.arange(8.0), np.full(8, 0.1))
    serials = measurements.serials.copy()
    serials[7] = serials[0]
    verdicts = measurements.verdicts.copy()
    verdicts[1] = "poor"
    changed = Measurements(
        **{
            **measurements.__dict__,
            "serials": serials,
            "verdicts": verdicts.astype(measurements.verdicts.dtype),
        }
    )
    result = capability(changed)
    assert (result.units, result.poor) == (6, 1)
    with pytest.raises(imucal.InputError, match="limit of gyro_bias_x is in lsb"):
        capability(measurements, imucal.Limits((imucal.ParameterLimit("gyro_bias_x", "lsb", 0.0, 1.0),)))
