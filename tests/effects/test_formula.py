"""Effects that are one line of text: parsing, what is refused, and the way through every command."""

import json
import pickle
import subprocess

import numpy as np
import pytest

import imucal
from imucal.effects.formula import is_formula, parse_formula
from imucal.effects.formula_effect import FormulaEffect, formula_effects

SUPPLY = "gyro: k*(supply_v - 3.3)"
TRUE = [0.02, -0.01, 0.015]


def supply_v(time_s):
    return 3.5 - 1e-3 * time_s - 0.1 * (np.sin(time_s / 30.0) > 0.5)


def run(seed, **options):
    return imucal.simulate(
        "random",
        seed=seed,
        rate_hz=100.0,
        auxiliary={"supply_v": supply_v},
        effects={SUPPLY: TRUE},
        **options,
    ).recording


@pytest.fixture(scope="module")
def runs():
    return run(1), run(2)


@pytest.fixture(scope="module")
def files(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("formula")
    for name, recording in zip(("run", "control"), runs, strict=True):
        imucal.write(recording, folder / f"{name}.parquet")
    return folder


def state(rows=5):
    random = np.random.default_rng(3)
    return imucal.State(
        random.normal(size=(rows, 3)),
        random.normal(0, 9, (rows, 3)),
        np.arange(rows) * 10.0,
        random.normal(size=(rows, 3)),
        random.uniform(0, 50, rows),
        {"supply_v": random.uniform(3, 4, rows)},
    )


def test_the_field_is_that_of_numpy():
    s = state()
    w, f, dw = s.angular_rate, s.specific_force, s.angular_acceleration
    v, t, temp = s.auxiliary["supply_v"], s.time_s, s.temperature_degc
    norm = np.linalg.norm
    expected = {
        "k*(supply_v - 3.3)": lambda i: v - 3.3,
        "-k*w**2/2 + 0.5*w_y*k": lambda i: -(w[:, i] ** 2) / 2 + 0.5 * w[:, 1],
        "k*(f > f_x)*sign(dw)": lambda i: (f[:, i] > f[:, 0]) * np.sign(dw[:, i]),
        "k*exp(-time_s/80)*w_norm*(+f_norm)": lambda i: np.exp(-t / 80) * norm(w, axis=1) * norm(f, axis=1),
        "k*max(temp_degc, 25)/g*pi": lambda i: np.maximum(temp, 25) / 9.80665 * np.pi,
        "k*sqrt(abs(f_z))*tanh(w)*atan(w)*log(f_norm)": lambda i: (
            np.sqrt(np.abs(f[:, 2])) * np.tanh(w[:, i]) * np.arctan(w[:, i]) * np.log(norm(f, axis=1))
        ),
        "k*min(sin(w), cos(w))*tan(w)": lambda i: (
            np.minimum(np.sin(w[:, i]), np.cos(w[:, i])) * np.tan(w[:, i])
        ),
    }
    for text, cause in expected.items():
        field = FormulaEffect.of(f"gyro: {text}", columns=["supply_v"]).columns(s)
        assert field.shape == (5, 3, 3)
        for i in range(3):
            wanted = np.zeros((5, 3))
            wanted[:, i] = cause(i)
            np.testing.assert_allclose(field[:, :, i], wanted, rtol=1e-14, atol=0, err_msg=text)


def test_one_axis_and_several_parameters():
    effect = FormulaEffect.of("bump = accel z: a*f_x + b*(w_y > 1) - a*f_y")
    assert (effect.name, effect.sensor) == ("bump", "accelerometer")
    assert [p.name for p in effect.parameters] == ["a", "b"]
    assert [p.unit for p in effect.parameters] == ["m/s^2/(f_x - f_y)", "m/s^2/(w_y > 1)"]
    s = state()
    field = effect.columns(s)
    assert not field[:, :2].any()
    np.testing.assert_allclose(field[:, 2, 0], s.specific_force[:, 0] - s.specific_force[:, 1])


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("gyro: k*w", True),
        ("my_own = gyro x: k*w", True),
        ("gyroscope.x: k", True),
        ("accelerometer_z : k*f", True),
        ("gyroskop: k*w", True),
        ("gyro_bias_drift", False),
        ("gyro_g_sensitivity:full", False),
        ("gyro_g_sensitivity:ful", False),
    ],
)
def test_a_formula_is_told_from_a_name(text, meant):
    assert is_formula(text) is meant


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("k*(suply_v - 3.3)", "suply_v may be supply_v"),
        ("k*q*w", "has k and q multiplied by each other"),
        ("tanh(w/b)*k", "has b inside tanh"),
        ("w/k", "has k in a denominator"),
        ("k**2", r"has k inside k \*\* 2"),
        ("3*supply_v", "without a parameter"),
        ("k*w + f", "adds f without a parameter"),
        ("k^2", r"write a power as x\*\*2"),
        ("k*foo(w)", "calls foo: the functions are abs"),
        ("k*abs", "has abs without its argument"),
        ("k*min(w)", "calls min with 1 arguments: min takes 2"),
        ("k*abs(x=w)", "calls abs"),
        ("__import__('os').system('true')", "calls __import__"),
        ("k*().__class__", "holds"),
        ("k*[w]", "holds"),
        ("k*'w'", "holds"),
        ("k*1j", "holds"),
        ("k*True", "holds True"),
        ("k*(1 < w < 2)", "holds"),
        ("k*(w and f)", "holds"),
        ("(lambda: k)()", "calls"),
        ("k*w if w > 1 else f", "holds"),
        ("k*1e999", "a number that is too large"),
        (f"k*{10**200}", "a number that is too large"),
        ("k*(w", "cannot be read"),
        ("", "cannot be read"),
        ("k*w\x00", "cannot be read"),
        ("k = w", "cannot be read"),
        ("k*" + "abs(" * 60 + "w" + ")" * 60, "nested too deeply"),
        ("-" * 300 + "k", "nested too deeply"),
        ("k*w" + " " + "+ k" * 300, "at most 500"),
    ],
)
def test_what_is_no_formula_is_refused_with_the_way_out(body, said):
    with pytest.raises(imucal.InputError, match=said):
        parse_formula(f"gyro: {body}", ["supply_v"])


