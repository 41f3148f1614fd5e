"""Limits of a unit: every kind is kept and is not, what is missing fails, a bad file is refused by name.

`limits_from` is called directly, so that the cases need no calibration files.
"""

import csv
import dataclasses
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.limits.template import limits_from

SCHEMA = json.loads((Path(imucal.__file__).parent / "schema" / "limits-1.json").read_text())
GOOD = {"chi2_per_dof": 1.2, "gravity_norm_rms_mps2": 0.001, "gravity_direction_rms_deg": 0.05}
STD = 1e-3


def unit(gyro_bias=(0.01, 0.0, 0.0), **changes):
    """A calibration whose 21 parameters have the standard deviation STD."""
    fields = {
        "accelerometer": imucal.Triad(np.eye(3), np.zeros(3)),
        "gyroscope": imucal.Triad(np.diag([1.0, 1.02, 0.98]), gyro_bias),
        "calibration_set": {**GOOD, "rests": 40, "moves": 39},
        "control_set": {**GOOD, "rests": 20, "moves": 19},
        "serial_number": "0042",
        **changes,
    }
    bare = imucal.Calibration(**fields)
    names = tuple(parameter.name for parameter in bare.parameters)
    return dataclasses.replace(bare, covariance=STD**2 * np.eye(len(names)), covariance_names=names)


def limits_from_dict(tmp_path, fields, **options):
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"schema": "imucal.limits/1", **fields}))
    return imucal.Limits.load(path, **options)


def of_parameter(name, **limit):
    return {"parameters": {name: {"unit": "rad/s", **limit}}}


def of_figure(of, figure, **limit):
    return {of: {figure: limit}}


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        (of_parameter("gyro_bias_x", min=-0.02, max=0.02), None),
        (of_parameter("gyro_bias_x", min=-0.01, max=0.01), None),
        (
            of_parameter("gyro_bias_x", min=-0.02, max=0.009),
            "gyro_bias_x is 0.01 rad/s, above its limit 0.009",
        ),
        (of_parameter("gyro_bias_x", min=0.02, max=0.03), "gyro_bias_x is 0.01 rad/s, below its limit 0.02"),
        (
            of_parameter("gyro_bias_x", min=-1, max=0.01 - 1e-12),
            "is 0.01 rad/s, above its limit 0.009999999999",
        ),
        (of_parameter("gyro_bias_x", max_std=1e-3), None),
        (
            of_parameter("gyro_bias_x", max_std=9e-4),
            "std of gyro_bias_x is 0.001 rad/s, above its limit 0.0009",
        ),
        (of_parameter("gyro_bias_*", min=-0.02, max=0.02, max_std=2e-3), None),
        (of_parameter("gyro_bias_*", min=-0.009, max=0.009), "gyro_bias_x is 0.01 rad/s, above"),
        (of_figure("control_set", "chi2_per_dof", max=2), None),
        (
            of_figure("control_set", "chi2_per_dof", max=1),
            "control_set chi2_per_dof is 1.2, above its limit 1",
        ),
        (of_figure("calibration_set", "gravity_norm_rms_mps2", max=0.001), None),
        (of_figure("calibration_set", "gravity_norm_rms_mps2", max=9e-4), "is 0.001 m/s^2, above its limit"),
        (of_figure("control_set", "gravity_direction_rms_deg", max=0.1), None),
        (
            of_figure("control_set", "gravity_direction_rms_deg", max=0.01),
            "is 0.05 deg, above its limit 0.01",
        ),
        (of_figure("calibration_set", "rests", min=40), None),
        (of_figure("calibration_set", "rests", min=41), "calibration_set rests is 40, below its limit 41"),
        (of_figure("control_set", "moves", min=19), None),
        (of_figure("control_set", "moves", min=20), "control_set moves is 19, below its limit 20"),
        ({"effects": []}, None),
    ],
)
def test_every_kind_of_limit_is_kept_or_not(tmp_path, fields, reason):
    judgement = limits_from_dict(tmp_path, fields).judge(unit())
    assert judgement.passed == (reason is None)
    assert len(judgement.reasons) == (reason is not None)
    assert reason is None or reason in judgement.reasons[0]


