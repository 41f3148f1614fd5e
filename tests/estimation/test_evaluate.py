"""Judging on recordings that no fit has seen: what they cannot judge is never called good."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.cli import main

HEATED = {
    "rate_hz": 50,
    "temperature": imucal.Temperature.cycle(10.0, 40.0, 320.0),
    "effects": {"gyro_bias_temperature": "typical"},
}


@pytest.fixture(scope="module")
def heated():
    """A run and a control run of a unit whose gyroscope feels the temperature, and their calibration."""
    run, control = (imucal.simulate("random", seed=seed, **HEATED).recording for seed in (11, 12))
    control = replace(control, name="control.csv")
    return run, control, imucal.calibrate(run, effects=["gyro_bias_temperature"]).calibration


def without_a_temperature(recording, sample=2500):
    temperature = recording.temperature_degc.copy()
    temperature[sample] = np.nan
    return replace(recording, temperature_degc=temperature)


def test_a_control_recording_without_figures_is_poor_and_says_why(heated):
    run, control, calibration = heated
    control = without_a_temperature(control)
    judged = imucal.evaluate(calibration, control)
    assert judged.figures.chi2_per_dof is None
    assert judged.verdict == "poor"
    assert "no correction for 1 of 16000 samples of control.csv" in judged.reasons[0]
    assert "the first is sample 2500" in judged.reasons[0]
    assert "temp_degc" in judged.reasons[0]
    assert imucal.calibrate(run, control=control, effects=["gyro_bias_temperature"]).verdict == "poor"
    with pytest.raises(imucal.InputError, match=r"nothing is judged: .* of control.csv"):
        imucal.find_gap(run, control=control, candidates=["gyro_bias_temperature"])
    with pytest.raises(imucal.InputError, match=r"nothing is judged: .* of control.csv"):
        imucal.find_gap(run, control=control, candidates=["accel_lever_arm"], calibration=calibration)


def test_an_effect_too_large_to_be_undone_is_poor(heated):
    _, control, calibration = heated
    large = imucal.EffectValues("gyro_scale_quadratic", np.array([50.0, 0.0, 0.0]))
    calibration = replace(calibration, effects=(large,), covariance=None, covariance_names=())
    judged = imucal.evaluate(calibration, control)
    assert judged.verdict == "poor"
    assert "too large to be removed" in judged.reasons[0]


@pytest.mark.slow
def test_what_could_not_be_judged_is_said(heated, tmp_path, capsys, monkeypatch):
    run, control, calibration = heated
    limit = np.radians(80.0)
    control = replace(control, angular_rate=np.clip(control.angular_rate, -limit, limit))
    monkeypatch.chdir(tmp_path)
    imucal.write(run, "run.csv")
    imucal.write(control, "control.csv")
    calibration.save("cal.json")
    for words in ("evaluate cal.json control.csv", "calibrate run.csv --control control.csv"):
        main(words.split())
        assert "[gyro_saturation]" in capsys.readouterr().out
    main(["gap", "run.csv", "--control", "control.csv", "--effect", "gyro_bias_temperature"])
    assert "[gyro_saturation]" in capsys.readouterr().out
    main(["evaluate", "cal.json", "control.csv"])
    assert "46 rests, 3 of 45 moves evaluated\n" in capsys.readouterr().out
    assert "[gyro_saturation]" in imucal.calibrate(run, control=control).summary()


def test_the_recording_that_the_calibration_was_made_of_is_noticed(heated, tmp_path, capsys, monkeypatch):
    run, control, _ = heated
    monkeypatch.chdir(tmp_path)
    imucal.write(run, "run.csv")
    imucal.write(control, "control.csv")
    assert main(["calibrate", "run.csv", "--effect", "gyro_bias_temperature", "-o", "cal.json"]) == 0
    (tmp_path / "run.csv").rename("copy.csv")
    capsys.readouterr()
    main(["evaluate", "cal.json", "control.csv", "copy.csv"])
    shown = capsys.readouterr().out
    assert shown.count("this calibration was estimated from the same file") == 1
    assert "warning: copy.csv: this calibration was estimated from the same file" in shown


def test_results_are_one_line_where_they_are_shown(heated):
    run, control, calibration = heated
    result = imucal.calibrate(run, control=control, effects=["gyro_bias_temperature"])
    gap = imucal.find_gap(run, control=control, candidates=["gyro_bias_temperature"])
    for shown, begin, end in (
        (imucal.evaluate(calibration, control), "Evaluation(good: 46 of 46 rests and 45 of 45 moves ju", ")"),
        (
            result,
            "CalibrationResult(good: 46 of 46 rests and 45 of 45 moves used; control set: gravity norm error",
            ")",
        ),
        (gap, "Gap(named, gyro_bias_temperature; chi2_per_dof ", " on unseen data)"),
    ):
        assert repr(shown).startswith(begin)
        assert repr(shown).endswith(end)
        assert len(repr(shown)) < 250
        assert "\n" not in repr(shown)


def test_what_is_no_recording_or_no_calibration_is_refused_with_the_way_out(heated):
    run, _, calibration = heated
    result = imucal.calibrate(run)
    for use, message in (
        (lambda: imucal.calibrate("run.csv"), r"give a Recording, imucal.read\('run.csv'\)"),
        (lambda: imucal.calibrate([Path("run.csv")]), r"imucal.read\('run.csv'\)"),
        (lambda: imucal.calibrate(run, control="c.csv"), r"imucal.read\('c.csv'\)"),
        (lambda: imucal.calibrate(imucal.simulate("grid", seed=1, rate_hz=50)), "its `recording`"),
        (lambda: imucal.calibrate(run.specific_force), "a ndarray is given where a Recording is needed"),
        (lambda: imucal.evaluate(run, calibration), "the calibration first"),
        (lambda: imucal.evaluate("cal.json", run), r"imucal.Calibration.load\('cal.json'\)"),
        (lambda: imucal.evaluate(result, run), "give its `calibration`"),
        (lambda: imucal.evaluate(calibration, "run.csv"), r"imucal.read\('run.csv'\)"),
        (lambda: imucal.find_gap(run, control=Path("c.csv")), r"imucal.read\('c.csv'\)"),
        (lambda: imucal.find_gap(run, calibration="cal.json"), r"imucal.Calibration.load\('cal.json'\)"),
        (lambda: imucal.noise([run]), "a list is given where a Recording is needed: give them one by one"),
        (lambda: imucal.inspect("run.csv"), r"imucal.read\('run.csv'\)"),
    ):
        with pytest.raises(imucal.InputError, match=message):
            use()
    assert imucal.calibrate(r for r in [run]).calibration is not None


def test_temperatures_beyond_the_calibration_are_said_and_the_advice_removes_the_finding(heated):
    _, control, calibration = heated
    of_warm_runs = replace(calibration, temperature_range_degc=(25.0, 40.0))
    (said,) = imucal.evaluate(of_warm_runs, control).findings
    assert (said.code, said.severity, said.columns) == ("temperature_extrapolated", "warning", ("temp_degc",))
    assert "gyro_bias_temperature are extrapolated" in said.message
    assert said.value == pytest.approx(10.0, abs=0.1)
    # The advice is to evaluate within the range, or to use a calibration that covers the recording.
    warm = HEATED | {"temperature": imucal.Temperature.cycle(26.0, 39.0, 320.0)}
    within = imucal.simulate("random", seed=13, **warm).recording
    assert imucal.evaluate(of_warm_runs, within).findings == ()
    assert imucal.evaluate(calibration, control).findings == ()


@pytest.mark.parametrize(
    ("change", "late", "code", "words"),
    [
        (lambda w: w * [-1, 1, 1], 0, "left_handed_axes", "gyro_x is reversed"),
        (lambda w: w[:, [1, 0, 2]], 0, "left_handed_axes", "gyro_x and gyro_y are exchanged"),
        (lambda w: 0.5 * w, 0, "gyro_units", "the sample rate is wrong by this factor"),
        (lambda w: w + np.array([0, 0, 1.7]), 0, "gyro_units", "looks like deg/s"),
        (lambda w: w, 90, "sensors_not_together", "time stamps"),
    ],
)
def test_the_cause_in_a_control_recording_is_named_as_calibrate_names_it(change, late, code, words):
    run, control = (imucal.simulate("random", seed=seed).recording for seed in (1, 2))
    wrong = imucal.Recording(
        control.time_s[late:],
        control.specific_force[late:],
        change(control.angular_rate)[: len(control) - late],
        name="control.csv",
    )
    result = imucal.calibrate(run)
    assert not [f for f in imucal.evaluate(result.calibration, control).findings if "gyro_x" in f.columns]
    for findings in (
        imucal.evaluate(result.calibration, wrong).findings,
        imucal.calibrate(run, control=wrong).control.findings,
    ):
        (finding,) = [finding for finding in findings if finding.recording == "control.csv"]
        assert (finding.code, finding.severity) == (code, "warning")
        assert words in f"{finding.message}: {finding.way_out}"
