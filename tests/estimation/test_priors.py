"""Models of fewer parameters: held parameters with a prior, on six faces of a box."""

from __future__ import annotations

import dataclasses
import re
import shlex

import numpy as np
import pytest

import imucal
from imucal.cli.app import main

# Turns of the motors from face to face, deg: z, y, x, -z, -y and -x up, with errors of a degree.
FACES = (
    (0.6, -1.1, 0.4),
    (90.7, 0.9, -0.8),
    (-1.2, 0.5, 91.1),
    (89.1, 1.3, -0.6),
    (0.8, 90.4, 1.2),
    (1.1, -0.7, 88.9),
)
STEPS = tuple(imucal.Step(turn, 2.0 if k else 1.0, 3.0) for k, turn in enumerate(FACES))
# Turns about x and y alone, as of a box that is tipped over its edges and never turned about z, deg.
TIPPED = ((0, 1, 0), (90, 0, 1), (90, 1, 0), (90, 0, 0), (90, 90, 0), (0, 180, 1))
TIPPED_STEPS = tuple(imucal.Step(turn, 2.0 if k else 1.0, 3.0) for k, turn in enumerate(TIPPED))


def unit_of() -> imucal.Unit:
    profile = imucal.Unit.named("bmi088")
    accel = np.array([[1.01, 0.008, -0.004], [0.008, 0.985, 0.006], [-0.004, 0.006, 1.02]])
    gyro = np.array([[0.99, 0.01, -0.005], [-0.008, 1.01, 0.004], [0.006, 0.002, 1.005]])
    return dataclasses.replace(
        profile,
        accelerometer=dataclasses.replace(
            profile.accelerometer, sensitivity=accel, bias=np.array([0.2, -0.1, 0.3])
        ),
        gyroscope=dataclasses.replace(
            profile.gyroscope, sensitivity=gyro, bias=np.array([0.01, -0.02, 0.015])
        ),
    )


def recorded(program: imucal.Program, seed: int) -> imucal.Recording:
    return imucal.simulate(program, unit=unit_of(), seed=seed, rate_hz=100.0).recording


@pytest.fixture(scope="module")
def run() -> imucal.Recording:
    """A run that determines all parameters."""
    return recorded(imucal.Program.random(seed=3, moves=18, hold_s=3.0), 3)


@pytest.fixture(scope="module")
def recording() -> imucal.Recording:
    return recorded(imucal.Program(STEPS), 1)


@pytest.fixture(scope="module")
def result(recording: imucal.Recording) -> imucal.CalibrationResult:
    return imucal.calibrate(recording, model="orthogonal")


def test_six_faces_determine_bias_and_scale(result: imucal.CalibrationResult) -> None:
    truth = {
        "accel_bias_x": 0.2,
        "accel_bias_y": -0.1,
        "accel_bias_z": 0.3,
        "accel_sensitivity_xx": 1.01,
        "accel_sensitivity_yy": 0.985,
        "accel_sensitivity_zz": 1.02,
        "gyro_bias_x": 0.01,
        "gyro_sensitivity_xx": 0.99,
        "gyro_sensitivity_zz": 1.005,
    }
    for parameter in result.parameters:
        if parameter.name in truth:
            assert parameter.std is not None
            assert abs(parameter.value - truth[parameter.name]) < 4 * parameter.std, parameter
            assert parameter.std < 0.02 * max(1.0, abs(parameter.value))


def test_the_prior_is_in_covariance_words_and_verdict(result: imucal.CalibrationResult) -> None:
    priors = result.fit.priors
    assert priors is not None and priors.model == "orthogonal" and len(priors.held) == 9
    assert [share.name for share in priors.shares] == [p.name for p in result.parameters]
    unknown = [held for held in priors.held if held.prior_share > 0.9]
    assert unknown
    for held in unknown:
        assert held.prior_source == "default" and 0.5 * held.prior_sigma < held.sigma < held.prior_sigma
    assert result.verdict == "incomplete"
    assert any("which have the default prior" in reason for reason in result.reasons)
    assert 0.1 < priors.gravity_direction_deg < 1.5
    summary = result.summary()
    assert "held by the prior 0 +- 0.01 rad (default for MEMS sensors)" in summary
    assert "in the direction of gravity" in summary


def test_a_narrow_given_prior_nearly_fixes_the_parameter(recording: imucal.Recording) -> None:
    hold = {
        "accel_misalignment": (None, 1e-6),
        "gyro_misalignment": None,
        "accel_misalignment_xy": (0.008, 1e-6),
    }
    result = imucal.calibrate(recording, hold=hold)
    values = {held.name: held for held in result.fit.priors.held}
    assert values["accel_misalignment_xy"].estimate == pytest.approx(0.008, abs=5e-6)
    assert values["accel_misalignment_xz"].prior_source == "given"
    assert values["gyro_misalignment_zx"].prior_sigma == 0.015


