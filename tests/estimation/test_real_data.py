"""Real recordings, judged by a SciPy program of this project and by figures of other people's programs.

Sources and licences of the recordings are in the README of each folder.
"""

import dataclasses
import json
import re

import numpy as np
import pytest
from scipy.optimize import least_squares

import imucal

pytestmark = pytest.mark.slow

PADOVA_MPS2 = 9.81744
STANDARD_GRAVITY_MPS2 = 9.80665
MPU9150 = "accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
COUNTS = "accel_x_lsb,accel_y_lsb,accel_z_lsb,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb"
TIGHT = {"method": "lm", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}


# --- xsens_mti: raw counts, two files ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def xsens_files(data_file):
    return [data_file(f"xsens_mti/xsens_{sensor}.mat") for sensor in ("acc", "gyro")]


@pytest.fixture(scope="module")
def xsens(xsens_files):
    return imucal.read(*xsens_files, format="imu_tk")


@pytest.fixture(scope="module")
def xsens_result(xsens):
    return imucal.calibrate(xsens, gravity_mps2=PADOVA_MPS2)


@pytest.fixture(scope="module")
def xsens_in_two_stages(xsens):
    return imucal.calibrate(xsens, gravity_mps2=PADOVA_MPS2, joint=False)


def used(items, field):
    return np.array([getattr(item, field) for item in items if item.excluded is None])


def symmetric(entries):
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_xsens_has_37_or_38_rests(xsens_result):
    assert len(xsens_result.rests) in (37, 38)
    assert len(xsens_result.moves) == len(xsens_result.rests) - 1


def test_xsens_accelerometer_agrees_with_scipy(xsens_in_two_stages):
    means = used(xsens_in_two_stages.rests, "mean_specific_force")
    sigma = used(xsens_in_two_stages.rests, "norm_sigma_mps2")

    def residuals(p):
        force = np.linalg.solve(symmetric(p[3:]), (means - p[:3]).T)
        return (np.linalg.norm(force, axis=0) - PADOVA_MPS2) / sigma

    start = np.array([32768.0] * 3 + [415.0] * 3 + [0.0] * 3)
    found = least_squares(residuals, start, x_scale=[100.0] * 3 + [1.0] * 6, **TIGHT)
    accelerometer = xsens_in_two_stages.calibration.accelerometer
    assert accelerometer.bias == pytest.approx(found.x[:3], rel=1e-6, abs=0)
    # Off the diagonal, relative to the scale: a misalignment of 1e-6 rad.
    scale = np.sqrt(np.outer(found.x[3:6], found.x[3:6]))
    assert np.abs((accelerometer.sensitivity - symmetric(found.x[3:])) / scale).max() < 1e-6
    assert xsens_in_two_stages.fit.accelerometer.chi2 == pytest.approx(2 * found.cost, rel=1e-3)


def test_xsens_reads_gravity_at_every_rest(xsens_result):
    assert used(xsens_result.rests, "norm_error_mps2").std() <= 0.0011


def test_xsens_accelerometer_agrees_with_imu_tk(xsens_result):
    """imu_tk fits samples instead of means; corrected = upper (raw - b), in yet another frame."""
    misalignment = np.array([[1, -0.00335930, -0.00890639], [0, 1, -0.02133412], [0, 0, 1]])
    upper = misalignment @ np.diag(1 / np.array([414.4588739, 412.0104685, 414.6486622]))
    accelerometer = xsens_result.calibration.accelerometer
    # |f| knows T^-T T^-1 alone, which no frame changes.
    inverse = np.linalg.inv(accelerometer.sensitivity)
    ours, theirs = inverse.T @ inverse, upper.T @ upper
    assert np.abs(ours / theirs[0, 0] - theirs / theirs[0, 0]).max() < 1e-3
    assert accelerometer.bias == pytest.approx([33124.1826, 33275.1794, 32364.4156], abs=1)