@pytest.mark.parametrize("text", ["gyroskop: k*w", "gyro w: k*f", "k*w", "a-b = gyro: k"])
def test_a_wrong_head_is_refused(text):
    with pytest.raises(imucal.InputError, match="is no formula: give SENSOR: EXPRESSION"):
        parse_formula(text, [])


def test_an_effect_that_is_a_bias_in_the_recordings_is_refused(runs):
    with pytest.raises(imucal.InputError, match="is constant in the recordings"):
        imucal.calibrate(runs[0], effects=["gyro: k*(supply_v > 100)"])


def test_a_formula_needs_its_column_in_every_recording(runs):
    without = imucal.simulate("random", seed=2, rate_hz=100.0).recording
    result = imucal.calibrate(runs[0], effects=[SUPPLY])
    with pytest.raises(imucal.InputError, match="depends on supply_v, which the recording lacks"):
        result.calibration.apply_recording(without)


def test_a_formula_needs_both_sensors(runs):
    alone = imucal.Recording(runs[0].time_s, runs[0].specific_force, auxiliary=runs[0].auxiliary)
    with pytest.raises(imucal.InputError, match="sensor_missing"):
        imucal.calibrate(alone, effects=["accel: k*(supply_v - 3.3)"])


def test_two_formulas_have_two_names(runs):
    effects = formula_effects(["gyro: k*w*abs(w)", "gyro x: q*supply_v", "accel: k*f*abs(w)"], runs)
    assert [effect.name for effect in effects] == ["gyro_formula", "gyro_formula_2", "accel_formula"]
    assert pickle.loads(pickle.dumps(effects[1])).columns(state()).shape == (5, 3, 1)


def test_estimated_saved_loaded_and_applied(runs, tmp_path):
    result = imucal.calibrate(runs[0], control=runs[1], effects=[SUPPLY])
    assert result.verdict == "good"
    estimated = result.parameters[21:]
    assert [p.name for p in estimated] == [f"gyro_formula_k_{axis}" for axis in "xyz"]
    for parameter, true in zip(estimated, TRUE, strict=True):
        assert abs(parameter.value - true) < 4 * parameter.std < 0.1 * abs(true)
    result.calibration.save(tmp_path / "unit.json")
    loaded = imucal.Calibration.load(tmp_path / "unit.json")
    for field in ("angular_rate", "specific_force"):
        columns = [getattr(c.apply_recording(runs[1]), field) for c in (result.calibration, loaded)]
        assert np.array_equal(*columns)
    assert imucal.evaluate(loaded, runs[1]).figures == result.control_set