@pytest.mark.parametrize("allowed", [[], ["accel_bias_temperature"], ["gyro_g_sensitivity"]])
def test_effects_are_those_allowed(tmp_path, allowed):
    carrying = unit(effects=(imucal.EffectValues("gyro_g_sensitivity", [1e-4] * 9),))
    judgement = limits_from_dict(tmp_path, {"effects": allowed}).judge(carrying)
    assert judgement.passed == ("gyro_g_sensitivity" in allowed)
    if not judgement.passed:
        words = f"the calibration has gyro_g_sensitivity; permitted effects: {', '.join(allowed) or 'none'}"
        assert judgement.reasons == (words,)


def test_a_star_stands_for_one_part_of_a_name(tmp_path):
    carrying = unit(effects=(imucal.EffectValues("gyro_bias_temperature", [1e-3] * 3),))
    judgement = limits_from_dict(tmp_path, of_parameter("gyro_bias_*", min=-1, max=1)).judge(carrying)
    assert [check.what for check in judgement.checks] == [f"gyro_bias_{axis}" for axis in "xyz"]


def test_what_a_limit_asks_for_and_is_missing_fails(tmp_path):
    bare = dataclasses.replace(
        unit(), covariance=None, covariance_names=(), control_set=None, calibration_set={"chi2_per_dof": None}
    )
    for fields, reason in (
        (of_parameter("gyro_bias_x", max_std=1), "the std of gyro_bias_x is not known"),
        (of_figure("control_set", "chi2_per_dof", max=9), "there is no control recording"),
        (of_figure("calibration_set", "chi2_per_dof", max=9), "calibration_set chi2_per_dof does not exist"),
        (of_figure("calibration_set", "rests", min=1), "calibration_set rests does not exist"),
        (of_figure("held_out", "gravity_direction_rms_deg", max=9), "give --folds to calibrate"),
        (
            {"parameters": {"gyro_g_sensitivity_*": {"unit": "rad/s/(m/s^2)", "min": -1, "max": 1}}},
            "the calibration has no parameter gyro_g_sensitivity_* (frame symmetric, effects none)",
        ),
        (
            {"parameters": {"gyro_bias_x": {"unit": "lsb", "min": -9, "max": 9}}},
            "gyro_bias_x is in rad/s, its limit in lsb",
        ),
    ):
        judgement = limits_from_dict(tmp_path, fields).judge(bare)
        assert not judgement.passed
        assert len(judgement.reasons) == 1
        assert reason in judgement.reasons[0]
        json.dumps(judgement.to_dict(), allow_nan=False)


def test_a_missing_control_recording_is_one_reason(tmp_path):
    figures = {"control_set": {name: {"max": 1} for name in GOOD}}
    judgement = limits_from_dict(tmp_path, figures).judge(unit(control_set=None))
    assert (len(judgement.failed), len(judgement.reasons)) == (3, 1)


@pytest.mark.parametrize(
    ("limit", "passed", "warned"),
    [(0.0125, True, False), (0.0115, True, True), (0.0085, False, True), (0.0075, False, False)],
)
def test_a_limit_within_two_sigma_is_a_warning_and_the_value_decides(tmp_path, limit, passed, warned):
    judgement = limits_from_dict(tmp_path, of_parameter("gyro_bias_x", min=-1, max=limit)).judge(unit())
    assert judgement.passed == passed
    assert bool(judgement.warnings) == warned
    if warned:
        assert f"1.5 sigma from its limit {limit}" in judgement.warnings[0]


def test_checks_say_what_limit_value_and_verdict_the_worst_first(tmp_path):
    bias = of_parameter("gyro_bias_*", min=-0.011, max=0.011)["parameters"]
    scale = {"gyro_sensitivity_yy": {"unit": "1", "min": 0.99, "max": 1.01, "max_std": 0.01}}
    judgement = limits_from_dict(tmp_path, {"parameters": {**bias, **scale}}).judge(unit())
    assert [check.what for check in judgement.by_use[:2]] == ["gyro_sensitivity_yy", "gyro_bias_x"]
    worst = judgement.by_use[0]
    assert worst.used == pytest.approx(2)
    assert judgement.to_dict()["checks"][3] == {
        "what": "gyro_sensitivity_yy",
        "value": 1.02,
        "std": STD,
        "unit": "1",
        "limit": {"min": 0.99, "max": 1.01},
        "used": worst.used,
        "passed": False,
        "reason": "gyro_sensitivity_yy is 1.02, above its limit 1.01",
        "warning": "",
    }
    assert judgement.to_dict()["limits"]["path"].endswith("limits.json")
    assert judgement.summary().splitlines()[0] == f"fail: {worst.reason}"
    assert judgement.summary().endswith("limits.json are kept")


