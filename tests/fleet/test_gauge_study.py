"""Gauge studies and capability indices against published worked examples."""

import math

import numpy as np
import pytest
from scipy import stats

import imucal
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.grr import gauge_study, grr
from imucal.fleet.statistics.indices import capability_indices, cp, cpk, moving_range_std

# AIAG, Measurement Systems Analysis, 4th edition, chapter III B, figure III-B 15: 10 parts, appraisers A, B
# and C with 3 trials each. Minitab has the same data as gageaiag.mtw (support.minitab.com, Example of Crossed
# Gage R&R Study).
AIAG = np.array(
    [
        [0.29, 0.41, 0.64, 0.08, 0.25, 0.07, 0.04, -0.11, -0.15],
        [-0.56, -0.68, -0.58, -0.47, -1.22, -0.68, -1.38, -1.13, -0.96],
        [1.34, 1.17, 1.27, 1.19, 0.94, 1.34, 0.88, 1.09, 0.67],
        [0.47, 0.50, 0.64, 0.01, 1.03, 0.20, 0.14, 0.20, 0.11],
        [-0.80, -0.92, -0.84, -0.56, -1.20, -1.28, -1.46, -1.07, -1.45],
        [0.02, -0.11, -0.21, -0.20, 0.22, 0.06, -0.29, -0.67, -0.49],
        [0.59, 0.75, 0.66, 0.47, 0.55, 0.83, 0.02, 0.01, 0.21],
        [-0.31, -0.20, -0.17, -0.63, 0.08, -0.34, -0.46, -0.56, -0.49],
        [2.26, 1.99, 2.01, 1.80, 2.12, 2.19, 1.77, 1.45, 1.87],
        [-1.36, -1.25, -1.31, -1.68, -1.62, -1.50, -1.49, -1.77, -2.16],
    ]
).reshape(10, 3, 3)
# Houf and Berman, IEEE Transactions on Components, Hybrids, and Manufacturing Technology 11 (1988): thermal
# impedance of power modules; as printed by Vidakovic, Statistics for Bioengineering Sciences, example 11.14.
IMPEDANCE = np.array(
    [
        [37, 38, 37, 41, 41, 40, 41, 42, 41],
        [42, 41, 43, 42, 42, 42, 43, 42, 43],
        [30, 31, 31, 31, 31, 31, 29, 30, 28],
        [42, 43, 42, 43, 43, 43, 42, 42, 42],
        [28, 30, 29, 29, 30, 29, 31, 29, 29],
        [42, 42, 43, 45, 45, 45, 44, 46, 45],
        [25, 26, 27, 28, 28, 30, 29, 27, 27],
        [40, 40, 40, 43, 42, 42, 43, 43, 41],
        [25, 25, 25, 27, 29, 28, 26, 26, 26],
        [35, 34, 34, 35, 35, 34, 35, 34, 35],
    ]
).reshape(10, 3, 3)


def test_the_analysis_of_variance_of_the_aiag_manual():
    study = gauge_study(AIAG)
    table = {row.source: row for row in study.table}
    # Table III-B 7: sums of squares, degrees of freedom, mean squares.
    published = {
        "operators": (2, 3.1673, 1.58363),
        "units": (9, 88.3619, 9.81799),
        "interaction": (18, 0.3590, 0.01994),
        "repeats": (60, 2.7589, 0.04598),
        "total": (89, 94.6471, None),
    }
    for source, (dof, squares, mean) in published.items():
        assert table[source].dof == dof
        assert table[source].sum_of_squares == pytest.approx(squares, abs=5e-5)
        assert mean is None or table[source].mean_square == pytest.approx(mean, abs=5e-6)
    assert table["interaction"].f == pytest.approx(0.434, abs=5e-4)
    assert table["interaction"].p_value == pytest.approx(0.974, abs=5e-4)
    # Minitab's table without the interaction.
    assert table["units"].f == pytest.approx(245.614, abs=5e-4)
    assert table["operators"].f == pytest.approx(39.617, abs=5e-4)


def test_the_components_of_the_aiag_manual():
    study = gauge_study(AIAG, tolerance=8.0)
    # Table III-B 8: variance, standard deviation, % of the total variation, % contribution. The manual takes
    # differences of rounded numbers; Minitab prints 0.09143, 0.03997, 0.05146, 1.08645, 1.17788.
    published = {
        "repeatability": (0.03997, 0.199933, 18.42, 3.39),
        "operator": (0.05146, 0.226838, 20.90, 4.37),
        "grr": (0.09143, 0.302373, 27.86, 7.76),
        "unit": (1.08645, 1.04233, 96.04, 92.24),
        "total": (1.17788, 1.08530, 100.0, 100.0),
    }
    assert study.pooled
    for source, (variance, std, variation, contribution) in published.items():
        component = study.component(source)
        assert component.variance == pytest.approx(variance, abs=6e-6)
        assert component.std == pytest.approx(std, abs=1e-5)
        assert 100 * component.study_variation == pytest.approx(variation, abs=0.005)
        assert 100 * component.contribution == pytest.approx(contribution, abs=0.005)
    assert study.component("interaction").variance == 0.0
    assert study.ndc == 4
    # Minitab, process tolerance 8: % tolerance of the total gauge R&R.
    assert 100 * study.tolerance == pytest.approx(22.68, abs=0.005)


def test_a_study_with_an_interaction():
    study = gauge_study(IMPEDANCE)
    # Montgomery, Statistical Quality Control, example on a random effects gauge study: variance components.
    published = {"repeatability": 0.51, "interaction": 0.73, "operator": 0.56, "unit": 48.29}
    assert not study.pooled
    for source, variance in published.items():
        assert study.component(source).variance == pytest.approx(variance, abs=0.005)


