"""Evidence, test statistic and detection limit of each candidate against NumPy and SciPy, docs/model.md (23).

`gap_design` of `imucal._core` gives the whitened residuals and their derivatives, because no public function
returns them.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

import imucal
import imucal._core as _core
from gap_runs import simulated
from imucal.estimation.options import Options

pytestmark = pytest.mark.slow

SEED = 3
BASE = 21
# Widths of the prior, typical sizes. The last one is so wide that the prior has no influence.
WIDTHS, NO_PRIOR = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0), 1e4
FALSE_ALARM, POWER = 0.003, 0.9
DIRECTIONS = 20_000
# Least change of chi2 for a change of an observable direction by one typical size.
LEAST_CHANGE = 1e-4


class Reference:
    """Evidence of linear models of the residuals without effects."""

    def __init__(self, recording, names):
        options = Options(gravity_mps2=imucal.units.STANDARD_GRAVITY_MPS2, min_rest_s=_core.MIN_REST_S)
        design = _core.gap_design(
            [recording], options, [(name, imucal.effects.find(name).plain) for name in names]
        )
        # Base columns of length one, and columns of effects with their typical sizes.
        columns = [design.base / np.linalg.norm(design.base, axis=0)]
        # An effect with a time constant has one set of columns for each of four values.
        self.places, first = [], BASE
        for name, rows in design.effects:
            parameters = imucal.effects.find(name).parameters[: rows.shape[1]]
            columns.append(rows * [parameter.typical for parameter in parameters])
            self.places.append((name, np.arange(first, first + rows.shape[1])))
            first += rows.shape[1]
        rows = np.column_stack([*columns, design.residual])
        kinds = [rows[design.groups == kind] for kind in np.unique(design.groups)]
        self.rows, self.sums = np.array([len(kind) for kind in kinds]), np.array([k.T @ k for k in kinds])

    def of(self, *effects):
        """Log evidence, deviance and noise scales of a model with effects, each (columns, width of prior)."""
        places = np.concatenate([np.arange(BASE), *(own for own, _ in effects), [-1]]).astype(int)
        precision = np.concatenate(
            [np.zeros(BASE), *(np.full(len(own), width**-2.0) for own, width in effects)]
        )
        sums = self.sums[:, places][:, :, places]
        normal, right = sums[:, :-1, :-1], sums[:, :-1, -1]
        scales, before = np.ones(len(sums)), None
        while before is None or np.abs(np.log(scales / before)).max() > 1e-9:
            inverse = np.linalg.inv(np.tensordot(1.0 / scales, normal, 1) + np.diag(precision))
            theta = -inverse @ (right / scales[:, None]).sum(axis=0)
            residual = np.append(theta, 1.0)
            squares = np.einsum("i,gij,j->g", residual, sums, residual)
            free = self.rows - np.einsum("gij,ji->g", normal, inverse) / scales
            before, scales = scales, np.maximum(1.0, squares / free)
        deviance = self.rows @ np.log(scales) + (squares / scales).sum()
        volume = -np.linalg.slogdet(inverse)[1] - np.log(precision[BASE:]).sum()
        return -0.5 * (deviance + precision @ theta**2 + volume), deviance, scales

    def columns_of(self, name):
        """The columns of an effect; several sets for an effect with a time constant."""
        return [own for other, own in self.places if other == name]

    def score(self, name, *beside):
        """Log Bayes factor and decrease of the deviance, relative to the model with the effects `beside`."""
        log, deviance, _ = self.of(*beside)
        return max(
            (
                max(self.of(*beside, (own, width))[0] for width in WIDTHS) - log,
                max(deviance - self.of(*beside, (own, NO_PRIOR))[1], 0.0),
            )
            for own in self.columns_of(name)
        )

    def dof(self, name):
        """Number of observable directions."""
        normal = self._without_base(np.ones(len(self.rows)), self.columns_of(name)[0])
        return (np.linalg.eigvalsh(normal) > LEAST_CHANGE).sum()

    def detection_limit(self, name):
        """Smallest rms size that the test of all candidates detects with a probability of 90 %, averaged over
        all directions of the parameters."""
        dof, tests = self.dof(name), len({other for other, _ in self.places})
        threshold = chi2.isf(FALSE_ALARM / tests, dof)
        _, _, scales = self.of()

        def limit(normal):
            directions = np.random.default_rng(SEED).normal(size=(DIRECTIONS, len(normal)))
            directions *= np.sqrt(len(normal)) / np.linalg.norm(directions, axis=1, keepdims=True)
            power_of_one = np.einsum("da,ab,db->d", directions, normal, directions)

            def missing(log_size):
                # Larger non-centralities are seen with certainty; scipy returns NaN for very large ones.
                noncentralities = np.minimum(np.exp(2 * log_size) * power_of_one, 2e3)
                return ncx2.sf(threshold, dof, noncentralities).mean() - POWER

            return brentq(missing, -12.0, 12.0)

        limits = [np.exp(limit(self._without_base(scales, own))) for own in self.columns_of(name)]
        return min(limits) * imucal.effects.find(name).parameters[0].typical

    def _without_base(self, scales, own):
        """Normal matrix of the columns after elimination of the base columns."""
        normal = np.tensordot(1.0 / scales, self.sums, 1)
        cross = normal[:BASE][:, own]
        return normal[np.ix_(own, own)] - cross.T @ np.linalg.solve(normal[:BASE, :BASE], cross)


def searched(effects):
    """A search, and the reference for its candidates."""
    recording = simulated(SEED, effects=effects).recording
    gap = imucal.find_gap(recording)
    return gap, Reference(recording, [score["name"] for score in gap.ranking])


def assert_scores(gap, reference):
    assert {score["name"] for score in gap.ranking} == {name for name, _ in reference.places}
    for score in gap.ranking:
        name = score["name"]
        evidence, statistic = reference.score(name)
        assert score["log_bayes_factor"] == pytest.approx(evidence, abs=0.01), name
        assert score["statistic"] == pytest.approx(statistic, abs=0.2), name
        assert score["dof"] == reference.dof(name), name
        # A time constant is one more degree of freedom.
        dof = score["dof"] + (imucal.effects.find(name).shape is not None)
        assert score["p_value"] == pytest.approx(chi2.sf(score["statistic"], dof), rel=1e-6), name


def test_scores_and_detection_limits_of_a_unit_without_effects():
    gap, reference = searched({})
    assert gap.verdict == "nothing_missing"
    assert_scores(gap, reference)
    for name, limit in gap.smallest_visible.items():
        # With several parameters, both averages over the directions have errors.
        rel = 2e-3 if len(reference.columns_of(name)[0]) == 1 else 1e-2
        assert limit["value"] == pytest.approx(reference.detection_limit(name), rel=rel), name


def test_scores_of_candidates_and_of_accepted_effects():
    gap, reference = searched({"gyro_g_sensitivity": 1.5e-5, "accel_scale_quadratic": [6e-5] * 3})
    assert_scores(gap, reference)
    first, second = gap.effects
    assert (first["name"], second["name"]) == ("accel_scale_quadratic", "gyro_g_sensitivity")
    evidence, _ = reference.score(first["name"])
    assert first["log_bayes_factor"] == pytest.approx(evidence, abs=0.01)
    # The search adds the first effect to the model with a prior of typical size, and linearises the model
    # again. The reference keeps the columns of the model without effects.
    (own,) = reference.columns_of(first["name"])
    evidence, statistic = reference.score(second["name"], (own, 1.0))
    assert second["log_bayes_factor"] == pytest.approx(evidence, abs=0.5)
    assert second["statistic"] == pytest.approx(statistic, abs=1.0)


def test_standard_deviations_of_accepted_effects_are_those_of_a_calibration_with_them():
    recording = simulated(SEED, effects={"gyro_g_sensitivity": 1.5e-5}).recording
    (effect,) = imucal.find_gap(recording, candidates=["gyro_g_sensitivity"]).effects
    result = imucal.calibrate(recording, effects=["gyro_g_sensitivity:seen"])
    stated = [parameter.std for parameter in result.parameters[BASE:]]
    assert [parameter["std"] for parameter in effect["parameters"]] == pytest.approx(stated, rel=1e-3)


def test_the_threshold_of_acceptance_is_corrected_for_the_number_of_candidates():
    recording = simulated(SEED, effects={"gyro_g_sensitivity": 5e-6}).recording
    of_all = imucal.find_gap(recording)
    (score,) = (score for score in of_all.ranking if score["name"] == "gyro_g_sensitivity")
    assert FALSE_ALARM / len(of_all.ranking) < score["p_value"] < FALSE_ALARM
    assert of_all.verdict == "nothing_missing"
    assert imucal.find_gap(recording, candidates=["gyro_g_sensitivity"]).verdict == "named"