def carried(time_s, raw_rate, moves, bias, sensitivity):
    """Gravity before each move, turned by the integrated rate to the end of the move, (moves, 3)."""
    # All moves side by side; steps past the end of a short one have length zero and turn nothing.
    steps = 1 << int(np.ceil(np.log2(max(m.last - m.first for m in moves))))
    index = np.array([np.minimum(m.first + np.arange(steps + 1), m.last) for m in moves])
    rate = np.linalg.solve(sensitivity, (raw_rate[index].reshape(-1, 3) - bias).T).T.reshape(*index.shape, 3)
    dt = np.diff(time_s[index], axis=1)[..., None]
    w0, w1 = rate[:, :-1], rate[:, 1:]
    turn = dt / 2 * (w0 + w1) + dt**2 / 12 * np.cross(w0, w1)
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    # Quaternions as scalar and vector part; numpy's sinc has pi in it.
    scalar, vector = np.cos(angle / 2), turn * np.sinc(angle / (2 * np.pi)) / 2
    while scalar.shape[1] > 1:
        a, u, b, v = scalar[:, ::2], vector[:, ::2], scalar[:, 1::2], vector[:, 1::2]
        scalar = a * b - (u * v).sum(-1, keepdims=True)
        vector = a * v + b * u + np.cross(u, v)
    a, u = scalar[:, 0], -vector[:, 0]
    up = np.array([m.gravity_before for m in moves])
    return up + 2 * a * np.cross(u, up) + 2 * np.cross(u, np.cross(u, up))


def test_xsens_gyroscope_agrees_with_scipy(xsens, xsens_in_two_stages):
    moves = [m for m in xsens_in_two_stages.moves if m.excluded is None]
    after = np.array([m.gravity_after for m in moves])
    sigma = np.radians([m.direction_sigma_deg for m in moves])
    gyroscope = xsens_in_two_stages.calibration.gyroscope
    # The two directions across each `after`: which two does not matter to the sum of squares.
    across = np.linalg.svd(after[:, None, :])[2][:, 1:]

    def residuals(p):
        up = carried(xsens.time_s, xsens.angular_rate, moves, gyroscope.bias, p.reshape(3, 3))
        return ((across @ (up - after)[..., None])[..., 0] / sigma[:, None]).ravel()

    found = least_squares(residuals, 4770.0 * np.eye(3).ravel(), x_scale=[100.0] * 9, **TIGHT)
    entries = found.x.reshape(3, 3)
    scale = np.abs(np.diag(entries))[:, None]
    assert np.abs((gyroscope.sensitivity - entries) / scale).max() < 1e-6
    assert xsens_in_two_stages.fit.gyroscope.chi2 == pytest.approx(2 * found.cost, rel=1e-6)


def test_xsens_gyroscope_carries_gravity(xsens_result):
    error_deg = used(xsens_result.moves, "direction_error_deg")
    assert len(error_deg) >= 36
    assert np.sqrt(np.mean(error_deg**2)) <= 0.48


def test_xsens_gyroscope_bias_is_that_of_all_rests(xsens_result):
    means = used(xsens_result.rests, "mean_angular_rate")
    standard_error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    error = xsens_result.calibration.gyroscope.bias - means.mean(axis=0)
    assert (np.abs(error) < 2 * standard_error).all()
    # The first rest alone, as other programs take it, is far from that.
    assert (np.abs(means[0] - means.mean(axis=0)) > 2 * standard_error).any()


def test_xsens_nominal_sensitivity_changes_nothing(xsens, xsens_result):
    told = imucal.calibrate(xsens, gravity_mps2=PADOVA_MPS2, accel_nominal=400.0, gyro_nominal=5000.0)
    for ours, other in zip(told.parameters, xsens_result.parameters, strict=True):
        assert ours.value == pytest.approx(other.value, abs=1e-4 * other.std)


def test_xsens_by_the_command(xsens_files, xsens_result, command, tmp_path):
    output = tmp_path / "result.json"
    options = ["--format", "imu_tk", "--gravity", PADOVA_MPS2, "-o", tmp_path / "cal.json", "--json", output]
    done = command("calibrate", *xsens_files, *options)
    assert done.returncode == 0, done.stderr
    result = json.loads(output.read_text())
    assert len(result["rests"]) in (37, 38)
    assert result["calibration_set"]["gravity_direction_rms_deg"] <= 0.48
    assert [p["value"] for p in result["parameters"]] == [p.value for p in xsens_result.parameters]
    calibration = imucal.Calibration.load(tmp_path / "cal.json")
    assert (calibration.accel_unit, calibration.gyro_unit) == ("lsb", "lsb")


# --- xsens_mti: the effect that the linear model misses ----------------------------------------------------


@pytest.fixture(scope="module")
def xsens_with_effect(xsens_files, command, tmp_path_factory):
    """The command with the effect: the JSON document and the calibration file."""
    folder = tmp_path_factory.mktemp("effect")
    options = [
        "--format",
        "imu_tk",
        "--gravity",
        PADOVA_MPS2,
        "--effect",
        "gyro_g_sensitivity",
        "--folds",
        "3",
    ]
    output = ["-o", folder / "cal.json", "--json", folder / "result.json"]
    done = command("calibrate", *xsens_files, *options, *output)
    assert done.returncode == 0, done.stderr
    assert "gyro_g_sensitivity_zz" in done.stdout
    said = re.search(r"gyro_g_sensitivity: chi2 of its 9 parameters is ([\d.e+]+); about 9 ", done.stdout)
    assert float(said[1]) > 1000
    return json.loads((folder / "result.json").read_text()), imucal.Calibration.load(folder / "cal.json")