def test_capability_of_the_nist_handbook():
    # NIST/SEMATECH e-Handbook of Statistical Methods, section 6.1.6: limits 8 and 20, mean 16, s 2.
    assert cp(16.0, 2.0, 8.0, 20.0, 50, 49.0).value == pytest.approx(1.0)
    assert cpk(16.0, 2.0, 8.0, 20.0, 50, 49.0).value == pytest.approx(0.6667, abs=5e-5)
    assert cpk(16.0, 2.0, 8.0, None, 50, 49.0).value == pytest.approx(1.3333, abs=5e-5)
    assert cpk(16.0, 2.0, None, 20.0, 50, 49.0).value == pytest.approx(0.6667, abs=5e-5)


def test_intervals_of_montgomery():
    # Montgomery, Statistical Quality Control, section 8.3.5: n 20, s 1.75, limits 38 and 62: 1.57 to 3.01.
    index = cp(50.0, 1.75, 38.0, 62.0, 20, 19.0)
    assert (index.value, index.low, index.high) == pytest.approx((2.29, 1.57, 3.01), abs=0.01)
    # Cpk of 1.33: Cpk (1 -+ 1.96 sqrt(1 / (9 n Cpk^2) + 1 / (2 n - 2))), the formula of the same section.
    index = cpk(0.0, 1.0, -3 * 1.33, 100.0, 20, 19.0)
    half = 1.959964 * math.sqrt(1 / (9 * 20 * 1.33**2) + 1 / 38)
    assert (index.low, index.high) == pytest.approx((1.33 * (1 - half), 1.33 * (1 + half)))


def test_indices_of_values():
    values = np.array([1.0, 2.0, 4.0, 3.0, 5.0])
    indices = capability_indices(values, -2.0, 8.0)
    assert indices.overall == pytest.approx(values.std(ddof=1))
    # Mean of the moving ranges 1, 2, 1, 2 over d2 = 1.128.
    assert indices.within == moving_range_std(values) == pytest.approx(1.5 / 1.128, rel=1e-3)
    assert indices.pp.value == pytest.approx(10.0 / (6 * indices.overall))
    assert indices.cpk.value == pytest.approx(5.0 / (3 * indices.within))
    assert capability_indices(values, None, 8.0).cp is None
    with pytest.raises(imucal.InputError, match="no limit"):
        capability_indices(values, None, None)
    with pytest.raises(imucal.InputError, match="are the same"):
        capability_indices(np.ones(5), 0.0, 2.0)


@pytest.mark.parametrize(("understated", "honest"), [(1.0, True), (2.0, False), (0.5, False)])
def test_stated_standard_deviations_are_tested(understated, honest):
    random = np.random.default_rng(5)
    y = random.normal(size=(10, 1, 1)) * 10 + random.normal(size=(10, 3, 4))
    study = gauge_study(y, sigmas=np.full(y.shape, 1.0 / understated))
    assert study.sigma.is_honest is honest
    assert study.sigma.factor == pytest.approx(understated, rel=0.15)
    assert study.sigma.low < study.sigma.factor < study.sigma.high


def test_the_test_of_stated_standard_deviations_is_chi_square():
    random = np.random.default_rng(7)
    sigmas = np.broadcast_to(random.uniform(0.5, 2.0, size=(8, 3, 1)), (8, 3, 4))
    y = random.normal(size=(8, 1, 1)) * 10 + sigmas * random.normal(size=sigmas.shape)
    test = gauge_study(y, sigmas=sigmas).sigma
    chi2 = ((y - y.mean(axis=2, keepdims=True)) ** 2 / sigmas**2).sum()
    law = stats.chi2(8 * 3 * 3)
    assert test.factor == pytest.approx(np.sqrt(chi2 / 72), rel=1e-9)
    assert (test.low, test.high) == pytest.approx(tuple(np.sqrt(chi2 / law.ppf([0.975, 0.025]))), rel=1e-9)
    assert test.p_value == pytest.approx(2 * min(law.cdf(chi2), law.sf(chi2)), rel=1e-9)
    assert test.stated == pytest.approx(np.sqrt((sigmas**2).mean()), rel=1e-12)


def measurements_of(y, sigma=0.2):
    """One measurement of one parameter for each unit, operator and repeat."""
    unit, operator, repeat = (index.ravel() for index in np.indices(y.shape))
    none = np.full(y.size, "")
    return Measurements(
        np.array([f"U{k}" for k in unit]),
        np.datetime64("2026-03-01T08:00:00") + repeat.astype("timedelta64[s]"),
        none,
        np.array([f"operator {k}" for k in operator]),
        none,
        none,
        np.full(y.size, "good"),
        ("gyro_bias_x",),
        ("rad/s",),
        y.reshape(-1, 1),
        np.full((y.size, 1), sigma),
    )


def test_a_study_of_measurements_is_balanced():
    measurements = measurements_of(AIAG)
    result = grr(measurements, tolerances={"gyro_bias_x": 8.0})
    assert (result.units, result.operators, result.repeats, result.left_out) == (10, 3, 3, 0)
    (study,) = result.studies
    assert study.component("grr").std == pytest.approx(0.302373, abs=1e-5)
    assert study.sigma.factor == pytest.approx(math.sqrt(0.04598) / 0.2, rel=1e-3)
    # Without a repeat of unit 3 there are two of all; without two repeats of an operator it is left out.
    rows = np.arange(len(measurements))
    assert grr(measurements.where(rows != 3 * 9)).repeats == 2
    assert grr(measurements.where((rows < 27) | (rows >= 29))).units == 9
    with pytest.raises(imucal.InputError, match="two or more operators have each measured twice"):
        grr(measurements.where(measurements.operators == "operator 1"))
    with pytest.raises(imucal.InputError, match="give operator or station"):
        grr(measurements, by="day")
