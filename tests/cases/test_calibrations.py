"""Runs that were once refused, or calibrated wrongly with a good verdict: parameters against their truth."""

import json
import math
import os
import re
import shutil
import subprocess

import numpy as np
import pytest

import imucal
from children import HANGS_S
from imucal.cli import main
from raw_text import module_of

# Largest accepted error of a parameter in its standard deviations: noise alone exceeds it in one of 16,000.
WITHIN_SIGMAS = 4.0


@pytest.fixture(scope="module")
def truth(case_file):
    """The true parameters by name, from the simulator of NumPy alone that made the files."""
    sim, truth = module_of(case_file("cube-faces/sim.py")), {}
    for sensor, matrix, bias in (("accel", sim.TA, sim.BA), ("gyro", sim.TG, sim.BG)):
        for i, row in enumerate("xyz"):
            truth[f"{sensor}_bias_{row}"] = bias[i]
            truth |= {f"{sensor}_sensitivity_{row}{column}": matrix[i, j] for j, column in enumerate("xyz")}
    return truth


def in_sigmas(parameters, truth):
    return {p.name: (p.value - truth[p.name]) / p.std for p in parameters}


def text_of(capsys):
    return " ".join("".join(capsys.readouterr()).split())


# Faces of a box


FACES = ("cube-faces/cube_mix12.csv", "cube-faces/pybricks_roll.csv")


@pytest.mark.parametrize("name", FACES)
def test_rests_on_the_faces_of_a_box_determine_all_parameters(case_file, truth, name):
    result = imucal.calibrate(imucal.read(case_file(name)))
    assert result.verdict == "good"
    assert len(result.parameters) == 21
    errors = in_sigmas(result.parameters, truth)
    assert max(map(abs, errors.values())) < WITHIN_SIGMAS, errors


@pytest.mark.slow
def test_errors_are_those_of_a_fit_without_imucal(programs, case_file, tmp_path):
    """fitcube.py as it is, with the numerics of ident.py."""
    for name in ("cube-faces/fitcube.py", "cube-faces/ident.py", "cube-faces/sim.py", *FACES):
        shutil.copy(case_file(name), tmp_path)
    sim = module_of(tmp_path / "sim.py")
    lines = ran(programs, tmp_path, "fitcube.py").strip().splitlines()
    assert len(lines) == 2
    for line in lines:
        name, errors = line.split()[0], re.findall(r"(?:acc|gyr)[Tb] (\S+)", line)
        unit = imucal.calibrate(imucal.read(tmp_path / f"{name}.csv")).calibration
        own = (
            unit.accelerometer.sensitivity - sim.TA,
            unit.accelerometer.bias - sim.BA,
            unit.gyroscope.sensitivity - sim.TG,
            unit.gyroscope.bias - sim.BG,
        )
        for error, other in zip(own, map(float, errors), strict=True):
            assert np.abs(error).max() < 1.5 * other, line


# Axes


def calibrated(path, output, capsys, *options):
    """The calibration by the command, its parameters by name, exit code and output."""
    code = main(["calibrate", str(path), "-o", str(output), *options])
    said = text_of(capsys)
    return imucal.Calibration.load(output) if code != 1 else None, code, said


def px4(calibration_file, capsys):
    """The parameters of PX4 in an export."""
    assert main(["export", str(calibration_file), "--to", "px4"]) == 0
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines() if line.startswith("1\t")]
    return {row[2]: float(row[3]) for row in rows}


def test_data_with_z_down_get_the_offsets_of_their_own_axes(case_file, truth, tmp_path, capsys):
    """The sensors of `sim.py`, in a body whose z axis points down."""
    path, output = case_file("frd-gravity-sign/frd1.csv"), tmp_path / "cal.json"
    calibration, code, said = calibrated(path, output, capsys)
    assert code == 0
    errors = in_sigmas(calibration.parameters, truth)
    assert max(map(abs, errors.values())) < WITHIN_SIGMAS, errors
    assert "[gravity_sign]: if the unit lies upside down there, nothing is wrong" in said
    assert "pass --axes frd" in said
    # A sign is advised only after a turn by hand, because gravity alone cannot tell.
    assert said.index("turn the unit in this pose counter-clockwise") < said.index(
        "pass --axes accel=-x,-y,-z"
    )
    own = px4(output, capsys)
    _, code, said = calibrated(path, output, capsys, "--axes", "frd")
    assert code == 0 and "gravity_sign" not in said
    followed = px4(output, capsys)
    for axis in "xyz":
        name = f"CAL_ACC0_{axis.upper()}OFF"
        assert own[name] == pytest.approx(truth[f"accel_bias_{axis}"], abs=2e-3)
        assert followed[name] == pytest.approx(own[name], abs=1e-6)


