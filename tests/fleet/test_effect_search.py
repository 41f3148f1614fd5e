"""An effect over all units that no unit shows alone, and groups of temperature curves."""

import numpy as np
import pytest

import imucal
from imucal.fleet.statistics.clusters import clusters_of
from imucal.fleet.statistics.effect_search import effect_search, searchable
from imucal.fleet.statistics.fitted_effects import Fitted, UnitFiles, fitted_effects

EFFECTS = ("gyro_scale_quadratic", "accel_scale_cubic", "gyro_bias_drift", "accel_scale_quadratic")
SIGMA = 1e-5


def fleet_of(units=200, *, mean=0.0, spread=0.0, understated=1.0, seed=0):
    """Fits of all effects, of which the first one has this mean and spread over units, in sigmas of a fit."""
    random = np.random.default_rng(seed)
    covariance = (SIGMA / understated) ** 2 * np.eye(3)

    def fit_all(effects, beside):
        return {
            f"U{k}": {
                name: Fitted(
                    SIGMA
                    * (
                        random.normal(size=3) + (name == EFFECTS[0]) * (mean + spread * random.normal(size=3))
                    ),
                    covariance,
                )
                for name in effects
            }
            for k in range(units)
        }

    return fit_all


@pytest.mark.parametrize(("mean", "spread"), [(0.6, 0.0), (0.0, 0.8)])
def test_an_effect_that_no_unit_shows_is_found(mean, spread):
    result = effect_search(fleet_of(mean=mean, spread=spread), EFFECTS)
    (found,) = result.effects
    assert found.name == EFFECTS[0] and found.alone == 0 and found.units == 200
    for parameter in found.parameters:
        assert parameter.mean == pytest.approx(mean * SIGMA, abs=5 * parameter.mean_std)
        assert parameter.low <= parameter.spread <= parameter.high
    spreads = np.array([parameter.spread for parameter in found.parameters])
    assert np.sqrt((spreads**2).mean()) == pytest.approx(spread * SIGMA, abs=0.25 * SIGMA)


@pytest.mark.parametrize("understated", [1.0, 1.3])
@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_effect(understated, seed):
    result = effect_search(fleet_of(understated=understated, seed=seed), EFFECTS)
    assert result.effects == ()
    assert result.inflation == pytest.approx(understated**2, rel=0.25)


def test_too_few_units_are_refused():
    with pytest.raises(imucal.InputError, match="3 of 3 units determine an effect"):
        effect_search(fleet_of(3), EFFECTS)
    with pytest.raises(imucal.InputError, match="there is no effect 'gyro_magic'"):
        searchable(["gyro_magic"])
    assert "gyro_g_sensitivity" in searchable()


def test_effects_are_fitted_in_the_recordings_of_a_unit(tmp_path):
    program = imucal.Program.random(seed=3, moves=24, hold_s=3.0)
    effect = {"gyro_g_sensitivity": [1e-4] * 9}
    simulation = imucal.simulate(program, effects=effect, seed=1, rate_hz=100.0)
    imucal.write(simulation.recording, tmp_path / "run.parquet")
    unit = UnitFiles("7", (str(tmp_path / "run.parquet"),))
    serial, fits, error = fitted_effects(unit, ("gyro_g_sensitivity", "gyro_bias_temperature"))
    assert (serial, error, set(fits)) == ("7", "", {"gyro_g_sensitivity"})
    fitted = fits["gyro_g_sensitivity"]
    z = (fitted.values - 1e-4) / np.sqrt(np.diag(fitted.covariance))
    assert fitted.values.shape == (9,) and np.abs(z).max() < 5
    missing = UnitFiles("8", (str(tmp_path / "none.csv"),))
    serial, fits, error = fitted_effects(missing, ("gyro_g_sensitivity",))
    assert fits == {} and "none.csv" in error


def test_groups_of_temperature_curves():
    random = np.random.default_rng(4)
    values = random.normal(size=(120, 3))
    serials = tuple(f"U{k}" for k in range(120))
    assert clusters_of("gyro_bias_temperature", serials, values) == []
    values[80:, 1] += 7.0
    clusters = clusters_of("gyro_bias_temperature", serials, values)
    assert sorted(len(cluster.serials) for cluster in clusters) == [40, 80]
    assert {cluster.serials for cluster in clusters} == {serials[:80], serials[80:]}