def test_a_permitted_verdict_is_not_the_check_closest_to_its_limit(tmp_path):
    fields = of_parameter("gyro_bias_x", min=-0.02, max=0.02) | {"verdict": "incomplete"}
    incomplete = unit(verdict="incomplete", reasons=("residuals exceed their noise",))
    judgement = limits_from_dict(tmp_path, fields).judge(incomplete)
    assert judgement.passed
    assert judgement.by_use[0].what == "gyro_bias_x"
    stricter = limits_from_dict(tmp_path, fields | {"verdict": "good"}).judge(incomplete)
    assert stricter.by_use[0].what == "verdict"


BAD_FILES = [
    ("", "is empty (0 bytes)"),
    ('{"schema": "imucal.limits/1",', "limits.json is not JSON: line 1"),
    ("[]", "the document has no schema, 'imucal.limits/1' is needed"),
    ('{"schema": "imucal.calibration/1"}', "has the schema 'imucal.calibration/1'"),
    ({}, "there is no limit, so every unit would pass"),
    ({"parameters": {}}, "$.parameters is empty: leave it out"),
    ({"control_set": {}}, "$.control_set is empty: leave it out"),
    ({"parameter": {}}, "$.parameter is no field of a limits file: is it parameters?"),
    (of_parameter("gyro_bais_x", max_std=1), "no parameter has this name: is it gyro_bias_x"),
    (of_parameter("gyro_bais_*", max_std=1), "no parameter has this name: is it gyro_bias_*"),
    (of_parameter("gyro_*", max_std=1), "$.parameters.gyro_*: no parameter has this name"),
    (of_parameter("gyro_bias_x", std_max=1), "gyro_bias_x.std_max is no field of a limits file: is it"),
    (of_parameter("accel_bias_x", max_std=1), "unit is 'rad/s': accel_bias_x is in m/s^2 or lsb"),
    (of_parameter("gyro_bias_x"), "the limit of gyro_bias_x has neither a range nor max_std"),
    (of_parameter("gyro_bias_x", min=0), "has only one end of its range: give min and max"),
    (of_parameter("gyro_bias_x", min=2, max=1), "has min 2.0 and max 1.0: min must be less than max"),
    (of_parameter("gyro_bias_x", min=1, max=1), "min must be less than max"),
    (of_parameter("gyro_bias_x", max_std=0), "has max_std 0.0: it must be positive"),
    (of_parameter("gyro_bias_x", min="a", max=1), '$.parameters.gyro_bias_x.min is "a", it must be a number'),
    ('{"schema": "imucal.limits/1", "effects": [], "effects": []}', "'effects' occurs twice in one object"),
    (
        of_figure("control_set", "chi2_per_dov", max=1),
        "chi2_per_dov is no field of a limits file: is it chi2",
    ),
    (of_figure("control_set", "chi2_per_dof", min=1), "chi2_per_dof may have max"),
    (of_figure("control_set", "chi2_per_dof", max=0), "the limit of control_set chi2_per_dof is 0.0"),
    (of_figure("control_set", "rests", min=2.5), "control_set rests is 2.5: a whole number is needed"),
    (of_figure("held_out", "chi2_per_dof", max=1), "$.held_out.chi2_per_dof is no field"),
    ({"effects": ["gyro_g_sens"]}, "there is no effect 'gyro_g_sens': is it gyro_g_sensitivity"),
    ({"effects": [], "description": 3}, "$.description is 3, it must be a string"),
]


