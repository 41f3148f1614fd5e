"""Calibrations of imu_tk and of the Ferraris method against the formulas of these programs."""

import numpy as np
import pytest

import imucal
from import_files import B_ACCEL, FORCE, RATE, S_ACCEL, S_GYRO, assert_same, same_after_a_file, written
from laboratory_imports import GYRO_MISALIGNMENT, MISALIGNMENT, imu_tk_text


@pytest.mark.parametrize("unit", ["lsb", "m/s^2"])
def test_imu_tk(unit, tmp_path):
    scales = np.array([[0.0024, 0.0025, 0.0023], [2.1e-4, 2.3e-4, 1.9e-4]])
    biases = np.array([[33123.0, 33275.0, 32364.0], [32777.0, 32459.0, 32511.0]])
    raw = (RATE * 4800 + 32500, FORCE * 415 + 32900)
    if unit != "lsb":
        scales, biases, raw = scales * [[415.0], [4800.0]], biases * 1e-5, (RATE, FORCE)
    paths = [
        written(tmp_path, f"test_imu_{name}.calib", imu_tk_text(matrix, scale, bias))
        for name, matrix, scale, bias in zip(
            ("acc", "gyro"), (MISALIGNMENT, GYRO_MISALIGNMENT), scales, biases, strict=True
        )
    ]
    calibration = same_after_a_file(imucal.read_calibration(*paths), tmp_path)
    assert calibration.accel_unit == unit
    # calibration.h, unbiasNormalize: ms_mat_ (raw - bias_vec_), ms_mat_ = mis_mat_ * scale_mat_.
    force = (raw[1] - biases[0]) @ (MISALIGNMENT @ np.diag(scales[0])).T
    rate = (raw[0] - biases[1]) @ (GYRO_MISALIGNMENT @ np.diag(scales[1])).T
    assert_same(calibration, rate, force, raw=raw)


def test_imu_tk_in_g_and_degrees_per_second(tmp_path):
    paths = [
        written(tmp_path, f"{name}.txt", imu_tk_text(matrix, scale, bias))
        for name, matrix, scale, bias in (
            ("acc", MISALIGNMENT, 9.80665 * np.array([0.99, 1.01, 1.02]), np.array([0.01, -0.02, 0.03])),
            ("gyro", GYRO_MISALIGNMENT, np.deg2rad([0.98, 1.01, 1.03]), np.array([1.2, -0.3, 0.4])),
        )
    ]
    with pytest.raises(imucal.InputError, match=r"may be g or counts: give accel_unit='g'"):
        imucal.read_calibration(*paths)
    calibration = imucal.read_calibration(*paths, accel_unit="g", gyro_unit="deg/s")
    in_g, in_degrees = FORCE / 9.80665, np.rad2deg(RATE)
    force = (in_g - [0.01, -0.02, 0.03]) @ (MISALIGNMENT @ np.diag(9.80665 * np.array([0.99, 1.01, 1.02]))).T
    rate = (in_degrees - [1.2, -0.3, 0.4]) @ (GYRO_MISALIGNMENT @ np.diag(np.deg2rad([0.98, 1.01, 1.03]))).T
    assert_same(calibration, rate, force)
    with pytest.raises(imucal.InputError, match=r"the file of the accelerometer and that of the gyroscope"):
        imucal.read_calibration(written(tmp_path, "unnamed.txt", paths[0].read_text()))
    with pytest.raises(imucal.InputError, match=r"gyro\.txt: a calibration of a gyroscope alone"):
        imucal.read_calibration(paths[1], gyro_unit="deg/s")
    alone = imucal.read_calibration(paths[0], accel_unit="g")
    assert alone.gyroscope is None and "gyroscope" in alone.provenance.imported.missing


@pytest.mark.parametrize("raw_unit", ["a.u.", "SI"])
def test_ferraris(raw_unit, tmp_path):
    size = (1.0, 1.0) if raw_unit == "SI" else (208.0, 16.0)
    fields = {
        "K_a": np.diag([1.02, 0.97, 1.04]) * size[0],
        "R_a": np.linalg.inv(S_ACCEL),
        "b_a": 3.0 * B_ACCEL * size[0],
        "K_g": np.diag([0.99, 1.03, 0.96]) * size[1],
        "R_g": np.linalg.inv(S_GYRO),
        "b_g": np.array([2.0, -1.1, 0.7]) * size[1],
        "K_ga": 0.01 * S_ACCEL * size[1],
    }
    units = {"acc_unit": "m/s^2", "gyr_unit": "deg/s", "from_acc_unit": "a.u.", "from_gyr_unit": "a.u."}
    raw_accel, raw_gyro = FORCE * size[0], np.rad2deg(RATE) * size[1]
    raw = (raw_gyro, raw_accel)
    if raw_unit == "SI":
        units |= {"from_acc_unit": "m/s^2", "from_gyr_unit": "deg/s"}
        raw = (np.deg2rad(raw_gyro), raw_accel)
    document = {name: value.tolist() for name, value in fields.items()} | units
    calibration = imucal.read_calibration(written(tmp_path, "ferraris.json", document))
    # ferraris_calibration_info.py, calibrate_acc and calibrate_gyro.
    acc = (np.linalg.inv(fields["R_a"]) @ np.linalg.inv(fields["K_a"]) @ (raw_accel - fields["b_a"]).T).T
    offsets = (fields["K_ga"] @ acc.T).T + fields["b_g"]
    gyro = (np.linalg.inv(fields["R_g"]) @ np.linalg.inv(fields["K_g"]) @ (raw_gyro - offsets).T).T
    assert_same(calibration, np.deg2rad(gyro), acc, raw=raw)
    assert calibration.accel_unit == ("m/s^2" if raw_unit == "SI" else "lsb")
    # A gyroscope of reversed sign, as in recordings of some sensors.
    reversed_sign = document | {
        "R_g": (-fields["R_g"]).tolist(),
        "R_a": np.eye(3).tolist(),
        "K_ga": [[0.0] * 3] * 3,
    }
    calibration = imucal.read_calibration(written(tmp_path, "reversed.json", reversed_sign))
    rate = same_after_a_file(calibration, tmp_path).apply(*raw)[0]
    gyro = -np.linalg.inv(fields["R_g"]) @ np.linalg.inv(fields["K_g"]) @ (raw_gyro - fields["b_g"]).T
    np.testing.assert_allclose(rate, np.deg2rad(gyro.T), rtol=0, atol=1e-12 * np.abs(rate).max())
    del document["K_ga"]
    with pytest.raises(imucal.FormatError, match=r"\$\.K_ga is missing"):
        imucal.read_calibration(written(tmp_path, "half.json", document))
