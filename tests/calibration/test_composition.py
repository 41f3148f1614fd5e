"""Two calibrations as one: the same samples as by both in turn, and the covariance of the second."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats

import imucal
from imucal.calibration.frame import for_columns, in_frame
from imucal.cli import main
from imucal.effects.formula_effect import FormulaEffect

RANDOM = np.random.default_rng(5)
RATE, FORCE = RANDOM.normal(0, 2, (200, 3)), RANDOM.normal(0, 10, (200, 3))
T_ACCEL = np.array([[0.97, 0.03, -0.02], [0.03, 1.04, 0.05], [-0.02, 0.05, 0.98]])
T_GYRO = np.array([[1.03, -0.04, 0.02], [0.05, 0.96, -0.03], [-0.02, 0.07, 1.01]])
SECOND = imucal.Calibration(
    imucal.Triad(T_ACCEL, [0.11, -0.07, 0.19]), imucal.Triad(T_GYRO, [0.012, -0.008, 0.003])
)
FIRST = imucal.Calibration(
    imucal.Triad([[414.0, 3.0, -5.0], [3.0, 421.0, 8.0], [-5.0, 8.0, 409.0]], [33120.0, 33275.0, 32364.0]),
    imucal.Triad(4770.0 * np.linalg.inv(T_GYRO.T), [-31.0, 12.0, 44.0]),
    accel_unit="lsb",
    gyro_unit="lsb",
)
RAW = (RATE * 4770.0, FORCE * 414.0 + 33000.0)
WARM = {"gyro_bias_temperature": [2e-4, -3e-4, 1e-4], "accel_bias_temperature": [2e-3, -1e-3, 3e-3] * 2}
G_SENSITIVITY = {"gyro_g_sensitivity": 1e-4 * RANDOM.normal(size=9)}


def unit(calibration, effects, **changes):
    values = tuple(imucal.EffectValues(name, numbers) for name, numbers in effects.items())
    return dataclasses.replace(calibration, effects=values, **changes)


def covariance_of(calibration, seed, std=1e-3):
    """A full covariance of all parameters, with standard deviations relative to the sensitivities."""
    names = tuple(parameter.name for parameter in calibration.parameters)
    root = np.random.default_rng(seed).normal(size=(len(names), len(names))) * std / len(names)
    return dataclasses.replace(calibration, covariance=root @ root.T, covariance_names=names)


def recording(**changes):
    rate, force = RAW
    fields = {
        "accel_unit": "lsb",
        "gyro_unit": "lsb",
        "temperature_degc": np.linspace(-5, 60, len(rate)),
        **changes,
    }
    return imucal.Recording(np.arange(len(rate)) / 100.0, force, rate, **fields)


@pytest.mark.parametrize("first_effects", [{}, WARM, G_SENSITIVITY, WARM | G_SENSITIVITY])
@pytest.mark.parametrize("second_effects", [{}, WARM | G_SENSITIVITY])
def test_both_corrections_in_one(first_effects, second_effects):
    if "gyro_g_sensitivity" in first_effects and "accel_bias_temperature" in second_effects:
        second_effects = G_SENSITIVITY
    first, second = unit(FIRST, first_effects), unit(SECOND, second_effects)
    expected = second.apply_recording(first.apply_recording(recording()))
    found = imucal.compose(first, second)
    corrected = found.apply_recording(recording())
    np.testing.assert_allclose(corrected.angular_rate, expected.angular_rate, rtol=0, atol=1e-12)
    np.testing.assert_allclose(corrected.specific_force, expected.specific_force, rtol=0, atol=1e-11)
    assert (found.frame, found.accel_unit) == ("given", "lsb")


def test_a_formula_of_the_temperature_in_the_first():
    """As the cubic thermal terms of an autopilot."""
    x = "(min(max(temp_degc, 0.0), 50.0) - 25.0)"
    formula = FormulaEffect.of(f"thermal = accel: k1 * {x} + k3 * {x}**3")
    values = imucal.EffectValues("thermal", 1e-3 * np.array([2.0, -1.0, 3.0, 1e-3, 2e-3, -1e-3]))
    first = dataclasses.replace(FIRST, effects=(values,), user_effects=(formula,))
    expected = SECOND.apply_recording(first.apply_recording(recording()))
    found = imucal.compose(first, SECOND).apply_recording(recording())
    np.testing.assert_allclose(found.specific_force, expected.specific_force, rtol=0, atol=1e-11)
    of_force = FormulaEffect.of("rub = accel: k * f**2")
    values = imucal.EffectValues("rub", [1e-4, 2e-4, 3e-4])
    first = dataclasses.replace(FIRST, effects=(values,), user_effects=(of_force,))
    with pytest.raises(imucal.InputError, match="effect rub, which depends on rate or force"):
        imucal.compose(first, SECOND)


def test_axes_of_both_and_the_triangular_frame():
    first = dataclasses.replace(FIRST, axes="x,-y,-z")
    second = dataclasses.replace(SECOND, axes="y,-x,z")
    rec = recording().with_axes("x,-y,-z")
    corrected = first.apply_recording(rec)
    expected = second.apply_recording(corrected.with_axes("y,-x,z"))
    found = imucal.compose(first, second)
    assert found.axes == "x,-y,-z"
    np.testing.assert_allclose(
        found.apply_recording(rec).specific_force, expected.specific_force, rtol=0, atol=1e-11
    )
    triangular = [in_frame(calibration, "triangular") for calibration in (FIRST, SECOND)]
    assert imucal.compose(*triangular).frame == "triangular"


def test_the_covariance_is_that_of_the_second_propagated():
    second = covariance_of(SECOND, 1)
    found = imucal.compose(covariance_of(FIRST, 2), second)
    assert len(found.covariance_names) == 24
    # Drawn from the covariance of the second; small enough to be linear.
    names = second.covariance_names
    drawn = RANDOM.multivariate_normal(np.zeros(21), 1e-6 * second.covariance, 4000)
    values = np.array([p.value for p in second.parameters])
    changes = []
    for change in drawn:
        v = values + change
        force = np.array([[v[3], v[6], v[7]], [v[6], v[4], v[8]], [v[7], v[8], v[5]]])
        t = (FIRST.accelerometer.sensitivity @ force, FIRST.gyroscope.sensitivity @ v[12:].reshape(3, 3))
        b = (FIRST.accelerometer.sensitivity @ v[:3], FIRST.gyroscope.sensitivity @ v[9:12])
        changes.append(np.concatenate((b[0], t[0].ravel(), b[1], t[1].ravel())))
    assert names[3] == "accel_sensitivity_xx" and names[6] == "accel_sensitivity_xy"
    sampled = 1e6 * np.cov(np.array(changes).T)
    size = np.sqrt(np.outer(np.diag(found.covariance), np.diag(found.covariance)))
    assert np.abs(sampled - found.covariance).max() > 0
    np.testing.assert_allclose(sampled / size, found.covariance / size, rtol=0, atol=0.08)


@pytest.mark.slow
def test_the_covariance_covers_the_truth():
    """The errors of the first cancel: the sum of both covariances would halve chi2 of the 84 parameters."""
    chi2 = 0.0
    for seed in range(4):
        runs = [imucal.simulate("random", unit="paper", rate_hz=100, seed=100 * k + seed + 1) for k in (1, 2)]
        first = imucal.calibrate(runs[0].recording).calibration
        second = imucal.calibrate(first.apply_recording(runs[1].recording)).calibration
        both = in_frame(imucal.compose(first, second), "symmetric")
        truth = {p.name: p.value for p in runs[1].truth.calibration.parameters}
        error = np.array([p.value - truth[p.name] for p in both.parameters])
        chi2 += error @ np.linalg.solve(both.covariance, error)
    assert stats.chi2.ppf(1e-3, 84) < chi2 < stats.chi2.ppf(1 - 1e-3, 84)
    assert chi2 / 2 < stats.chi2.ppf(1e-3, 84)


def test_effects_of_the_first_keep_their_uncertainty():
    first, second = covariance_of(unit(FIRST, WARM), 3), covariance_of(SECOND, 4)
    found = imucal.compose(first, second)
    std = {parameter.name: parameter.std for parameter in found.parameters}
    # The effect is turned by T2^-1.
    names = [f"gyro_bias_temperature_{axis}" for axis in "xyz"]
    places = [first.covariance_names.index(name) for name in names]
    inverse = np.linalg.inv(T_GYRO)
    block = inverse @ first.covariance[np.ix_(places, places)] @ inverse.T
    # The uncertainty of T2 adds a little.
    for k, name in enumerate(names):
        assert std[name] == pytest.approx(np.sqrt(block[k, k]), rel=1e-3)
    without = imucal.compose(unit(FIRST, WARM), second)
    std = {parameter.name: parameter.std for parameter in without.parameters}
    assert std["gyro_bias_temperature_x"] is None and std["gyro_bias_x"] > 0
    assert imucal.compose(first, SECOND).covariance is None


REFUSED = {
    "an effect that depends on the sample": (
        unit(FIRST, {"accel_scale_quadratic": [1e-4, 2e-4, 3e-4]}),
        SECOND,
        r"effect accel_scale_quadratic, which depends on rate or force.* two steps",
    ),
    "a g-sensitivity before a nonlinear accelerometer": (
        unit(FIRST, G_SENSITIVITY),
        unit(SECOND, {"accel_scale_quadratic": [1e-4, 2e-4, 3e-4]}),
        "effect gyro_g_sensitivity",
    ),
    "raw counts twice": (FIRST, FIRST, "both calibrations expect raw counts, .* use it alone"),
    "two units": (
        dataclasses.replace(FIRST, serial_number="41"),
        dataclasses.replace(SECOND, serial_number="42"),
        "of unit 41, the second of unit 42",
    ),
    "the same recording": (
        dataclasses.replace(FIRST, provenance=imucal.Provenance((imucal.Source("run.csv", "5e" * 32),))),
        dataclasses.replace(SECOND, provenance=imucal.Provenance((imucal.Source("copy.csv", "5e" * 32),))),
        r"both calibrations are made of run\.csv",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_composed_is_refused(case):
    first, second, message = REFUSED[case]
    with pytest.raises(imucal.InputError, match=message):
        imucal.compose(first, second)


def test_a_gyroscope_that_one_of_them_has():
    """As an accelerometer calibrated alone, before or after a calibration of both sensors."""
    alone = {"gyroscope": None, "covariance": None, "covariance_names": ()}
    names = ["accel_bias_x", "gyro_bias_x", "gyro_sensitivity_xy"]
    # Only the second: its gyroscope is of raw samples.
    first = dataclasses.replace(FIRST, **alone)
    second = covariance_of(dataclasses.replace(SECOND, gyro_unit="lsb"), 1)
    found = imucal.compose(first, second)
    force = second.apply(None, first.apply(None, RAW[1])[1])[1]
    np.testing.assert_allclose(found.apply(RATE, RAW[1])[1], force, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.apply(RATE, RAW[1])[0], second.apply(RATE, None)[0], rtol=0, atol=1e-12)
    std = {p.name: p.std for p in found.parameters}
    assert std["gyro_sensitivity_xy"] == pytest.approx(
        next(p.std for p in second.parameters if p.name == "gyro_sensitivity_xy"), rel=1e-6
    )
    # Only the first: its gyroscope and its uncertainty remain.
    first, second = covariance_of(FIRST, 2), covariance_of(dataclasses.replace(SECOND, gyroscope=None), 3)
    found = imucal.compose(first, second)
    np.testing.assert_allclose(found.apply(*RAW)[0], FIRST.apply(*RAW)[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.apply(*RAW)[1], second.apply(None, FIRST.apply(*RAW)[1])[1], rtol=0, atol=1e-11
    )
    std, own = ({p.name: p.std for p in c.parameters} for c in (found, first))
    assert std["gyro_bias_x"] == pytest.approx(own["gyro_bias_x"], rel=1e-6)
    without = imucal.compose(FIRST, second)
    known = {p.name: p.std is not None for p in without.parameters}
    assert [known[name] for name in names] == [True, False, False]
    # Neither.
    both = imucal.compose(dataclasses.replace(FIRST, **alone), dataclasses.replace(SECOND, **alone))
    assert both.gyroscope is None


def test_effects_before_a_second_that_changes_nothing():
    neutral = imucal.Calibration(imucal.Triad(np.eye(3), np.zeros(3)), imucal.Triad(np.eye(3), np.zeros(3)))
    first = unit(FIRST, {"accel_scale_quadratic": [1e-4, 2e-4, 3e-4]})
    found = imucal.compose(first, neutral).apply(*RAW)
    np.testing.assert_allclose(found[1], first.apply(*RAW)[1], rtol=0, atol=1e-12)


def test_command(tmp_path, capsys):
    covariance_of(FIRST, 1).save(tmp_path / "first.json")
    covariance_of(SECOND, 2).save(tmp_path / "second.json")
    words = ["compose", str(tmp_path / "first.json"), str(tmp_path / "second.json")]
    output = tmp_path / "both.json"
    assert main([*words, "-o", str(output), "--json", str(tmp_path / "d.json")]) == 0
    assert "first.json and then " in capsys.readouterr().out
    both = imucal.Calibration.load(output)
    assert [source.path for source in both.provenance.composed_of] == words[1:]
    assert both.judged[0] == "incomplete"
    assert json.loads((tmp_path / "d.json").read_text())["without_std"] == []
    expected = SECOND.apply(*FIRST.apply(*RAW))
    np.testing.assert_allclose(both.apply(*RAW)[0], expected[0], rtol=0, atol=1e-12)
    assert main(["compose", words[1], words[1], "-o", str(output)]) == 1
    assert "both calibrations expect raw counts" in capsys.readouterr().err


# --- body frames ----------------------------------------------------------------------------------


def test_another_frame_is_a_rotation_of_the_samples():
    calibration = unit(SECOND, WARM | G_SENSITIVITY | {"accel_lever_arm": [0.01, -0.02, 0.03]})
    rec = recording(accel_unit="m/s^2", gyro_unit="rad/s")
    rec = dataclasses.replace(rec, specific_force=FORCE, angular_rate=RATE)
    before, after = (c.apply_recording(rec) for c in (calibration, in_frame(calibration, "triangular")))
    rotation = np.linalg.lstsq(before.specific_force, after.specific_force, rcond=None)[0].T
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.angular_rate, before.angular_rate @ rotation.T, rtol=0, atol=1e-10)
    np.testing.assert_allclose(after.specific_force, before.specific_force @ rotation.T, rtol=0, atol=1e-8)


def test_the_covariance_comes_back_from_another_frame():
    calibration = covariance_of(unit(SECOND, G_SENSITIVITY), 7)
    back = in_frame(in_frame(calibration, "triangular"), "symmetric")
    assert back.covariance_names == calibration.covariance_names
    size = np.sqrt(np.outer(np.diag(calibration.covariance), np.diag(calibration.covariance)))
    np.testing.assert_allclose(back.covariance / size, calibration.covariance / size, rtol=0, atol=1e-6)


def test_columns_before_a_change_of_axes():
    turned = dataclasses.replace(SECOND, axes="accel=y,-x,z gyro=z,x,y")
    rec = imucal.Recording(np.arange(200) / 100.0, FORCE, RATE)
    expected = turned.apply_recording(rec.with_axes(turned.axes))
    found = for_columns(turned).apply_recording(rec)
    np.testing.assert_allclose(found.angular_rate, expected.angular_rate, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.specific_force, expected.specific_force, rtol=0, atol=1e-12)


def test_an_effect_along_the_axes_of_its_frame_stays_there():
    calibration = unit(SECOND, {"gyro_scale_cubic": [1e-3, 2e-3, 3e-3]})
    with pytest.raises(imucal.InputError, match="gyro_scale_cubic is defined along the axes"):
        in_frame(calibration, "triangular")
