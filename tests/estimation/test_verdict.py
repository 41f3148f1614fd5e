"""The three verdicts: good if noise explains the residuals, incomplete if the model lacks something, poor."""

import json
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.cli import main

G_SENSITIVITY = {
    "gyro_g_sensitivity": np.radians([0.01, 0.03, 0.08, -0.16, 0.0, 0.1, -0.08, -0.1, 0.03]) / 9.80665
}


def run_of(seed, moves=30, **options):
    program = imucal.Program.random(seed=seed, moves=moves, hold_s=2.0)
    recording = imucal.simulate(program, seed=seed, rate_hz=100, **options).recording
    return replace(recording, stand_rad=None, name=f"run-{seed}")


@pytest.fixture(scope="module")
def lacking():
    """A run and a control run of a unit with a g-sensitivity, and the result of a calibration without it."""
    run, control = run_of(1, effects=G_SENSITIVITY), run_of(2, effects=G_SENSITIVITY)
    return run, control, imucal.calibrate(run, control=control)


def above(residuals):
    return {own.kind for own in residuals if own.exceeds_noise}


def test_a_missing_effect_makes_the_verdict_incomplete_and_is_given_beside_its_noise(lacking):
    _, _, result = lacking
    assert result.verdict == result.calibration.verdict == "incomplete"
    assert above(result.residuals) == {"moves", "rates"}
    assert above(result.control.residuals) == {"moves"}
    moves = next(own for own in result.residuals if own.kind == "moves")
    assert moves.unit == "deg" and moves.ratio == pytest.approx(moves.rms / moves.noise)
    assert f"{moves.rms:.3g} deg rms (noise {moves.noise:.3g} deg)" in result.reasons[0]
    assert "imucal gap FILE --control CONTROL" in result.reasons[0]
    assert result.summary().splitlines()[-1] == "; ".join(("verdict: incomplete", *result.reasons))


def test_with_the_effect_in_the_model_the_verdict_is_good(lacking):
    run, control, _ = lacking
    completed = imucal.calibrate(run, control=control, effects=["gyro_g_sensitivity"])
    assert (completed.verdict, completed.reasons) == ("good", ())
    gap = imucal.find_gap(run, control=control, candidates=["gyro_g_sensitivity"])
    assert gap.calibration.judged == ("good", ())
    assert gap.to_dict()["calibration_verdict"] == {"verdict": "good", "reasons": []}
    assert "calibration with the effects: good" in gap.summary().splitlines()


@pytest.mark.parametrize("joint", [True, False])
def test_lost_samples_that_bias_the_scale_are_not_good(joint):
    run = run_of(3)
    keep = np.arange(len(run)) % 100 != 50
    lost = replace(
        run,
        time_s=np.arange(keep.sum()) / 100.0,
        specific_force=run.specific_force[keep],
        angular_rate=run.angular_rate[keep],
    )
    try:
        result = imucal.calibrate(lost, joint=joint)
    except imucal.InputError:
        return
    assert result.verdict in ("incomplete", "poor")
    assert "moves" in above(result.residuals)


def test_a_short_calibration_is_good_on_a_long_control_run():
    """The uncertainty of the calibration explains the residuals, which are several times the noise."""
    short = imucal.calibrate(run_of(9, moves=12))
    judged = imucal.evaluate(short.calibration, run_of(10, moves=60))
    assert judged.verdict == "good"
    known = replace(short.calibration, covariance=None, covariance_names=())
    ratios = [
        [own.ratio for own in imucal.evaluate(c, run_of(10, moves=60)).residuals]
        for c in (known, short.calibration)
    ]
    assert max(ratios[0]) > 1.5 > max(ratios[1])


def test_a_calibration_that_makes_the_unit_worse_is_poor(lacking):
    _, control, result = lacking
    good = result.calibration
    shifted = good.gyroscope.bias + np.array([0.3, 0.0, 0.0])
    worse = replace(good, gyroscope=imucal.Triad(good.gyroscope.sensitivity, shifted))
    judged = imucal.evaluate(worse, replace(control, angular_rate=control.angular_rate - good.gyroscope.bias))
    assert judged.verdict == "poor"
    assert any("this calibration makes the unit worse" in reason for reason in judged.reasons)


def test_rates_that_no_sensor_measures_and_directions_lost_in_noise_are_poor(lacking):
    _, control, result = lacking
    good = result.calibration
    triad = imucal.Triad(good.gyroscope.sensitivity / 5000.0, good.gyroscope.bias)
    judged = imucal.evaluate(replace(good, gyroscope=triad, covariance=None, covariance_names=()), control)
    assert judged.verdict == "poor"
    assert "more than the 20000 deg/s of the fastest sensors" in "; ".join(judged.reasons)
    noisy = control.angular_rate + np.random.default_rng(1).normal(0.0, 1.5, control.angular_rate.shape)
    judged = imucal.evaluate(good, replace(control, angular_rate=noisy))
    assert judged.verdict == "poor"
    assert "(more than 5): the gyroscope is not judged" in "; ".join(judged.reasons)


