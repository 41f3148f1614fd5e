"""Recordings of an accelerometer without a gyroscope: from the file to the verdict, and what is refused."""

import json
import re

import numpy as np
import pytest

import imucal

GYRO_COLUMNS = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")


@pytest.fixture(scope="module")
def run():
    """A simulated unit on the stand, with both sensors, and a control recording."""
    return [imucal.simulate("random", unit="random:bmi088:7", seed=seed, rate_hz=100.0) for seed in (1, 2)]


@pytest.fixture(scope="module")
def alone(run):
    return run[0].recording.of_sensor("accelerometer")


@pytest.fixture(scope="module")
def result(run, alone):
    return imucal.calibrate(alone, control=run[1].recording.of_sensor("accelerometer"), serial_number="7")


def test_the_nine_parameters_agree_with_the_truth(run, result):
    truth = {p.name: p.value for p in run[0].truth.calibration.parameters}
    assert [p.name for p in result.parameters] == list(truth)[:9]
    errors = np.array([(p.value - truth[p.name]) / p.std for p in result.parameters])
    assert (np.abs(errors) < 4).all(), errors
    assert result.verdict == "good", result.summary()
    assert result.calibration.gyroscope is None and result.calibration.covariance.shape == (9, 9)
    assert result.moves == () and result.calibration_set.gravity_direction_rms_deg is None
    assert "the accelerometer is calibrated alone" in result.summary() and "moves" not in result.used


def test_nothing_of_the_document_is_a_zero_for_the_gyroscope(result):
    document = result.to_dict()
    assert document["gyroscope"] is None and document["fit"]["gyroscope"] is None
    assert not [p["name"] for p in document["parameters"] if p["name"].startswith("gyro")]
    saved = result.calibration.to_dict()
    assert saved["gyroscope"] is None and saved["raw_units"]["gyroscope"] is None
    assert not [name for name in saved["noise"] if name.startswith("gyro")]
    for rest in document["rests"]:
        assert rest["mean_angular_rate"] == [None] * 3
    assert document["fit"]["rest_thresholds"][0]["noise_floor"][:3] == [None] * 3


def test_the_joint_result_of_both_sensors_agrees(run, result):
    both = imucal.calibrate(run[0].recording)
    for one, other in zip(result.parameters, both.parameters, strict=False):
        assert abs(one.value - other.value) < 3 * other.std, one.name
        assert 0.5 < one.std / other.std < 2.5, one.name


def test_the_file_comes_back_bit_for_bit(result, tmp_path):
    path = tmp_path / "accel.json"
    result.calibration.save(path)
    again = imucal.Calibration.load(path)
    assert again.gyroscope is None and again.to_dict() == result.calibration.to_dict()
    document = json.loads(path.read_text())
    document["raw_units"]["gyroscope"] = "rad/s"
    path.write_text(json.dumps(document))
    with pytest.raises(imucal.FormatError, match=r"\$.gyroscope is null, but \$.raw_units.gyroscope is not"):
        imucal.Calibration.load(path)


def test_a_control_recording_judges_it(run, result):
    control = run[1].recording
    judged = imucal.evaluate(result.calibration, control.of_sensor("accelerometer"))
    assert judged.verdict == "good" and judged.moves == () and judged.carried == ()
    # The gyroscope columns of a recording are not used.
    assert imucal.evaluate(result.calibration, control).figures == judged.figures
    wrong = imucal.Recording(control.time_s, 1.02 * control.specific_force)
    assert imucal.evaluate(result.calibration, wrong).verdict != "good"


def test_samples_of_one_sensor_are_corrected(run, result, alone):
    corrected = result.calibration.apply_recording(alone)
    assert corrected.angular_rate is None
    rate, force = result.calibration.apply(None, alone.specific_force)
    assert rate is None and np.array_equal(force, corrected.specific_force)
    # A raw gyroscope in a corrected recording would look corrected.
    assert result.calibration.apply_recording(run[0].recording).angular_rate is None
    with pytest.raises(imucal.InputError, match="sensor_missing"):
        result.calibration.apply(run[0].recording.angular_rate, alone.specific_force)
    both = imucal.calibrate(run[0].recording).calibration
    whole = both.apply_recording(run[0].recording)
    assert np.allclose(both.apply_recording(alone).specific_force, whole.specific_force, rtol=0, atol=1e-12)


def test_an_inspection_names_what_is_determined(alone, result):
    seen = imucal.inspect(alone)
    assert seen.usable and seen.missing is None and seen.gyro_unit is None
    assert [(p.name, p.std) for p in seen.predicted_sigma] == [(p.name, p.std) for p in result.parameters]
    few = imucal.inspect(alone.between(0.0, 20.0))
    assert "do not determine the accelerometer" in few.missing and "gyroscope" not in few.missing
    assert {p.std for p in few.predicted_sigma} == {None}