def test_the_width_comes_from_the_units_profile(recording: imucal.Recording) -> None:
    result = imucal.calibrate(recording, model="orthogonal", unit="bmi088")
    held = {held.name: held for held in result.fit.priors.held}
    assert held["accel_misalignment_xy"].prior_source == "unit"
    assert held["accel_misalignment_xy"].prior_sigma == pytest.approx(0.005 / np.sqrt(2.0))
    assert held["gyro_misalignment_xy"].prior_sigma == pytest.approx(np.hypot(0.01, 0.005 / np.sqrt(2.0)))
    assert not any("default prior" in reason for reason in result.reasons)


def test_a_prior_that_contradicts_the_recordings_is_noticed(run: imucal.Recording) -> None:
    free = imucal.calibrate(run)
    xy = next(p for p in free.parameters if p.name == "accel_sensitivity_xy").value
    wrong = imucal.calibrate(run, hold=[f"accel_misalignment_xy={xy + 0.01}+-0.0001"])
    assert wrong.verdict == "poor"
    assert any("contradict the prior of accel_misalignment_xy" in reason for reason in wrong.reasons)
    right = imucal.calibrate(run, hold=[f"accel_misalignment_xy={xy}+-0.0001"])
    assert right.verdict == free.verdict
    assert abs(right.fit.priors.held[0].contradiction) < 1.0