@pytest.fixture(scope="module")
def files(lacking, tmp_path_factory):
    folder = tmp_path_factory.mktemp("verdict")
    run, control, result = lacking
    imucal.write(run, folder / "run.parquet")
    imucal.write(control, folder / "control.parquet")
    result.calibration.save(folder / "cal.json")
    return folder


def test_require_good_makes_incomplete_an_exit_code(files, tmp_path, capsys):
    document = tmp_path / "result.json"
    calibrate = ["calibrate", str(files / "run.parquet"), "--json", str(document)]
    evaluate = ["evaluate", str(files / "cal.json"), str(files / "control.parquet"), "--json", str(document)]
    for command in (calibrate, evaluate):
        assert main(command) == 0
        told = json.loads(document.read_text())
        assert told["verdict"] == "incomplete" and told["reasons"]
        assert {"kind", "rms", "noise", "unit", "ratio", "exceeds_noise"} <= told["residuals"][0].keys()
        assert main([*command, "--require", "incomplete"]) == 0
        assert main([*command, "--require", "good"]) == 2
        assert "verdict: incomplete; " in capsys.readouterr().out
    assert main([*calibrate, "--effect", "gyro_g_sensitivity", "--require", "good"]) == 0


def test_a_file_keeps_its_verdict_and_an_export_warns(files, capsys):
    loaded = imucal.Calibration.load(files / "cal.json")
    assert loaded.verdict == "incomplete" and loaded.reasons
    assert main(["export", str(files / "cal.json"), "--to", "kalibr", "-o", str(files / "k.yaml")]) in (0, 1)
    assert main(["export", str(files / "cal.json"), "--to", "c-header", "-o", str(files / "c.h")]) == 0
    assert "warning: this calibration is incomplete: calibration set: residuals" in capsys.readouterr().err
    text = json.loads((files / "cal.json").read_text())
    del text["verdict"], text["reasons"]
    (files / "older.json").write_text(json.dumps(text))
    assert imucal.Calibration.load(files / "older.json").judged == ("good", ())
    (files / "contradicts.json").write_text(json.dumps({**text, "verdict": "incomplete", "reasons": []}))
    with pytest.raises(imucal.FormatError, match="is incomplete with 0 reasons"):
        imucal.Calibration.load(files / "contradicts.json")


def test_limits_can_require_a_verdict(lacking, files, tmp_path, capsys):
    _, control, result = lacking
    limits = imucal.Limits(verdict="good")
    limits.save(tmp_path / "limits.json")
    assert imucal.Limits.load(tmp_path / "limits.json").verdict == "good"
    judged = result.judged_by(limits)
    assert judged.verdict == "poor"
    assert judged.reasons[0].startswith("the verdict is incomplete, good is required: calibration set: ")
    assert imucal.Limits(verdict="incomplete").judge(result).passed
    assert (
        imucal.evaluate(result.calibration, control).judged_by(limits, result.calibration).verdict == "poor"
    )
    check = ["limits", "check", str(tmp_path / "limits.json"), str(files / "cal.json")]
    assert main(check) == 2
    assert "at least good" in capsys.readouterr().out
    imucal.Limits(verdict="incomplete").save(tmp_path / "limits.json")
    assert (main(check), main([*check, "--require", "good"])) == (0, 2)
    (tmp_path / "limits.json").write_text('{"schema": "imucal.limits/1", "verdict": "poor"}')
    with pytest.raises(imucal.FormatError, match=r"verdict"):
        imucal.Limits.load(tmp_path / "limits.json")
    with pytest.raises(imucal.InputError, match="give good or incomplete"):
        imucal.Limits(verdict="poor")


@pytest.mark.parametrize(("lost", "code"), [(1, "residuals_above_noise"), (20, "irregular_clock")])
def test_a_single_lost_sample_is_not_the_reason_for_residuals_of_all_moves(lost, code):
    effects = {"gyro_scale_quadratic": [3e-4, 3e-4, 3e-4]}
    recording = imucal.simulate("random", seed=3, rate_hz=100.0, effects=effects).recording
    kept = np.ones(len(recording.time_s), dtype=bool)
    for move in imucal.calibrate(recording).moves[:lost]:
        kept[(move.first + move.last) // 2] = False
    columns = (recording.time_s, recording.specific_force, recording.angular_rate)
    (reason,) = imucal.calibrate(imucal.Recording(*(column[kept] for column in columns))).reasons
    assert reason.endswith(f"[{code}]")