def test_xsens_g_sensitivity_explains_the_moves(xsens_with_effect, xsens_result):
    result, _ = xsens_with_effect
    assert xsens_result.calibration_set.gravity_direction_rms_deg > 0.4
    assert result["calibration_set"]["gravity_direction_rms_deg"] <= 0.135
    assert result["held_out"]["gravity_direction_rms_deg"] <= 0.175
    # Only the norm of gravity still exceeds its noise: 0.1 mg, as in the README of the recordings.
    assert result["verdict"] == "incomplete"
    above = {own["kind"] for own in result["residuals"] if own["exceeds_noise"]}
    assert above == {"norms"}
    assert result["fit"]["joint"]["termination"] == "converged"
    (effect,) = result["fit"]["effects"]
    assert (effect["name"], effect["dof"]) == ("gyro_g_sensitivity", 9)
    assert effect["statistic"] > 1000


def chi2_per_dof(moves):
    """How well noise alone explains the directions of gravity after the moves."""
    used = [m for m in moves if m["chi2"] is not None]
    return sum(m["chi2"] for m in used) / sum(m["degrees_of_freedom"] for m in used)


def test_xsens_noise_explains_the_moves_once_the_effect_is_known(xsens_with_effect, xsens_result):
    result, _ = xsens_with_effect
    assert chi2_per_dof(map(dataclasses.asdict, xsens_result.moves)) > 10
    assert chi2_per_dof(result["moves"]) < 2.0


def test_xsens_g_sensitivity_agrees_with_another_program(xsens_with_effect, data_file):
    """Nine values with sigma, deg/s per g, that a SciPy program of this project found in the rest means."""
    text = data_file("README.md").read_text(encoding="utf-8")
    told = text[text.index("g-sensitivity found in the rest means") :].split("\n\n")[0]
    table = np.array([row.split() for row in re.findall(r"\((-?\.\d+ -?\.\d+ -?\.\d+)\)", told)], dtype=float)
    assert table.shape == (3, 3)
    low, high = map(float, re.search(r"1 sigma (\.\d+)-(\.\d+)", told).groups())
    result, calibration = xsens_with_effect
    (effect,) = calibration.effects
    found = np.degrees(effect.values.reshape(3, 3)) * STANDARD_GRAVITY_MPS2
    stds = [p["std"] for p in result["parameters"] if p["name"].startswith("gyro_g_sensitivity")]
    sigmas = np.degrees(stds).reshape(3, 3) * STANDARD_GRAVITY_MPS2
    assert (np.abs(found - table) <= 3 * np.minimum(sigmas, low)).all()
    # Both programs look at the same noise: their sigmas are alike.
    assert low / 2 < sigmas.min() and sigmas.max() < 2 * high


def test_xsens_file_with_the_effect_does_its_work(xsens, xsens_with_effect):
    """Read back, the calibration takes the effect away: the rate at rest is that of the noise."""
    result, calibration = xsens_with_effect
    corrected = calibration.apply_recording(xsens)
    rests = [(r["first"], r["end"]) for r in result["rests"]]
    means = np.array([corrected.angular_rate[first:end].mean(axis=0) for first, end in rests])
    plain = dataclasses.replace(calibration, effects=(), covariance=None, covariance_names=())
    before = plain.apply_recording(xsens).angular_rate
    before = np.array([before[first:end].mean(axis=0) for first, end in rests])
    assert np.degrees(before.std(axis=0)).min() > 0.03
    assert np.degrees(means.std(axis=0)).max() < 0.02


# --- mpu9150: two units, SI, no time column ----------------------------------------------------------------


def mpu9150(data_file, unit):
    return imucal.read(data_file(f"mpu9150/imu{unit}.log"), columns=MPU9150, rate_hz=100)


@pytest.mark.parametrize(("unit", "most_deg"), [(0, 0.165), (1, 0.12)])
def test_mpu9150_held_out_moves(data_file, unit, most_deg):
    result = imucal.calibrate(mpu9150(data_file, unit), folds=3)
    assert len(result.rests) >= 22
    assert result.held_out.gravity_direction_rms_deg <= most_deg
    assert len(result.held_out.direction_error_deg) >= 21
    assert result.verdict == "good"