@pytest.mark.parametrize(("content", "message"), BAD_FILES, ids=[message[:30] for _, message in BAD_FILES])
def test_a_bad_limits_file_ends_with_1_and_nothing_else_is_written(
    tmp_path, monkeypatch, capsys, content, message
):
    monkeypatch.chdir(tmp_path)
    text = content if isinstance(content, str) else json.dumps({"schema": "imucal.limits/1", **content})
    Path("limits.json").write_text(text)
    unit().save("unit.json")
    with pytest.raises(imucal.ImucalError) as caught:
        imucal.Limits.load("limits.json")
    assert message in str(caught.value)
    assert main(["limits", "check", "limits.json", "unit.json", "--csv", "day.csv", "--json", "d.json"]) == 1
    shown = capsys.readouterr()
    assert message in shown.err and shown.err.count("\n") == 1
    # The limits are read before the recording, which is not there.
    assert main(["calibrate", "run.csv", "--limits", "limits.json", "-o", "out.json"]) == 1
    assert message in capsys.readouterr().err
    # What --json asked for says why there is no result.
    assert message in json.loads(Path("d.json").read_text())["reasons"][0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.json", "limits.json", "unit.json"]
    if not isinstance(content, str):
        validator = jsonschema.Draft202012Validator(SCHEMA)
        # Names and contradictions of numbers are beyond a schema.
        beyond = ("no parameter", "no effect", "min must be", "accel_bias_x is in")
        valid = validator.is_valid({"schema": "imucal.limits/1", **content})
        assert valid == any(words in message for words in beyond)


def test_the_schema_takes_what_is_read_and_written(tmp_path):
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    limits = limits_from_dict(
        tmp_path,
        {
            "description": "all of it",
            **of_parameter("gyro_bias_*", min=-0.1, max=0.1, max_std=1e-3),
            **of_figure("calibration_set", "rests", min=20),
            **of_figure("control_set", "chi2_per_dof", max=3),
            **of_figure("held_out", "gravity_direction_rms_deg", max=0.5),
            "effects": ["gyro_g_sensitivity"],
        },
    )
    limits.save(tmp_path / "again.json")
    again = imucal.Limits.load(tmp_path / "again.json")
    assert dataclasses.replace(again, source=limits.source) == limits
    jsonschema.validate(
        json.loads((tmp_path / "again.json").read_text()), SCHEMA, jsonschema.Draft202012Validator
    )


def test_limits_of_a_users_effect(tmp_path):
    own = imucal.UserEffect(
        "gyro_bias_supply",
        "gyroscope",
        tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz"),
        lambda state: np.zeros((len(state.time_s), 3, 3)),
    )
    values = imucal.EffectValues("gyro_bias_supply", [0.1, 0.2, 0.3])
    fields = {"parameters": {"gyro_bias_supply_*": {"unit": "rad/s/V", "min": 0, "max": 0.25}}}
    with pytest.raises(imucal.FormatError, match="no parameter has this name"):
        limits_from_dict(tmp_path, fields)
    judgement = limits_from_dict(tmp_path, fields, user_effects=[own]).judge(
        unit(effects=(values,), user_effects=(own,))
    )
    assert judgement.reasons == ("gyro_bias_supply_z is 0.3 rad/s/V, above its limit 0.25",)
    # The command knows such effects from the calibration files.
    unit(effects=(values,), user_effects=(own,)).save(tmp_path / "unit.json")
    assert main(["limits", "check", str(tmp_path / "limits.json"), str(tmp_path / "unit.json")]) == 2


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A folder with two short runs of one unit as CSV and its calibration."""
    folder = tmp_path_factory.mktemp("line")
    for name, seed in (("run", 1), ("control", 2)):
        imucal.write(imucal.simulate("random", seed=seed).recording, folder / f"{name}.csv")
    assert main(["calibrate", str(folder / "run.csv"), "-o", str(folder / "unit.json")]) == 0
    return folder


def write_limits(path, largest_deg):
    figure = {"gravity_direction_rms_deg": {"max": largest_deg}}
    path.write_text(json.dumps({"schema": "imucal.limits/1", "control_set": figure, "held_out": figure}))
    return str(path)


@pytest.mark.parametrize(("largest_deg", "code"), [(0.5, 0), (0.001, 2)])
def test_calibrate_with_limits(line, tmp_path, capsys, largest_deg, code):
    run, control = str(line / "run.csv"), str(line / "control.csv")
    limits = write_limits(tmp_path / "limits.json", largest_deg)
    output = ["-o", str(tmp_path / "unit.json"), "--json", str(tmp_path / "result.json")]
    arguments = ["calibrate", run, "--control", control, "--folds", "2", "--limits", limits, *output]
    assert main(arguments) == code
    shown = capsys.readouterr().out
    document = json.loads((tmp_path / "result.json").read_text())
    assert document["verdict"] == ("poor" if code else "good")
    assert document["judgement"]["passed"] == (code == 0)
    assert len(document["judgement"]["checks"]) == 2
    assert len(document["reasons"]) == (2 if code else 0)
    assert f"{0 if code else 2} of 2 limits of {limits} are kept" in shown
    assert shown.count("FAIL") == (2 if code else 0) and "pass" not in shown
    assert imucal.Calibration.load(tmp_path / "unit.json").control_set is not None
    if not code:
        assert main([*arguments, "--verbose"]) == 0
        assert capsys.readouterr().out.count("pass") == 2


def test_without_limits_there_is_no_judgement(line, tmp_path):
    output = ["--json", str(tmp_path / "result.json")]
    assert main(["evaluate", str(line / "unit.json"), str(line / "control.csv"), *output]) == 0
    assert json.loads((tmp_path / "result.json").read_text())["judgement"] is None


def test_evaluate_judges_the_new_figures(line, tmp_path, capsys):
    path = tmp_path / "limits.json"
    for largest, code in ((0.5, 0), (0.001, 2)):
        figure = of_figure("control_set", "gravity_direction_rms_deg", max=largest)
        path.write_text(json.dumps({"schema": "imucal.limits/1", **figure}))
        arguments = [str(line / "unit.json"), str(line / "control.csv"), "--limits", str(path)]
        assert main(["evaluate", *arguments, "--json", str(tmp_path / "result.json")]) == code
        document = json.loads((tmp_path / "result.json").read_text())
        value = document["judgement"]["checks"][0]["value"]
        assert value == document["control_set"]["after"]["gravity_direction_rms_deg"]
        assert (document["verdict"] == "poor") == (code == 2) == ("FAIL" in capsys.readouterr().out)


def test_the_result_says_it_in_words(line, tmp_path):
    result = imucal.calibrate(imucal.read(line / "run.csv"))
    judged = result.judged_by(limits_from_dict(tmp_path, of_figure("control_set", "chi2_per_dof", max=9)))
    assert (result.verdict, judged.verdict) == ("good", "poor")
    assert judged.summary().splitlines()[-2].startswith("0 of 1 limits of ")
    assert judged.summary().endswith("verdict: poor; there is no control recording: give one with --control")


def test_the_table_of_a_day(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    unit().save("a.json")
    unit(gyro_bias=(0.05, 0.03, 0.0), serial_number=None).save("b.json")
    poor = {**GOOD, "chi2_per_dof": 1e4, "rests": 40, "moves": 39}
    unit(calibration_set=poor, serial_number="0044").save("c.json")
    limits_from_dict(tmp_path, of_parameter("gyro_bias_*", min=-0.02, max=0.02))
    options = ["--csv", "day.csv", "--json", "day.json"]
    assert main(["limits", "check", "limits.json", "a.json", *options]) == 0
    assert capsys.readouterr().out.endswith("verdict: good\n")
    assert main(["limits", "check", "limits.json", "a.json", "b.json", "c.json", *options]) == 2
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert shown[1] == ["0042", "good", "0", "gyro_bias_x", "0.01", "-0.02", "to", "0.02", "rad/s"]
    assert shown[2] == ["b.json", "poor", "2", "gyro_bias_x", "0.05", "-0.02", "to", "0.02", "rad/s"]
    assert shown[3][:3] == ["0044", "poor", "0"]
    with pytest.raises(imucal.InputError, match=r"\$\.calibration_set\.chi2_per_dof is \"large\""):
        unit(calibration_set={**poor, "chi2_per_dof": "large"}).save("d.json")
    with Path("day.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["serial_number"], row["file"], row["verdict"]) for row in rows] == [
        ("0042", "a.json", "good"),
        ("", "b.json", "poor"),
        ("0044", "c.json", "poor"),
    ]
    assert rows[1]["reasons"] == (
        "gyro_bias_x is 0.05 rad/s, above its limit 0.02; gyro_bias_y is 0.03 rad/s, above its limit 0.02"
    )
    assert "residuals are 100 times what noise explains" in rows[2]["reasons"]
    document = json.loads(Path("day.json").read_text())
    assert document["verdict"] == "poor"
    assert [each["judgement"]["passed"] for each in document["units"]] == [True, False, True]


def test_a_file_that_cannot_be_read_is_a_row_and_the_others_are_judged(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    unit().save("a.json")
    unit(gyro_bias=(0.05, 0.0, 0.0), serial_number="0043").save("c.json")
    Path("b.json").write_text(Path("a.json").read_text()[:500])
    limits_from_dict(tmp_path, of_parameter("gyro_bias_*", min=-0.02, max=0.02))
    files = ["a.json", "b.json", "none.json", "c.json"]
    assert main(["limits", "check", "limits.json", *files, "--csv", "day.csv", "--json", "day.json"]) == 1
    shown = capsys.readouterr().out
    assert "no result: b.json is not JSON: line" in shown
    assert "verdict: no_result; 2 of 4 files cannot be checked; 1 of 4 units do not pass\n" in shown
    with Path("day.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["file"], row["verdict"], row["checks"]) for row in rows] == [
        ("a.json", "good", "3"),
        ("b.json", "no_result", "0"),
        ("none.json", "no_result", "0"),
        ("c.json", "poor", "3"),
    ]
    assert "none.json: there is no such file" in rows[2]["reasons"]
    document = json.loads(Path("day.json").read_text())
    assert document["verdict"] == "no_result"
    assert [each["judgement"] is None for each in document["units"]] == [False, True, True, False]


def test_a_unit_that_is_given_twice_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("a.json", "b.json"):
        unit().save(name)
    unit(serial_number="0043").save("c.json")
    limits_from_dict(tmp_path, of_parameter("gyro_bias_*", min=-0.02, max=0.02))
    files = ["a.json", "b.json", "c.json", str(tmp_path / "c.json")]
    assert main(["limits", "check", "limits.json", *files, "--json", "day.json"]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning: ")]
    assert said == [
        f"warning: {tmp_path / 'c.json'} is given twice, so it is one unit counted twice",
        "warning: the serial number 0042 occurs in a.json and b.json, which count as 2 units",
    ]
    assert len(json.loads(Path("day.json").read_text())["warnings"]) == 2


@pytest.mark.slow
def test_a_first_limits_file_from_good_units(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(5)
    names = [f"good-{number}.json" for number in range(30)]
    for name in names:
        accelerometer = imucal.Triad(np.eye(3) + _symmetric(random, 0.01), random.normal(size=3, scale=0.1))
        gyroscope = imucal.Triad(
            np.eye(3) + random.normal(size=(3, 3), scale=0.01), random.normal(size=3, scale=0.01)
        )
        figures = {
            **GOOD,
            "gravity_norm_rms_mps2": 1e-3 * (1 + 0.1 * random.random()),
            "rests": 40,
            "moves": 39,
        }
        unit(
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            calibration_set=figures,
            control_set=None,
            serial_number=name,
        ).save(name)
    assert main(["limits", "template", *names, "-o", "limits.json", "--deviations", "3"]) == 0
    assert "mean +- 3 standard deviations of 30 units" in capsys.readouterr().out
    document = json.loads(Path("limits.json").read_text())
    jsonschema.validate(document, SCHEMA, jsonschema.Draft202012Validator)
    biases = [imucal.Calibration.load(name).gyroscope.bias[0] for name in names]
    limit = document["parameters"]["gyro_bias_x"]
    assert limit["min"] == pytest.approx(np.mean(biases) - 3 * np.std(biases, ddof=1), abs=3e-4)
    assert limit["max"] == pytest.approx(np.mean(biases) + 3 * np.std(biases, ddof=1), abs=3e-4)
    assert (limit["unit"], limit["max_std"]) == ("rad/s", 2 * STD)
    assert len(document["parameters"]) == 21
    assert (document["effects"], "control_set" in document) == ([], False)
    assert document["calibration_set"]["rests"] == {"min": 40}
    assert main(["limits", "check", "limits.json", *names]) == 0
    unit(gyro_bias=(0.1, 0.0, 0.0)).save("bad.json")
    assert main(["limits", "check", "limits.json", "bad.json"]) == 2


def _symmetric(random, scale):
    matrix = random.normal(size=(3, 3), scale=scale)
    return matrix + matrix.T


@pytest.mark.parametrize(
    ("units", "deviations", "message"),
    [
        ([unit()], 4, "1 unit has no spread"),
        ([unit(), unit()], 4, "unit 1 and unit 2 have the same parameter values"),
        ([unit(), unit((0.02, 0, 0))], 4, "the serial number 0042 occurs 2 times"),
        ([unit(), unit((0.02, 0, 0), serial_number="0043")], 4, "accel_bias_x is the same in all units"),
        (
            [
                unit(),
                unit(
                    (0.02, 0, 0),
                    serial_number=None,
                    control_set={**GOOD, "rests": 20, "moves": 19, "chi2_per_dof": 400.0},
                ),
            ],
            4,
            "unit 2 is not good .control set: residuals are 20 times",
        ),
        ([unit(), unit((0.02, 0, 0), gyro_unit="lsb")], 4, "unit 2 has other parameters than unit 1"),
        ([unit(), unit((0.02, 0, 0))], -1, "the number of standard deviations is -1"),
    ],
)
def test_units_that_give_no_limits(units, deviations, message):
    with pytest.raises(imucal.InputError, match=message):
        limits_from(units, deviations=deviations)