def test_a_stand_with_z_down_is_calibrated(case_file, tmp_path, capsys):
    path, output = case_file("frd-gravity-sign/stand_frd.csv"), tmp_path / "cal.json"
    own, code, said = calibrated(path, output, capsys)
    assert code == 0 and "[gravity_sign]" in said and "with all motors at zero" in said
    turned, code, said = calibrated(path, output, capsys, "--axes", "frd")
    assert code == 0 and "gravity_sign" not in said
    signs = np.array([1.0, -1.0, -1.0])
    for sensor in ("accelerometer", "gyroscope"):
        of_own, of_turned = getattr(own, sensor), getattr(turned, sensor)
        np.testing.assert_allclose(of_turned.bias, signs * of_own.bias, atol=1e-9)
        expected = signs[:, None] * of_own.sensitivity * signs
        np.testing.assert_allclose(of_turned.sensitivity, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "right"),
    [("mirrored_axes/left_handed_y.csv", "x,-y,z"), ("mirrored_axes/zyx_named_xyz.csv", "z,y,x")],
)
def test_mirrored_axes_have_two_causes_and_an_option_for_each(case_file, tmp_path, capsys, name, right):
    path, output = case_file(name), tmp_path / "cal.json"
    none, code, said = calibrated(path, output, capsys)
    assert (none, code) == (None, 1)
    assert "[left_handed_axes]: two causes fit, which gravity alone cannot tell apart" in said
    assert "If gyro_z reads a negative rate, the sign of the gyroscope is reversed" in said
    assert "If gyro_z reads a positive rate, the columns of both sensors are mirrored" in said
    options = re.findall(r"--axes (\S+?)[,;.]?(?=\s)", said)
    assert right in options and "gyro=-x,-y,-z" in options
    followed, code, _ = calibrated(path, output, capsys, "--axes", right)
    assert code == 0
    plain, code, said = calibrated(case_file("mirrored_axes/xyz.csv"), output, capsys)
    assert code == 0 and "left_handed_axes" not in said
    for sensor in ("accelerometer", "gyroscope"):
        for part in ("bias", "sensitivity"):
            expected = getattr(getattr(plain, sensor), part)
            np.testing.assert_allclose(getattr(getattr(followed, sensor), part), expected, atol=1e-9)


# Six positions


def test_six_positions_with_a_gyroscope_give_bias_and_scale(case_file, tmp_path, capsys):
    path, output = case_file("six-means/six.csv"), tmp_path / "cal.json"
    _, code, said = calibrated(path, output, capsys)
    assert code == 1
    assert "6 rests do not determine the accelerometer's misalignment yz" in said
    assert "Without more motion, --model orthogonal estimates biases and scales" in said
    command = re.search(r": imucal (calibrate --model orthogonal .*)$", said)
    assert main(command[1].split()) == 0
    said = text_of(capsys)
    assert "accel_misalignment xy, xz, yz held by the prior 0 +- 0.01 rad" in said
    parameters = {p["name"]: p for p in json.loads(output.read_text())["parameters"]}
    # By hand: middle and half distance of the readings with an axis up and with it down, in the rests.
    numbers = np.loadtxt(path, delimiter=",", skiprows=1)
    means = np.array([numbers[round(k * 550) :][:400, 1:4].mean(axis=0) for k in range(6)])
    for i, axis in enumerate("xyz"):
        up, down = means[:, i].max(), means[:, i].min()
        for name, by_hand in (
            (f"accel_bias_{axis}", (up + down) / 2),
            (f"accel_sensitivity_{axis}{axis}", (up - down) / 2 / 9.80665),
        ):
            # A face that is 1 deg off level changes the reading by 1.5e-3 m/s^2.
            assert parameters[name]["value"] == pytest.approx(by_hand, abs=2e-3), name


# Rounding to counts


@pytest.mark.slow
def test_sigmas_of_a_coarse_converter_cover_the_truth(programs, case_file, tmp_path):
    """tz.py as it is: biases of 12 tumbles of a simulated unit whose noise is below a count."""
    for name in ("lsb-sigma/tz.py", "lsb-sigma/u2000.json", "lsb-sigma/truth.json"):
        shutil.copy(case_file(name), tmp_path)
    printed = ran(programs, tmp_path, "tz.py", "5")
    errors, largest, within = re.search(r"n (\d+) .* max (\S+) within 2 sigma (\d+)", printed).groups()
    # 36 biases, of which 95 % are within 2 standard deviations: 30 or fewer in one of 100 series.
    assert int(errors) == 36 and int(within) > 30, printed
    assert float(largest) < WITHIN_SIGMAS, printed


@pytest.mark.slow
def test_sigmas_of_rounded_counts_cover_the_truth(programs, case_file, tmp_path):
    """tq.py as it is: three converters, 12 runs each of its own simulator."""
    for name in ("lsb-sigma/tq.py", "lsb-sigma/sim.py"):
        shutil.copy(case_file(name), tmp_path)
    printed = ran(programs, tmp_path, "tq.py").strip().splitlines()
    assert len(printed) == 3
    for line in printed:
        bias, within, count, scale = re.search(
            r"max (\d+), within 2 sigma (\d+) of (\d+) \| scale: max (\S+)", line
        ).groups()
        assert int(count) == 36 and int(within) > 30, line
        assert float(bias) <= WITHIN_SIGMAS and float(scale) < WITHIN_SIGMAS, line


def ran(programs, folder, *words):
    """The output of a Python program in a folder, with the command in its path."""
    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [programs / "python", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_rounding_is_said_and_named(case_file, tmp_path, capsys):
    output = tmp_path / "q.csv"
    unit = case_file("lsb-sigma/u2000.json")
    words = ["--poses", "20", "--hold-s", "3", "--filter", "5", "--rate-hz", "100", "--seed", "1"]
    assert main(["simulate", "tumble", "--unit", str(unit), *words, "-o", str(output)]) == 0
    calibration, code, said = calibrated(output, tmp_path / "cal.json", capsys)
    assert code == 0 and "[noise_below_lsb]" in said
    truth = json.loads(case_file("lsb-sigma/truth.json").read_text())["gyroscope"]["bias"]
    # The README: wrong by 18.8 and 12.3 stated standard deviations.
    sigmas = {p.name: p.std for p in calibration.parameters}
    for axis, bias, true in zip("xyz", calibration.gyroscope.bias, truth, strict=True):
        assert abs(bias - true) < WITHIN_SIGMAS * sigmas[f"gyro_bias_{axis}"]
        # A count of 0.07 deg/s leaves an error that does not average down.
        assert sigmas[f"gyro_bias_{axis}"] > math.radians(0.07) / 100