@pytest.mark.parametrize("unit", [0, 1])
def test_mpu9150_noise_explains_rests_and_moves(data_file, unit):
    result = imucal.calibrate(mpu9150(data_file, unit))
    assert result.calibration_set.chi2_per_dof < 2.0
    # White noise and the wandering of the bias, both from this record; all of it, nothing being widened.
    assert max(result.fit.bias_instability_radps) > 0.0
    assert result.fit.noise_alone.chi2 < 2.0 * result.fit.noise_alone.degrees_of_freedom


def test_mpu9150_agrees_with_another_fit(data_file):
    """Nine parameters by a SciPy program of this project, which takes 9.81 m/s^2 for gravity.

    test_published_calibrations.py compares with the figures of the authors.
    """
    result = imucal.calibrate(mpu9150(data_file, 0), gravity_mps2=9.81)
    accelerometer = result.calibration.accelerometer
    percent = 100 * (np.diag(accelerometer.sensitivity) - 1)
    assert percent == pytest.approx([0.357, 0.321, 0.635], abs=0.015)
    assert accelerometer.bias == pytest.approx([0.1028, 0.0965, 0.3443], abs=0.0015)


def test_two_units_are_not_taken_for_one(data_file):
    with pytest.raises(imucal.InputError) as raised:
        imucal.calibrate([mpu9150(data_file, unit) for unit in (0, 1)])
    (finding,) = raised.value.findings
    assert finding.code == "several_units"
    assert "each recording fits alone, all together do not: these are 2 different units" in finding.message


@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
def test_a_thermal_sweep_of_another_unit_is_not_called_a_wrong_unit_of_a_column(data_file, rate_hz):
    """The sweep has one pose, so it cannot be fitted alone; beside a run of another unit nothing fits."""
    rows = np.genfromtxt(data_file("tofupilot_thermal/imu_raw_data.csv"), names=True)
    of = {
        sensor: np.column_stack([rows[f"imu{sensor}{axis}"] for axis in "xyz"]) for sensor in ("acc", "gyro")
    }
    sweep = imucal.Recording(
        np.arange(len(rows)) / rate_hz,
        of["acc"],
        of["gyro"],
        temperature_degc=rows["imutemperature"],
        name="sweep",
    )
    run = imucal.simulate("random", unit="bmi088", seed=4, rate_hz=100, temperature=25.0).recording
    with pytest.raises(imucal.FitError, match="the recordings contradict each other"):
        imucal.calibrate([run, sweep])


def test_mpu9150_by_the_command(data_file, command, tmp_path):
    output = tmp_path / "result.json"
    reading = ["--columns", MPU9150, "--rate-hz", "100"]
    done = command("calibrate", data_file("mpu9150/imu1.log"), *reading, "--folds", "3", "--json", output)
    assert done.returncode == 0, done.stderr
    assert "held-out" in done.stdout
    assert json.loads(output.read_text())["held_out"]["gravity_direction_rms_deg"] <= 0.12


@pytest.mark.parametrize("unit", [0, 1])
def test_mpu9150_is_not_helped_by_g_sensitivity(data_file, unit):
    """Held-out moves are not better by more than chance: 21 of them tell an rms to 15 % at one sigma."""
    recording = mpu9150(data_file, unit)
    plain = imucal.calibrate(recording, folds=3).held_out.gravity_direction_rms_deg
    helped = imucal.calibrate(recording, folds=3, effects=["gyro_g_sensitivity"]).held_out
    assert helped.gravity_direction_rms_deg > 0.85 * plain
    assert helped.gravity_direction_rms_deg < 1.3 * plain


# --- mpu6050: raw counts, a gyroscope that saturates -------------------------------------------------------


def mpu6050(data_file, name):
    return imucal.read(data_file(f"mpu6050/{name}"), columns=COUNTS, rate_hz=100, skip_rows=5)


def test_mpu6050_saturation_is_refused(data_file):
    with pytest.raises(imucal.InputError) as caught:
        imucal.calibrate(mpu6050(data_file, "example_data_calibration.csv"))
    (finding,) = caught.value.findings
    assert (finding.code, finding.severity, finding.count) == ("gyro_saturation", "error", 18)
    assert finding.columns == ("gyro_x", "gyro_z")
    for words in (
        "gyro_x holds its extreme value -32768 lsb for 10 samples",
        "gyro_x holds its extreme value 32767 lsb for 2 samples",
        "gyro_z holds its extreme value -32768 lsb for 6 samples",
        "[gyro_saturation]",
        "calibrate with exclude_saturated=True",
    ):
        assert words in str(caught.value)


