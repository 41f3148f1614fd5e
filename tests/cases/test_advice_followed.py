"""Files about which the program once gave wrong advice: its advice now, and the result of following it."""

import math
import re

import numpy as np
import pytest

import imucal
from imucal.cli import main
from raw_text import SEVEN, raw


def command_in(text, option):
    """The value of an option in a message, quoted or not."""
    found = re.search(rf"{option} (?:'([^']*)'|([^\s,;]+))", text)
    assert found, text
    return found[1] or found[2]


# Units


def test_no_unit_is_assumed(case_file, capsys):
    path = case_file("no_unit_in_header/still.csv")
    assert main(["inspect", str(path)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "the header does not give every unit: t, ax, ay, az, gx, gy, gz. No unit is assumed" in said
    # How the values would read in each unit, computed from the text.
    header = path.read_text().splitlines()[0].split(",")
    numbers = np.loadtxt(path, delimiter=",", skiprows=1)
    size = np.median(np.linalg.norm(numbers[:, 1:4], axis=1))
    assert f"{size / 9.80665:.3f} g as m/s^2" in said
    assert f"{size:.1f} g as g" in said
    noise = np.median(np.std(np.diff(numbers[:, 4:], axis=0), axis=0)) / math.sqrt(2)
    as_dps, as_radps = re.search(r"which is (\S+) deg/s as deg/s, (\S+) deg/s as rad/s", said).groups()
    # The program's estimate is robust, so it differs by some per cent.
    assert float(as_dps) == pytest.approx(noise, rel=0.15)
    assert float(as_radps) == pytest.approx(math.degrees(noise), rel=0.15)
    assert "its steps are 131 counts per deg/s as deg/s" in said
    # Who follows the line for the likely units gets the values of the text in these units.
    columns = command_in(said, "--columns")
    assert columns.count("dps") == 3 and columns.count("mps2") == 3
    given = dict(pair.split("=") for pair in columns.split(","))
    assert sorted(given.values()) == sorted(header)
    recording = imucal.read(path, columns=columns)
    np.testing.assert_array_equal(recording.specific_force, numbers[:, 1:4])
    np.testing.assert_allclose(recording.angular_rate, np.radians(numbers[:, 4:]), rtol=1e-15)
    np.testing.assert_array_equal(recording.time_s, numbers[:, 0])
    density = imucal.noise(recording).triad("gyro")[1].noise_density
    assert density.value == pytest.approx(math.radians(noise) * math.sqrt(0.01), rel=0.1)


@pytest.mark.parametrize(("name", "degc"), [("imu.temperature", 31.5), ("Temp", -20.0), ("imu.status", None)])
def test_a_temperature_without_a_unit_is_in_the_proposed_columns(name, degc, tmp_path, capsys):
    random = np.random.default_rng(5)
    rows = np.column_stack(
        [
            np.arange(400) * 0.01,
            random.normal((0.0, 0.0, 9.81), 0.01, (400, 3)),
            random.normal(0.0, 1e-3, (400, 3)),
            np.full(400, degc or 0.0),
        ]
    )
    path = tmp_path / "sweep.csv"
    header = f"t,acc.x,acc.y,acc.z,gyro.x,gyro.y,gyro.z,{name}"
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header=header, comments="")
    assert main(["inspect", str(path)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert ("probably degC" in said) == (degc is not None)
    columns = command_in(said, "--columns")
    read = imucal.read(path, columns=columns).temperature_degc
    assert read is None if degc is None else (read == degc).all()


def test_implausible_noise_names_the_likely_unit(case_file, capsys):
    path = case_file("no_unit_in_header/still.csv")
    names = path.read_text().splitlines()[0].split(",")
    in_radps = ",".join(f"{ours}={theirs}" for ours, theirs in zip(SEVEN, names, strict=True))
    main(["noise", str(path), "--columns", in_radps])
    said = " ".join("".join(capsys.readouterr()).split())
    assert "[noise_implausible]" in said
    assert "no usual gyroscope has that" in said
    advised = in_radps
    for axis in "xyz":
        assert f"gyro_{axis}_dps" in said
        advised = advised.replace(f"gyro_{axis}_radps", f"gyro_{axis}_dps")
    main(["noise", str(path), "--columns", advised])
    assert "noise_implausible" not in "".join(capsys.readouterr())


def test_a_walk_is_not_called_a_wrong_unit(case_file, capsys):
    path = case_file("false_rest_called_units/walk.csv")
    assert main(["calibrate", str(path), "-o", "unused.json"]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "gyro_units" not in said and "name the columns gyro_x_dps" not in said
    # The gyroscope is at the end of its range, 490 deg/s, for more samples in a row than noise explains.
    gyro = raw(path).gyro[:, 1]
    assert np.sum(gyro == gyro.min()) == 20
    assert f"gyro_y holds its extreme value {gyro.min():.6g} rad/s for 20 samples" in said
    assert "[gyro_saturation]" in said
    # Without these moves there is no calibration, either, for want of poses.
    assert main(["calibrate", str(path), "--exclude-saturated", "-o", "unused.json"]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "1 rest does not determine the accelerometer's bias x" in said
    assert "gyro_units" not in said


# Time


def test_late_stamps_are_not_missing_samples(case_file, capsys):
    path = case_file("arrival_called_missing/log.csv")
    steps = np.diff(raw(path).time_s)
    late = np.flatnonzero(steps > 1.5 * np.median(steps))
    # Each long step is followed by a short one, so no sample is missing.
    assert np.all(steps[late] + steps[late + 1] < 2.5 * np.median(steps))
    assert main(["noise", str(path)]) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert f"{len(late)} samples are stamped late" in said and "none is missing" in said
    assert "samples_missing" not in said


def test_the_mean_rate_of_bursts_is_shown_and_advised(case_file, capsys):
    path = case_file("rate_of_bursts/bursts.csv")
    expected = raw(path)
    steps = np.diff(expected.time_s)
    # The usual step would be another rate.
    assert 1 / np.median(steps) == pytest.approx(88.9, abs=0.1)
    main(["inspect", str(path)])
    said = " ".join("".join(capsys.readouterr()).split())
    assert f"3000 samples, 29.992 s, {expected.rate_hz:.6g} Hz" in said
    assert "[clock_irregular]" in said
    rate_hz = command_in(said, "--rate-hz")
    assert rate_hz == "100"
    followed = imucal.read(path, columns=["-", *SEVEN[1:]], rate_hz=float(rate_hz))
    np.testing.assert_allclose(followed.time_s, np.arange(3000) / 100, atol=1e-12)
    np.testing.assert_array_equal(followed.angular_rate, expected.gyro)
    assert "clock_irregular" not in {finding.code for finding in imucal.inspect(followed).findings}


# A table of means


def test_six_means_without_a_way_in(case_file, capsys, tmp_path):
    """Each refusal names the next step, and the last step gives bias and scale."""
    path = case_file("six-means/six_means.csv")
    output = ["-o", str(tmp_path / "cal.json")]
    assert main(["calibrate", str(path), *output]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "if each row is the mean of a rest, give --means" in said and "both files" not in said
    # Six rows do not show the noise of the means, and the command asks for it.
    assert main(["calibrate", str(path), "--means", *output]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "estimates biases and scales if the noise of the means is given (noise_mps2=..., --noise)" in said
    command = re.search(r": imucal (calibrate --model orthogonal .*) MPS2$", said)
    assert main([*command[1].split(), "0.02"]) == 0
    capsys.readouterr()
    assert main(["calibrate", str(path), "--means", "--model", "orthogonal", *output]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "give their standard deviation (noise_mps2=..., --noise)" in said and "--model" not in said
    assert main(["calibrate", str(path), "--means", "--noise", "0.02", *output]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "6 rests do not determine the accelerometer's misalignment xy, misalignment xz" in said
    command = re.search(r": imucal (calibrate --model orthogonal .*)$", said)
    assert command, said
    assert main(command[1].split()) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert "verdict: incomplete" in said and "stay" not in said
    assert "an error (1 sigma) of 0.64 deg in the direction of gravity" in said
    # Six equations |S^-1 (m - b)| = g with six unknowns, solved by Newton's method.
    means = np.loadtxt(path, delimiter=",", skiprows=1)
    bias, scale = (means.max(axis=0) + means.min(axis=0)) / 2, np.ones(3)
    for _ in range(20):
        force = (means - bias) / scale
        residual = np.sum(force**2, axis=1) - 9.80665**2
        jacobian = np.hstack([-2 * force / scale, -2 * force**2 / scale])
        bias, scale = np.split(np.r_[bias, scale] - np.linalg.solve(jacobian, residual), 2)
    calibration = imucal.Calibration.load(tmp_path / "cal.json")
    np.testing.assert_allclose(calibration.accelerometer.bias, bias, atol=1e-6)
    np.testing.assert_allclose(np.diag(calibration.accelerometer.sensitivity), scale, atol=1e-6)
    assert calibration.gyroscope is None