def test_the_refusal_offers_a_model_that_works(
    tmp_path, recording: imucal.Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(imucal.NotEnoughMotionError, match="model='orthogonal' estimates biases and scales"):
        imucal.calibrate(recording)
    path = tmp_path / "six faces.csv"
    imucal.write(recording, path)
    assert main(["calibrate", str(path)]) == 1
    said = capsys.readouterr().err
    command = re.search(r"imucal (calibrate --model orthogonal .*)", said)
    assert command is not None, said
    assert "deg in the direction of gravity" in said
    assert main([*shlex.split(command[1]), "-o", str(tmp_path / "unit.json")]) == 0
    assert "held by the prior" in capsys.readouterr().out


def test_the_offered_command_replaces_the_model_that_was_given(tmp_path, capsys) -> None:
    table = tmp_path / "six.csv"
    table.write_text(
        "accel_x_mps2,accel_y_mps2,accel_z_mps2\n"
        "-0.06,0.00,8.44\n-0.01,-0.07,-11.57\n10.16,-0.16,-0.03\n"
        "-9.27,-0.10,-0.18\n0.07,9.55,-0.10\n0.04,-9.93,-0.05\n"
    )
    for given in (["--model", "full"], ["--model=full"]):
        assert main(["calibrate", str(table), "--means", "--noise", "0.1", *given]) == 1
        command = re.search(r"imucal (calibrate .*)", capsys.readouterr().err)[1]
        assert command.count("--model") == 1
        assert main([*shlex.split(command), "-o", str(tmp_path / "unit.json")]) == 0
        capsys.readouterr()


def test_six_faces_in_counts_lead_to_a_result_by_the_advice(tmp_path, capsys) -> None:
    """The nominal sensitivities are asked for, those per g are corrected, and the offered command works."""
    recording = recorded(imucal.Program(TIPPED_STEPS), 2)
    lsb_per_g, lsb_per_radps = 8192.0, 32.8 / np.radians(1.0)
    counts = imucal.Recording(
        recording.time_s,
        np.round(recording.specific_force * lsb_per_g / 9.80665),
        np.round(recording.angular_rate * lsb_per_radps),
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    imucal.write(counts, tmp_path / "run.csv")
    words = ["calibrate", str(tmp_path / "run.csv"), "-o", str(tmp_path / "unit.json")]
    assert main(words) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "(accel_nominal=..., --accel-nominal, in lsb per m/s^2 and gyro_nominal=..., --gyro" in said
    assert main([*words, "--accel-nominal", "8192", "--gyro-nominal", "32.8"]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "8192 looks like lsb per g" in said and "lsb per deg/s times 57.29578" in said
    per_mps2 = re.search(r"give (--accel-nominal) (\S+)\. ", said).groups()
    assert float(per_mps2[1]) == pytest.approx(lsb_per_g / 9.80665)
    assert main([*words, *per_mps2, "--gyro-nominal", str(lsb_per_radps)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "raw counts it needs" not in said
    assert main(shlex.split(re.search(r": imucal (calibrate --model orthogonal .*)$", said)[1])) == 0
    scales = np.diag(imucal.Calibration.load(tmp_path / "unit.json").accelerometer.sensitivity)
    np.testing.assert_allclose(scales * 9.80665 / lsb_per_g, [1.01, 0.985, 1.02], atol=2e-3)


def test_unknown_names_and_forms_name_the_possible_ones(recording: imucal.Recording) -> None:
    with pytest.raises(imucal.InputError, match=r"accel_misalignment \(_xy, _xz, _yz\)"):
        imucal.calibrate(recording, hold=["misalignment"])
    with pytest.raises(imucal.InputError, match="NAME=VALUE"):
        imucal.calibrate(recording, hold=["accel_bias=a"])
    with pytest.raises(imucal.InputError, match="positive standard deviation"):
        imucal.calibrate(recording, hold=["accel_bias=0+-0"])
    with pytest.raises(imucal.InputError, match="full, orthogonal, bias"):
        imucal.calibrate(recording, model="diagonal")


def test_files_and_exports_keep_the_held_parameters(tmp_path, result: imucal.CalibrationResult) -> None:
    path = tmp_path / "unit.json"
    result.calibration.save(path)
    loaded = imucal.Calibration.load(path)
    assert loaded.fit["priors"] == result.to_dict()["fit"]["priors"]
    assert loaded.judged == (result.verdict, result.reasons)
    assert loaded.to_dict() == result.calibration.to_dict()
    assert imucal.export(loaded, "c-header").text
    spoilt = loaded.to_dict()
    spoilt["fit"]["priors"]["held"][0]["prior_share"] = 1.5
    with pytest.raises(imucal.FormatError, match="prior_share"):
        imucal.Calibration.from_dict(spoilt)


def test_the_predicted_errors_of_an_evaluation_contain_the_prior(
    result: imucal.CalibrationResult, run: imucal.Recording
) -> None:
    """A control recording in other directions has errors of the misalignment, which the prior explains."""
    narrow = dataclasses.replace(result.calibration, covariance=result.calibration.covariance * 1e-8)
    ratio = {fit.kind: fit.ratio for fit in imucal.evaluate(result.calibration, run).residuals}
    of_narrow = {fit.kind: fit.ratio for fit in imucal.evaluate(narrow, run).residuals}
    assert ratio["norms"] < 3.0 < of_narrow["norms"]


def test_a_plan_contains_the_priors() -> None:
    settings = {"unit": "bmi088", "rate_hz": 100.0, "detection_limits": False}
    held = imucal.plan(
        imucal.Program(STEPS), hold=["accel_misalignment+-0.001"], model="orthogonal", **settings
    )
    of_held = {p.name: p.std for p in held.parameters}
    assert of_held["accel_sensitivity_xy"] == pytest.approx(0.001, rel=0.05)
    assert held.undetermined is None
    assert imucal.plan(imucal.Program(STEPS), **settings).undetermined is not None


def test_the_scale_of_a_gyroscope_axis_without_rotation_is_held() -> None:
    result = imucal.calibrate(recorded(imucal.Program(TIPPED_STEPS), 2), model="orthogonal")
    held = {held.name: held for held in result.fit.priors.held}
    assert len(held) == 10 and held["gyro_scale_z"].prior_share > 0.5
    assert any("gyro_scale_z" in reason for reason in result.reasons)


def test_a_search_for_effects_has_the_same_priors(run: imucal.Recording) -> None:
    hold = ["accel_misalignment_xy=0.008+-0.0005"]
    found = imucal.find_gap(run, hold=hold, candidates=["gyro_g_sensitivity"])
    assert found.verdict == "nothing_missing"
    wrong = imucal.find_gap(
        run, hold=["accel_misalignment_xy=0.02+-0.0001"], candidates=["gyro_g_sensitivity"]
    )
    assert wrong.verdict == "unknown"


def test_without_held_parameters_documents_have_no_priors(run: imucal.Recording) -> None:
    result = imucal.calibrate(run)
    assert result.fit.priors is None and "priors" not in result.to_dict()["fit"]


def test_small_monte_carlo_of_six_faces() -> None:
    """Bias and scale of eight units with other misalignments are within their standard deviations."""
    random, scores = np.random.default_rng(1), []
    for trial in range(8):
        misalignments = 0.01 * random.normal(size=3)
        unit = unit_of()
        accel = np.diag(np.diag(unit.accelerometer.sensitivity))
        accel[np.triu_indices(3, 1)] = misalignments
        accel = np.triu(accel) + np.triu(accel, 1).T
        still = dataclasses.replace(
            unit.accelerometer, sensitivity=accel, bias_instability=0.0, random_walk=np.zeros(3)
        )
        unit = dataclasses.replace(unit, accelerometer=still)
        recording = imucal.simulate(imucal.Program(STEPS), unit=unit, seed=trial + 1, rate_hz=50.0).recording
        for parameter in imucal.calibrate(recording, model="orthogonal").parameters:
            if re.fullmatch("accel_bias_.|accel_sensitivity_(xx|yy|zz)", parameter.name):
                axis = "xyz".index(parameter.name[-1])
                truth = still.bias[axis] if "bias" in parameter.name else accel[axis, axis]
                scores.append((parameter.value - truth) / parameter.std)
    assert np.mean(np.abs(scores) < 1.96) > 0.85 and np.max(np.abs(scores)) < 5.0