# Scales of the authors' own result, lsb per m/s^2 and per rad/s. It includes the saturated moves.
MPU6050_ACCEL, MPU6050_GYRO = (1661.1, 1675.5, 1706.7), (7279.4, 7523.0, 7465.8)


def test_mpu6050_without_the_saturated_moves_has_few_moves_but_is_determined(data_file):
    """Nine rests and six moves; the rests alone leave a misalignment of the accelerometer open."""
    recording = mpu6050(data_file, "example_data_calibration.csv")
    result = imucal.calibrate(recording, exclude_saturated=True)
    assert result.verdict == "incomplete"
    found = {parameter.name: parameter.value for parameter in result.parameters}
    for axis, accel, gyro in zip("xyz", MPU6050_ACCEL, MPU6050_GYRO, strict=True):
        assert found[f"accel_sensitivity_{axis}{axis}"] == pytest.approx(accel, rel=1e-3)
        assert found[f"gyro_sensitivity_{axis}{axis}"] == pytest.approx(gyro, rel=0.015)
    with pytest.raises(imucal.NotEnoughMotionError, match="do not determine"):
        imucal.calibrate(recording, exclude_saturated=True, joint=False)


def test_mpu6050_by_the_command(data_file, command, tmp_path):
    reading = ["--columns", COUNTS, "--rate-hz", "100", "--skip-rows", "5", "-o", tmp_path / "cal.json"]
    path = data_file("mpu6050/example_data_calibration.csv")
    refused = command("calibrate", path, *reading)
    assert refused.returncode == 1
    assert "[gyro_saturation]" in refused.stderr
    excluding = command("calibrate", path, *reading, "--exclude-saturated")
    assert excluding.returncode == 0
    assert "verdict: incomplete" in excluding.stdout
    assert "Traceback" not in refused.stderr + excluding.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["cal.json"]


@pytest.mark.parametrize(
    ("name", "rests"),
    [("example_data_tinit_calc.csv", 1), ("imu_static_test.csv", 1), ("imu_90_x_rot.csv", 2)],
)
def test_recordings_with_few_poses_are_refused(data_file, name, rests):
    with pytest.raises(imucal.NotEnoughMotionError, match=f"^{rests} rests? do(es)? not determine"):
        imucal.calibrate(mpu6050(data_file, name))


# --- ferraris: six faces and three turns -------------------------------------------------------------------

FERRARIS = "-,gyro_x_dps,gyro_y_dps,gyro_z_dps,accel_x_mps2,accel_y_mps2,accel_z_mps2"


def ferraris(data_file, name):
    return imucal.read(data_file(f"ferraris/{name}"), columns=FERRARIS, rate_hz=102.4, skip_rows=1)


# Bias and scale of the accelerometer from opposite faces, (up + down) / 2 and (up - down) / 2 g; scale of the
# gyroscope from its integrated rate over one turn of 360 deg about each axis.
FERRARIS_BIAS_MPS2, FERRARIS_SCALE = (0.537, -0.616, 0.399), (0.9969, 1.0027, 1.0237)
FERRARIS_GYRO_SCALE = (369.96 / 360, 353.65 / 360, 359.32 / 360)


def test_moves_determine_the_misalignment_that_six_faces_leave_open(data_file):
    """Faces and turns by hand: the residuals exceed noise, and the intervals are widened by them."""
    recording = ferraris(data_file, "example_ferraris_session.csv")
    assert imucal.inspect(recording).through_moves == tuple(
        f"accel_sensitivity_{pair}" for pair in ("xy", "xz", "yz")
    )
    result = imucal.calibrate(recording)
    assert result.verdict == "poor"  # the moves miss the next face by a quarter of a degree
    assert all(rest.excluded is None for rest in result.rests)
    found = {parameter.name: parameter for parameter in result.parameters}
    for axis, bias, scale, turn in zip(
        "xyz", FERRARIS_BIAS_MPS2, FERRARIS_SCALE, FERRARIS_GYRO_SCALE, strict=True
    ):
        for name, expected in (
            (f"accel_bias_{axis}", bias),
            (f"accel_sensitivity_{axis}{axis}", scale),
            (f"gyro_sensitivity_{axis}{axis}", turn),
        ):
            assert found[name].value == pytest.approx(expected, abs=4 * found[name].std), name
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(recording, joint=False)
    assert "misalignment xy, misalignment xz, misalignment yz" in str(caught.value)


def test_half_a_second_is_too_short(data_file):
    with pytest.raises(imucal.InputError) as caught:
        imucal.calibrate(ferraris(data_file, "ferraris_example.csv"))
    assert [finding.code for finding in caught.value.findings] == ["too_short"]