@pytest.mark.slow
def test_counts_are_searched_as_si_units_are(runs):
    gap = imucal.find_gap(runs[0], control=runs[1], candidates=[SUPPLY])
    assert gap.verdict == "named" and gap.summary().startswith("verdict: named\ngyro_formula (")
    run, control = (
        imucal.Recording(
            r.time_s,
            np.round(r.specific_force * 2000),
            np.round(r.angular_rate * 5000),
            auxiliary=r.auxiliary,
            accel_unit="lsb",
            gyro_unit="lsb",
        )
        for r in runs
    )
    gap = imucal.find_gap(run, control=control, candidates=["supply = " + SUPPLY])
    assert gap.verdict == "named" and gap.summary().startswith("verdict: named\nsupply (")


def edited(path, change):
    document = json.loads(path.read_text())
    change(document["effects"][0])
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda e: e.update(formula="gyro: k*__import__('os')"), r"effects\[0\].formula.*calls __import__"),
        (lambda e: e.update(formula="gyro: k*(supply_v - 3.4)"), "another sensor or other parameters"),
        (lambda e: e.update(formula="accel: k*(supply_v - 3.3)"), "another sensor or other parameters"),
        (
            lambda e: e.update(formula="gyro x: k_x*(supply_v - 3.3)"),
            "it has 1 parameters, but the file has 3",
        ),
        (lambda e: e.update(formula=3), "formula"),
    ],
)
def test_a_file_whose_formula_contradicts_it_is_refused(runs, tmp_path, change, said):
    path = tmp_path / "unit.json"
    imucal.calibrate(runs[0], effects=[SUPPLY]).calibration.save(path)
    with pytest.raises(imucal.FormatError, match=said):
        imucal.Calibration.load(edited(path, change))


@pytest.fixture
def imucal_command(programs):
    """Run a command in a folder; returns its output."""

    def run(folder, *arguments):
        done = subprocess.run([programs / "imucal", *arguments], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        ("gyro: k * tanh(w / 0.26)", "rad/s"),
        ("accel: k * -sin(stand_1_rad) * 2", "m/s^2"),
        ("gyro: k * exp(-time_s / 30) * f", "rad/s/(exp(-time_s / 30) * f)"),
        ("gyro: k * w**2", "rad/s/(w ** 2)"),
        ("gyro: k", "rad/s"),
        ("gyro: k * supply_v", "rad/s/supply_v"),
    ],
)
def test_a_function_without_unit_does_not_change_the_unit(formula, unit):
    effect = FormulaEffect.of(formula, columns={"supply_v"})
    assert {parameter.unit for parameter in effect.parameters} == {unit}


@pytest.mark.slow
def test_the_commands_take_a_formula(imucal_command, files):
    said = imucal_command(
        files,
        "calibrate",
        "run.parquet",
        "--control",
        "control.parquet",
        "--effect",
        SUPPLY,
        "-o",
        "unit.json",
    )
    assert "rad/s/(supply_v - 3.3)" in said and "verdict: good" in said
    said = imucal_command(files, "gap", "run.parquet", "--control", "control.parquet", "--effect", SUPPLY)
    assert "verdict: named" in said
    assert "effects compensated: gyro_formula" in imucal_command(
        files, "apply", "unit.json", "control.parquet", "-o", "corrected.parquet"
    )
    imucal_command(files, "export", "unit.json", "--to", "c-header", "-o", "unit.h")
    assert "double aux_supply_v," in (files / "unit.h").read_text()


def test_a_simulation_repeats_a_formula(imucal_command, tmp_path):
    formula = "gyro x: k*w*(abs(f_z) >= 5) = 1e-3"
    imucal_command(
        tmp_path,
        *("simulate", "tumble", "--seed", "3", "--rate-hz", "50", "--effect", formula),
        *("-o", "a.csv", "--truth", "truth.json"),
    )
    imucal_command(tmp_path, "simulate", "truth.json", "-o", "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    plain = imucal.simulate("tumble", seed=3, rate_hz=50.0).recording
    with_effect = imucal.read(tmp_path / "a.csv")
    added = with_effect.angular_rate - plain.angular_rate
    assert np.abs(added[:, 0]).max() > 1e-3
