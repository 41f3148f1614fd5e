"""Calibrations of RealSense cameras against the formula of their library."""

import numpy as np
import pytest
import yaml

import imucal
from import_files import (
    B_ACCEL,
    B_GYRO,
    FORCE,
    RATE,
    S_ACCEL,
    S_GYRO,
    assert_same,
    same_after_a_file,
    written,
)
from realsense_imports import REALSENSE, realsense_corrected, realsense_table


def test_realsense_calibration_json(tmp_path):
    imu = {}
    for sensor, matrix, bias in (("accelerometer", S_ACCEL, B_ACCEL), ("gyroscope", S_GYRO, B_GYRO)):
        # rs-imu-calibration.py: corrected^T = (raw, -1)^T X, and X.flatten() is in the file.
        x = np.vstack((matrix.T, bias))
        imu[sensor] = {"scale_and_alignment": x.flatten()[:9].tolist(), "bias": x.flatten()[9:].tolist()}
    path = written(tmp_path, "calibration.json", {"device_type": "D435i", "imus": [imu]})
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    assert_same(
        calibration,
        realsense_corrected(S_GYRO, B_GYRO, RATE),
        realsense_corrected(S_ACCEL, B_ACCEL, FORCE),
    )
    assert calibration.frame == "given" and "depth sensor" in calibration.provenance.imported.notes[0]


def test_realsense_t265_is_refused_by_name(tmp_path):
    path = written(tmp_path, "calibration.json", {**REALSENSE, "device_type": "T265"})
    with pytest.raises(imucal.InputError, match=r"calibration\.json is of a T265"):
        imucal.read_calibration(path)


@pytest.mark.parametrize("files", [1, 2])
def test_realsense_imu_info(files, tmp_path):
    # realsense-ros fills `data` row by row from rs2_motion_device_intrinsic, whose rows are (S | bias).
    messages = [
        {
            "header": {"frame_id": f"camera_{name}_optical_frame"},
            "data": np.column_stack((matrix, bias)).ravel().tolist(),
            "noise_variances": [0.0, 0.0, 0.0],
            "bias_variances": [0.0, 0.0, 0.0],
        }
        for name, matrix, bias in (("gyro", S_GYRO, B_GYRO), ("accel", S_ACCEL, B_ACCEL))
    ]
    texts = [yaml.dump(message) + "---\n" for message in messages]
    texts = texts if files == 2 else ["".join(texts)]
    paths = [written(tmp_path, f"info{k}.yaml", text) for k, text in enumerate(texts)]
    assert_same(
        imucal.read_calibration(*paths),
        realsense_corrected(S_GYRO, B_GYRO, RATE),
        realsense_corrected(S_ACCEL, B_ACCEL, FORCE),
    )


def test_realsense_table(tmp_path):
    path = tmp_path / "eeprom.bin"
    path.write_bytes(realsense_table((S_ACCEL, B_ACCEL), (S_GYRO, np.degrees(B_GYRO))))
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    # get_intrinsic multiplies the bias of the gyroscope in the table, float32, by pi / 180.
    singles = [np.float64(np.float32(part)) for part in (S_GYRO, np.degrees(B_GYRO), S_ACCEL, B_ACCEL)]
    assert_same(
        calibration,
        realsense_corrected(singles[0], singles[1] * np.pi / 180, RATE),
        realsense_corrected(singles[2], singles[3], FORCE),
    )
    assert calibration.provenance.imported.format == "realsense-table"
    assert not any("rad/s" in note for note in calibration.provenance.imported.notes)


def test_a_realsense_table_of_the_tool_has_a_note(tmp_path):
    """It has the bias of the gyroscope in rad/s, and the camera takes deg/s."""
    path = tmp_path / "eeprom.bin"
    path.write_bytes(realsense_table((np.eye(3), B_ACCEL), (np.eye(3), [0.004, -0.002, 0.001])))
    assert "corrects only 1/57" in imucal.read_calibration(path).provenance.imported.notes[-1]


def test_a_damaged_realsense_table_is_named(tmp_path):
    whole = realsense_table((S_ACCEL, B_ACCEL), (S_GYRO, B_GYRO))
    changed = whole[:150] + bytes([whole[150] ^ 1]) + whole[151:]
    cases = {
        whole[:-8]: "has 512 bytes: a table has 520",
        changed: "the CRC is wrong",
        realsense_table((S_ACCEL, B_ACCEL), (S_GYRO, B_GYRO), valid=0): "no valid intrinsics",
        realsense_table((S_ACCEL, B_ACCEL), (S_GYRO, B_GYRO * np.nan)): "a number is not finite",
        realsense_table((S_ACCEL * 0, B_ACCEL), (S_GYRO, B_GYRO)): "a matrix is singular",
    }
    path = tmp_path / "eeprom.bin"
    for data, message in cases.items():
        path.write_bytes(data)
        with pytest.raises(imucal.FormatError, match=message):
            imucal.read_calibration(path)
