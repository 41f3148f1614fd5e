"""Drift, control charts and odd units of a fleet in which they are planted."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.fleet.statistics.drift import drift
from imucal.fleet.statistics.outliers import outliers
from imucal.fleet.statistics.spc import control_chart, spc
from planted_fleet import NOISE, SPREADS, planted_fleet


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("with_covariance", [True, False])
def test_everything_planted_is_found_and_nothing_else(seed, with_covariance):
    planted = planted_fleet(seed=seed, shift=2.5, with_covariance=with_covariance)
    drifts = drift(planted.measurements)
    assert {unit.serial for unit in drifts.drifting} == planted.drifting
    assert {unit.parameters[0].name for unit in drifts.drifting} == {"accel_bias_x"}
    assert {unit.serial for unit in outliers(planted.measurements).odd} == planted.odd
    (shift,) = spc(planted.measurements).shifts
    assert (shift.station, shift.day, shift.name) == ("A", "2026-01-10", "gyro_bias_z")
    assert shift.shift == pytest.approx(2.5 * SPREADS[2], abs=4 * shift.std)


def test_a_fleet_without_faults_has_no_alarms():
    clean = planted_fleet(seed=3, odd=0, drifting=0).measurements
    result = drift(clean)
    assert result.drifting == () and result.single == 0
    assert not any(row.is_significant for row in result.ageing)
    assert outliers(clean).odd == ()
    assert spc(clean).shifts == ()


def test_the_slope_of_a_drifting_unit():
    planted = planted_fleet(seed=4, dates=5)
    serial = min(planted.drifting)
    (unit,) = drift(planted.measurements, serial).units
    assert unit.serial == serial and unit.is_drifting and unit.dates == 5
    assert unit.days == pytest.approx(360, abs=1)
    # For one unit all parameters are listed, the most significant first.
    assert len(unit.parameters) == 6
    first = unit.parameters[0]
    assert first.name == "accel_bias_x" and first.step is None
    assert first.slope == pytest.approx(2 * NOISE * SPREADS[3], abs=5 * first.slope_std)
    assert first.change == pytest.approx(first.values[-1] - first.values[0])


def test_a_step_is_not_a_slope():
    planted = planted_fleet(seed=5, dates=5, drift_per_month=0.0, step=15.0)
    units = drift(planted.measurements).drifting
    assert {unit.serial for unit in units} == planted.drifting
    parameter = units[0].parameters[0]
    assert parameter.step == pytest.approx(15 * NOISE * SPREADS[3], rel=0.5)
    assert parameter.step_date == parameter.dates[-1]


def test_what_ages_and_in_which_batch():
    planted = planted_fleet(seed=6, drifting=0, odd=0)
    measurements = planted.measurements
    values = measurements.values_si.copy()
    months = (measurements.dates - measurements.dates.min()) / np.timedelta64(1, "D") / 30.4
    values[:, 1] += 0.3 * NOISE * SPREADS[1] * months * (measurements.batches == "batch 1")
    result = drift(replace(measurements, values_si=values))
    significant = [row for row in result.ageing if row.is_significant]
    assert {row.name for row in significant} == {"gyro_bias_y"}
    of_batch = next(row for row in significant if row.group == "batch 1")
    assert of_batch.slope == pytest.approx(0.3 * NOISE * SPREADS[1], abs=4 * of_batch.std)


def test_noise_beyond_the_stated_one_is_no_drift():
    measurements = planted_fleet(seed=7, drifting=0, odd=0).measurements
    understated = replace(measurements, sigmas_si=measurements.sigmas_si / 3, covariances=None)
    assert drift(understated).drifting == ()


def test_an_odd_unit_names_what_decides():
    planted = planted_fleet(seed=8, odd=1)
    unit = outliers(planted.measurements).units[0]
    assert unit.serial in planted.odd and unit.is_odd
    decides = unit.decides[0]
    assert abs(decides.z) > 5
    assert decides.value == pytest.approx(
        planted.measurements.values_si[
            planted.measurements.serials == unit.serial, planted.measurements.names.index(decides.name)
        ][0]
    )


@pytest.mark.parametrize("seed", [101, 102, 103])
def test_odd_units_do_not_hide_each_other_in_a_small_fleet(seed):
    """A tenth of 50 units is odd, which widens the tail of the distances."""
    planted = planted_fleet(seed=seed, units=50, dates=1, odd=0, drifting=0)
    values = planted.measurements.values_si.copy()
    odd = [3, 14, 15, 36, 47]
    for row, column in zip(odd, (0, 1, 2, 0, 1), strict=True):
        values[row, column] += 11 * SPREADS[column]
    found = outliers(replace(planted.measurements, values_si=values)).odd
    assert {unit.serial for unit in found} == set(planted.measurements.serials[odd])


def test_units_at_a_shifted_station_are_not_odd():
    planted = planted_fleet(seed=9, odd=0, shift=12.0)
    result = outliers(planted.measurements)
    assert result.odd == ()
    assert [(shift.station, shift.day) for shift in result.shifts] == [("A", "2026-01-10")]


def test_wide_tails_are_no_alarms():
    planted = planted_fleet(seed=10, odd=0, drifting=0, units=2000, dates=1)
    random = np.random.default_rng(10)
    values = SPREADS * random.standard_t(4, size=planted.measurements.values_si.shape)
    result = outliers(replace(planted.measurements, values_si=values))
    assert len(result.odd) <= 4
    assert result.tail < 100


@pytest.mark.parametrize(
    "rule", ["beyond_3_sigma", "2_of_3_beyond_2_sigma", "4_of_5_beyond_1_sigma", "8_on_one_side"]
)
def test_each_rule_is_completed_by_its_pattern(rule):
    patterns = {
        "beyond_3_sigma": [0.0, 3.2],
        "2_of_3_beyond_2_sigma": [2.2, 0.0, 2.3],
        "4_of_5_beyond_1_sigma": [1.2, 1.3, 0.0, 1.2, 1.4],
        "8_on_one_side": [0.5] * 8,
    }
    zigzag = [-0.3, 0.0, 0.3, 0.0] * 10
    values = np.array([*zigzag, *patterns[rule], *zigzag])
    # The standard deviation of the values is that of their measurement, 1.
    chart = control_chart(values, np.ones(len(values)))
    assert chart.spread == 0.0
    found = {signal.rule: signal.index for signal in chart.signals if signal.rule != "ewma"}
    assert found == {rule: 40 + len(patterns[rule]) - 1}
    quiet = control_chart(np.array(zigzag * 2), np.ones(80))
    assert quiet.signals == ()


def test_the_moving_average_finds_a_small_lasting_change():
    random = np.random.default_rng(17)
    values = random.normal(size=400)
    values[300:] += 1.0
    chart = control_chart(values, np.full(400, 0.5))
    ewma = [signal.index for signal in chart.signals if signal.rule == "ewma"]
    assert 300 < min(index for index in ewma if index >= 300) < 330
    # The noise of the measurements, 0.5, is taken off the moving ranges.
    assert chart.spread == pytest.approx(np.sqrt(1 - 0.25), abs=0.12)


def test_poor_calibrations_are_left_out():
    planted = planted_fleet(seed=11)
    measurements = planted.measurements
    verdicts = measurements.verdicts.copy()
    verdicts[np.isin(measurements.serials, list(planted.odd))] = "poor"
    result = outliers(replace(measurements, verdicts=verdicts))
    assert result.poor == 9
    assert result.odd == ()


def test_what_cannot_be_judged_is_refused():
    measurements = planted_fleet(units=40, dates=2, drifting=0).measurements
    once = measurements.where(np.arange(40))
    with pytest.raises(imucal.InputError, match="none of 40 units was calibrated on two dates"):
        drift(once)
    with pytest.raises(imucal.InputError, match="'nobody' has 0 usable calibrations"):
        drift(measurements, "nobody")
    with pytest.raises(imucal.InputError, match="the search for outliers needs"):
        outliers(measurements.where(np.arange(8)))
    with pytest.raises(imucal.InputError, match="no station 'C'"):
        spc(measurements, station="C")


def test_many_drifting_units_do_not_move_their_station():
    planted = planted_fleet(seed=12, units=120, dates=6, drifting=40, odd=0, drift_per_month=1.0)
    # All units are measured on few days, as in a campaign.
    days = planted.measurements.dates.astype("datetime64[D]")
    months = (days - days.min()) // np.timedelta64(90, "D")
    dates = np.datetime64("2026-01-05T08:00:00") + (months * 90).astype("timedelta64[D]")
    measurements = replace(planted.measurements, dates=dates.astype("datetime64[s]"))
    result = drift(measurements)
    assert result.shifts == ()
    assert {unit.serial for unit in result.drifting} == planted.drifting


def test_a_missing_scipy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    with pytest.raises(imucal.ImucalError, match=r'need SciPy.*pip install "imucal-rs\[fleet\]"'):
        outliers(planted_fleet(units=60, dates=1, drifting=0).measurements)
