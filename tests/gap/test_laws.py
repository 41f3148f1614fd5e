"""Laws: formulas for what the catalogue lacks. The recordings come from `gap.law_cases` of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

import imucal
from gap.law_cases import pose
from imucal.effects.formula_effect import FormulaEffect
from imucal.effects.state import State
from imucal.gap.laws.library import Form, library
from imucal.gap.laws.selection import Columns, select

W = ("w",)


def columns(signal, *, rivals=1, seed=3):
    """Residuals of 60 items with one column that explains them, and columns of other variables."""
    random = np.random.default_rng(seed)
    items = np.repeat(np.arange(60), 5)
    count = len(items)
    own = random.normal(size=(count, 1))
    candidates = [(Form("gyro", "w", "k*w**2", None, W, 1), own)]
    for k in range(rivals):
        other = Form("gyro", f"c{k}", f"k*c{k}", None, (f"c{k}",), 1)
        candidates.append((other, random.normal(size=(count, 1))))
    residual = signal * own[:, 0] + random.normal(size=count)
    return Columns(residual, random.normal(size=(count, 2)), np.zeros(count, int), items, candidates)


def test_the_form_that_explains_the_residuals_is_selected():
    (found,) = select(columns(0.6, rivals=40))
    assert found.form.variables == W and found.stable == 1.0


def nats(given):
    """Log Bayes factor of the first candidate at the best prior width, minus the log of their number."""
    outside = np.linalg.svd(given.model)[0][:, given.model.shape[1] :]
    residual, column = outside.T @ given.residual, outside.T @ given.candidates[0][1][:, 0]
    noise = max(1.0, np.sqrt(residual @ residual / len(given.residual)))
    # The model changes the distribution of the residuals along its column only.
    along = residual @ column / np.linalg.norm(column)

    def gain(width):
        return norm.logpdf(along, scale=noise * np.hypot(1.0, width)) - norm.logpdf(along, scale=noise)

    best = minimize_scalar(lambda width: -gain(width), bounds=(0.0, 100.0), method="bounded")
    return -best.fun - np.log(len(given.candidates))


@pytest.mark.parametrize(("signal", "exceeds"), [(0.37, False), (0.38, True)])
def test_evidence_of_a_law_is_that_of_the_normal_distribution_and_needs_eight_nats(signal, exceeds):
    given = columns(signal, rivals=40)
    expected = nats(given)
    assert 7.0 < expected < 9.0 and (expected > 8.0) == exceeds
    assert [law.nats for law in select(given)] == pytest.approx([expected] if exceeds else [], abs=1e-3)


def test_noise_selects_nothing():
    assert [seed for seed in range(40) if select(columns(0.0, rivals=40, seed=seed))] == []


def test_two_variables_that_explain_the_same_are_no_law():
    given = columns(0.6)
    twin = Form("gyro", "temp_degc", "k*temp_degc", None, ("temp_degc",), 1)
    alike = given.candidates[0][1] + 1e-3
    assert select(Columns(given.residual, given.model, given.groups, given.items,
                          [*given.candidates, (twin, alike)])) == []  # fmt: skip


def test_a_law_that_few_items_support_is_not_selected():
    given = columns(0.0)
    residual = given.residual.copy()
    own = given.candidates[0][1][:, 0]
    residual[given.items == 7] += 30.0 * own[given.items == 7]
    assert select(Columns(residual, given.model, given.groups, given.items, given.candidates)) == []


def test_time_since_the_last_motion_is_an_input():
    rate = np.zeros((7, 3))
    rate[2, 1], rate[3, 0], rate[5, 2] = 0.2, -0.11, 0.09
    state = State(rate, np.zeros((7, 3)), np.arange(7) / 10.0)
    effect = FormulaEffect.of("gyro x: k*rest_s")
    assert effect.columns(state)[:, 0, 0] == pytest.approx([0.0, 0.1, 0.0, 0.0, 0.1, 0.2, 0.3])
    with pytest.raises(imucal.InputError, match="stand_2_rad, which the recording lacks"):
        FormulaEffect.of("gyro x: k*sin(stand_2_rad)").columns(state)


def test_a_law_of_the_time_since_a_motion_is_undone_at_its_limit():
    """An effect that moves the rate across the limit has no inverse if the time depends on the result."""
    run = imucal.simulate("tumble", seed=2, rate_hz=50.0).recording
    effect = FormulaEffect.of("gyro: k*exp(-rest_s/0.3)")
    unit = imucal.Calibration(
        imucal.Triad(np.eye(3), np.zeros(3)),
        imucal.Triad(np.eye(3), np.zeros(3)),
        effects=[imucal.EffectValues(effect.name, [0.02, -0.02, 0.02])],
        user_effects=[effect],
    )
    corrected = unit.apply_recording(run)
    added = run.angular_rate - corrected.angular_rate
    assert np.abs(added).max() == pytest.approx(0.02) and np.isfinite(added).all()


def test_a_simulation_has_the_angles_of_the_stand():
    plain, angled = (
        imucal.simulate("random", seed=2, rate_hz=50.0, stand=imucal.Stand(), effects=effects).recording
        for effects in ({}, {"gyro x: k*sin(2*stand_1_rad)": [0.01]})
    )
    added = angled.angular_rate - plain.angular_rate
    assert np.abs(added[:, 0]).max() == pytest.approx(0.01, rel=0.05)


def test_forms_need_variables_that_vary():
    measured, _, _, _ = pose("dead zone", 0)
    drivers = {form.driver for form in library([measured])}
    assert drivers == {"w", "f", "w_norm", "time_s", "rest_s"}


@pytest.fixture(scope="module")
def dead_zone():
    measured, control, _, _ = pose("dead zone", 0)
    return measured, control, imucal.find_gap(measured, control=control)


def test_a_dead_zone_is_a_law_of_the_rate(dead_zone):
    gap = dead_zone[2]
    assert gap.verdict == "unknown" and gap.remainder.kind == "nothing" and gap.effects == ()
    (law,) = gap.laws
    assert law.variables == W and law.sensor == "gyroscope" and law.stability >= 0.8
    assert gap.gap["closed"] > 0.9
    assert all(p["unit"] and p["std"] > 0 for p in law.parameters)
    assert f"law: {law.formula} with k_x = " in gap.summary()
    document = gap.to_dict()
    assert document["laws"][0]["formula"] == law.formula and document["law"]["formula"] == law.formula
    assert [term["name"] for term in document["law"]["terms"]] == [f"{law.name}_k_{axis}" for axis in "xyz"]
    assert len(law.curve.at) == len(law.curve.value["x"]) == len(law.curve.std["z"])


def test_a_law_is_an_effect_like_any_other(dead_zone, tmp_path):
    _, control, gap = dead_zone
    gap.calibration.save(tmp_path / "unit.json")
    again = imucal.Calibration.load(tmp_path / "unit.json")
    np.testing.assert_array_equal(
        again.apply_recording(control).angular_rate, gap.calibration.apply_recording(control).angular_rate
    )
    assert imucal.evaluate(again, control).figures.chi2_per_dof == pytest.approx(gap.gap["after"], rel=1e-3)
    assert gap.laws[0].formula in imucal.export(again, "c-header").text
    assert gap.laws[0].formula in imucal.export(again, "rust").text


def test_a_search_for_given_candidates_has_no_laws(dead_zone):
    measured, control, _ = dead_zone
    gap = imucal.find_gap(measured, control=control, candidates=["gyro_scale_cubic"])
    assert gap.laws == () and gap.to_dict()["law"] is None
