"""Sentences on the result of a search, made from results that are put together by hand."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.gap import notes
from imucal.gap.laws.law import Law
from imucal.gap.remainder import Remainder
from imucal.gap.sizes import for_people
from imucal.report import write_gap_page

CHANNEL = {
    **{"channel": "move_direction", "axis": "x", "unit": "rad", "rms": 3.3e-4, "noise_rms": 2e-4},
    **{"times_noise": 1.8, "times_noise_after": 1.7, "stands_out": True},
}
WHERE = {"channels": [CHANNEL], "rests": [], "moves": [], "turns_about": None, "depends": []}
FAULT = {"name": "noise_grows_in_motion", "sensor": None, "parameters": ()}
EFFECT = {
    "name": "gyro_g_sensitivity",
    "sensor": "gyroscope",
    "parameters": ({"name": "xx", "value": 1e-4, "std": 1e-5, "unit": "rad/s/(m/s^2)"},),
}
NOTHING = Remainder("nothing", None, None, None, 0.3, False)
UNUSUAL = replace(NOTHING, p_value=1e-14)


def found(verdict="named", effects=(EFFECT,), remainder=NOTHING, where=WHERE, **fields):
    return imucal.Gap(verdict, effects=effects, remainder=remainder, where=where, **fields)


def page_of(gap, folder):
    write_gap_page(folder / "gap.html", gap)
    return (folder / "gap.html").read_text(encoding="utf-8")


LAW = Law(
    "gyro_law_w",
    "gyro_law_w = gyro: k*tanh(w/0.26)",
    "gyroscope",
    ("w",),
    ({"name": "k_x", "value": np.radians(0.4), "std": np.radians(0.02), "unit": "rad/s"},),
    1440.0,
    1.0,
    {"move_direction": 0.97},
    (),
    None,
)


def test_a_law_is_described_in_the_units_of_datasheets(tmp_path):
    gap = found("unknown", (), laws=(LAW,))
    line = f"law: {LAW.formula} with k_x = 0.4 ± 0.02 deg/s; closes 97 % of the gap"
    assert line in gap.summary().splitlines()
    row = page_of(gap, tmp_path).partition(">k_<wbr>x<")[2].partition("</tr>")[0]
    assert re.findall(r">([^<>]+)</td>", row) == ["0.4", "0.02", "deg/s"]


def test_the_headline_says_how_much_a_law_describes(tmp_path):
    page = page_of(found("unknown", (), laws=(LAW,)), tmp_path)
    assert "no effect of the catalogue describes it, but a law does." in page
    assert f"{LAW.formula} (gyroscope)." in page
    left = Remainder("unknown", "gyro_scale", "rate", "the scale varies", 1e-9, True)
    page = page_of(found("unknown", (), left, laws=(LAW,)), tmp_path)
    assert "no effect of the catalogue describes it, but a law describes a part of it." in page
    assert f"{LAW.formula} (gyroscope). Remainder: the scale varies." in page


def test_a_fault_of_the_data_is_named_in_the_first_line_and_is_no_effect():
    lines = found("data_fault", (FAULT, {**FAULT, "name": "clock_irregular"})).summary().splitlines()
    assert lines[0] == "verdict: data_fault (noise_grows_in_motion, clock_irregular)"
    assert "residuals: direction after moves about x: 0.0189 deg rms, 1.8 x noise" in lines
    assert found("data_fault", ()).summary().startswith("verdict: data_fault\n")
    assert "(1.7 x with the effects)" in found().summary()


def test_the_page_of_a_fault_of_the_data_shows_no_effects(tmp_path):
    unknown = Remainder("unknown", "gyro_scale", "rate", "the scale varies", 1e-9, True)
    other = found("data_fault", (FAULT,), unknown, generic={"description": "the scale varies"})
    page = page_of(other, tmp_path)
    assert "noise_grows_in_motion." in page
    assert "with the effects" not in page and "with the found effects" not in page
    assert repr(other) == "Gap(data_fault, noise_grows_in_motion)"


def test_without_significant_residuals_the_recordings_are_named():
    quiet = {**WHERE, "channels": [{**CHANNEL, "stands_out": False}]}
    text = found("unknown", (), where=quiet).summary()
    assert "residuals: noise explains all kinds of residuals of the calibration recordings" in text


@pytest.mark.parametrize(
    ("remainder", "control_set", "exceeds", "words"),
    [
        (NOTHING, {}, False, "residuals of control recordings: p 0.3"),
        (
            UNUSUAL,
            {},
            False,
            "residuals of control recordings exceed their noise significantly (p below 1e-12), but by less "
            "than a factor of 2",
        ),
        (
            UNUSUAL,
            {},
            True,
            "residuals of control recordings exceed their noise significantly (p below 1e-12)",
        ),
        (
            UNUSUAL,
            None,
            False,
            "residuals of held-out rests and moves exceed their noise significantly (p below 1e-12), but "
            "those of the calibration recordings by less than a factor of 2",
        ),
    ],
)
def test_residuals_that_exceed_their_noise_by_less_than_two_are_said(remainder, control_set, exceeds, words):
    residuals = (SimpleNamespace(exceeds_noise=exceeds, text="moves"),)
    control = None if control_set is None else SimpleNamespace(residuals=residuals)
    fit = SimpleNamespace(
        control=control,
        residuals=residuals,
        verdict="good",
        calibration=SimpleNamespace(effects=("gyro_g_sensitivity",)),
    )
    before = dict.fromkeys(("chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg"))
    sets = None if control_set is None else {"before": before, "after": before}
    gap = found(remainder=remainder, control_set=sets, fits={"after": fit})
    assert f"remainder: nothing; {words}" in gap.summary().splitlines()


def test_the_page_says_that_residuals_exceed_their_noise(tmp_path):
    assert "Nothing: the residuals do not exceed their noise significantly (p 0.3)." in page_of(
        found(), tmp_path
    )
    page = page_of(found(remainder=UNUSUAL), tmp_path)
    assert "do not exceed their noise" not in page
    assert "exceed their noise significantly (p below 1e-12), but those of the calibration recordings" in page


def test_the_page_gives_a_p_value_once(tmp_path):
    words = "effects estimated with and without the stand differ (p below 1e-12)"
    page = page_of(found(remainder=Remainder("unknown", "encoder", "x", words, 1e-15, True)), tmp_path)
    assert f"Unknown: {words}." in page
    assert "(p below 1e-12) (p below" not in page


def test_the_ratio_of_a_channel_is_no_quotient_of_columns(tmp_path):
    page = page_of(found(), tmp_path)
    assert page.count("rms of residual / noise") >= 3
    assert "rms / noise" not in page


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("rad/s/(supply_v - 4.946)", (180 / np.pi, "deg/s per supply_v")),
        ("rad/s/(supply_v + 3)", (180 / np.pi, "deg/s per supply_v")),
        ("m/s^2/motor", (1e3 / 9.80665, "mg per motor")),
        ("rad/s/K", (180 / np.pi, "deg/s per K")),
        # Inputs in SI units keep their SI parameters.
        ("rad/s/w_norm", (1.0, "rad/s/w_norm")),
        ("rad/s/(supply_v - 3.3) ** 2", (1.0, "rad/s/(supply_v - 3.3) ** 2")),
        ("rad/s/(supply_v * motor)", (1.0, "rad/s/(supply_v * motor)")),
    ],
)
def test_a_size_per_column_is_in_the_unit_of_other_effects(unit, shown):
    value, name = for_people(1.0, unit)
    assert (value, name) == (pytest.approx(shown[0]), shown[1])


@pytest.mark.parametrize(
    ("degc", "words"),
    [
        (45.0, ["the control recordings are 20 K warmer than the calibration recordings"]),
        (15.0, ["the control recordings are 10 K colder than the calibration recordings"]),
        (29.0, []),
        (None, []),
    ],
)
def test_a_control_record_at_another_temperature_is_said(degc, words):
    def recordings(value):
        return [SimpleNamespace(temperature_degc=None if value is None else np.array([value, np.nan, value]))]

    question = SimpleNamespace(recordings=recordings(25.0), control=recordings(degc))
    said = list(notes._temperature_change(question))
    assert [line.partition(" (mean")[0] for line in said] == words


@pytest.mark.slow
def test_a_poor_control_record_at_another_temperature_is_said():
    effects = {"gyro_scale_temperature": 2e-3}
    runs = [
        imucal.simulate("tumble", seed=seed, rate_hz=50.0, effects=effects, temperature=degc).recording
        for seed, degc in ((1, 25), (2, 45))
    ]
    gap = imucal.find_gap(runs[0], control=runs[1], candidates=["gyro_g_sensitivity"])
    assert gap.fits["after"].control.verdict == "poor"
    assert "the control recordings are 20 K warmer than the calibration recordings" in gap.summary()
    as_warm = replace(runs[1], temperature_degc=np.full(len(runs[1].time_s), 25.0))
    same = imucal.find_gap(runs[0], control=as_warm, candidates=["gyro_g_sensitivity"])
    assert same.fits["after"].control.verdict == "poor"
    assert " warmer " not in same.summary()


def test_a_fault_that_remains_beside_effects_is_described():
    described = notes.fault_of("noise_grows_in_motion")
    assert described["description"].endswith("is larger inside moves than at rest [noise_grows_in_motion]")
    assert notes.fault_of("white") is None and notes.fault_of(None) is None


def test_the_advice_for_a_copied_control_record_can_be_followed(tmp_path, capsys):
    run = str(tmp_path / "run.csv")
    copy = str(tmp_path / "copy.csv")
    recording = imucal.simulate("tumble", seed=1, rate_hz=50.0).recording
    for path in (run, copy):
        imucal.write(recording, path)
    assert main(["gap", run, "--control", copy]) == 1
    said = capsys.readouterr().err
    assert "leave --control away: held-out rests and moves then verify the result" in said
    assert "folds" not in said
    assert main(["calibrate", run, "--control", copy]) == 1
    assert "use --folds instead of --control" in capsys.readouterr().err


def test_the_help_lists_verdicts_and_exit_codes(capsys):
    assert main(["gap", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for verdict in ("nothing_missing", "named", "ambiguous", "stochastic", "unknown", "data_fault"):
        assert verdict in shown
    assert "The exit code is 1 for data_fault. It is 2 for stochastic" in shown
    assert main(["--help"]) == 0
    assert "2 finished with a poor verdict or another result" in " ".join(capsys.readouterr().out.split())