def test_nine_rests_leave_nothing_to_test_the_result(result):
    faces = np.array([sign * np.eye(3)[axis] for axis in range(3) for sign in (1, -1)])
    edges = np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1]]) / np.sqrt(2)
    nine = imucal.Means(specific_force=9.80665 * np.vstack((faces, edges)))
    exact = imucal.calibrate(nine, noise_mps2=0.001)
    assert exact.verdict == "incomplete" and "determine 9 parameters exactly" in exact.reasons[0]


@pytest.mark.parametrize(
    "call",
    [
        lambda r, c: imucal.calibrate(r, effects=["accel_scale_quadratic"]),
        lambda r, c: imucal.calibrate(r, folds=3),
        lambda r, c: imucal.calibrate([r, r.between(0, 20).of_sensor("accelerometer")], unit="bmi088"),
        lambda r, c: imucal.find_gap(r),
        lambda r, c: imucal.export(c, "basalt"),
        lambda r, c: imucal.export(c, "kalibr"),
        lambda r, c: imucal.find_gap(r, calibration=c),
    ],
)
def test_what_needs_a_gyroscope_says_so(call, alone, result):
    with pytest.raises(imucal.InputError, match="sensor_missing"):
        call(alone, result.calibration)


def test_sensors_may_not_be_mixed(run, alone):
    with pytest.raises(imucal.InputError, match=r"has a gyroscope, but .* has none .sensor_missing"):
        imucal.calibrate([alone, run[1].recording])
    both = imucal.calibrate(run[0].recording).calibration
    with pytest.raises(imucal.InputError, match="there is no gyroscope in this recording"):
        imucal.evaluate(both, alone)
    only_gyro = run[0].recording.of_sensor("gyroscope")
    with pytest.raises(imucal.InputError, match="there is no accelerometer"):
        imucal.calibrate(only_gyro)
    with pytest.raises(imucal.InputError, match="neither a specific_force nor an angular_rate"):
        imucal.Recording([0.0, 1.0])


def test_the_formats_that_can_be_written_without_a_gyroscope(result):
    text = imucal.export(result.calibration, "ardupilot").text
    assert "INS_ACCOFFS_X" in text and "INS_GYROFFS_X" not in text
    assert "CAL_GYRO0_XOFF" not in imucal.export(result.calibration, "px4").text
    assert "raw_rate" not in imucal.export(result.calibration, "c-header").text
    assert "gyro" not in imucal.export(result.calibration, "matlab").text.partition("function")[2]
    assert imucal.export(result.calibration, "ros").same_as.gyroscope is None
    for format in ("ardupilot", "c-header", "inav"):
        units = re.search(r"Units: .*", imucal.export(result.calibration, format).text)[0]
        assert "(accelerometer alone)" in units and "rad/s" not in units and "deg/s" not in units


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_file_without_gyroscope_columns_is_read(alone, ending, tmp_path):
    path = tmp_path / f"run.{ending}"
    imucal.write(alone, path)
    again = imucal.read(path)
    assert again.angular_rate is None and np.array_equal(again.specific_force, alone.specific_force)
    assert [finding.code for finding in again.findings] == ["sensor_missing"]
    assert imucal.Recording(again.time_s, again.specific_force).sensors == ("accelerometer",)


def test_a_data_frame_without_gyroscope_columns_is_a_recording(alone):
    table = alone.to_arrow()
    assert not set(GYRO_COLUMNS) & set(table.column_names)
    assert imucal.calibrate(table).calibration.gyroscope is None


def test_a_gyroscope_under_another_name_is_not_overlooked(tmp_path):
    path = tmp_path / "run.csv"
    rows = "\n".join(f"{k / 100},0,0,9.8,0,0,0" for k in range(200))
    path.write_text(f"time_s,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyr_x,gyr_y,gyr_z\n{rows}\n")
    with pytest.raises(imucal.FormatError, match=r"every unit: .*--columns 'gyro_x_dps=gyr_x"):
        imucal.read(path)


def test_a_file_of_a_phone_is_read_by_its_header(alone, tmp_path):
    path = tmp_path / "Accelerometer.csv"
    columns = np.column_stack([alone.time_s, alone.specific_force])[:2000]
    rows = "\n".join(",".join(map(repr, row)) for row in columns.tolist())
    path.write_text(f'"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"\n{rows}\n')
    recording = imucal.read(path)
    assert recording.angular_rate is None
    assert np.array_equal(recording.specific_force, alone.specific_force[:2000])
    assert {finding.code for finding in recording.findings} == {"read_by_header", "sensor_missing"}


def test_noise_of_one_sensor():
    still = imucal.simulate(imucal.Static(60.0), unit="bmi088", seed=1, rate_hz=100.0).recording
    both = imucal.noise(still, threads=1)
    for sensor, prefix in (("accelerometer", "accel"), ("gyroscope", "gyro")):
        found = imucal.noise(still.of_sensor(sensor), threads=1)
        assert list(found.axes) == [f"{prefix}_{axis}" for axis in "xyz"]
        for name, axis in found.axes.items():
            same = both.axes[name].noise_density
            assert abs(axis.noise_density.value - same.value) < 0.02 * same.value
        with pytest.raises(imucal.InputError, match="sensor_missing"):
            found.triad({"accel": "gyro", "gyro": "accel"}[prefix])
