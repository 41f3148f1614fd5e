"""Exports that are read back, and imported calibrations that are exported."""

import dataclasses

import numpy as np
import pytest

import imucal
from autopilot_imports import COUNTS
from import_files import B_ACCEL, B_GYRO, FORCE, RATE, S_ACCEL, S_GYRO, UNIT, WARM, assert_same


@pytest.mark.parametrize("name", ["kalibr", "openvins", "basalt", "realsense", "ros"])
def test_an_export_is_read_back(name, tmp_path):
    exported = imucal.export(UNIT, name)
    path = tmp_path / "exported"
    exported.save(path)
    biases = {"accel_bias": B_ACCEL, "gyro_bias": B_GYRO} if name in ("kalibr", "openvins") else {}
    found = imucal.read_calibration(path, **biases)
    rate, force = exported.same_as.apply(RATE, FORCE)
    if name == "ros":
        # The file has no gyroscope.
        np.testing.assert_allclose(found.apply(None, FORCE)[1], force, rtol=0, atol=1e-11)
        return
    assert_same(found, rate, force)


def test_a_realsense_table_is_read_back(tmp_path):
    exported = imucal.export(UNIT, "realsense-table")
    exported.save(tmp_path / "eeprom.bin")
    found = imucal.read_calibration(tmp_path / "eeprom.bin").apply(RATE, FORCE)
    # The numbers are float32.
    for values, expected in zip(found, exported.same_as.apply(RATE, FORCE), strict=True):
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_inav_commands_are_read_back(tmp_path):
    counts = dataclasses.replace(
        UNIT,
        accelerometer=imucal.Triad(np.diag([204.0, 211.0, 209.0]), [31.2, -24.4, 95.9]),
        gyroscope=imucal.Triad(np.diag([938.0, 941.0, 940.0]), [17.3, -44.8, 51.0]),
        frame="symmetric",
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    exported = imucal.export(counts, "inav")
    exported.save(tmp_path / "inav.txt")
    assert_same(imucal.read_calibration(tmp_path / "inav.txt"), *exported.same_as.apply(*COUNTS), raw=COUNTS)


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_parameters_of_an_export_are_read_back(name, tmp_path):
    warm = imucal.EffectValues("gyro_bias_temperature", [2e-4, -3e-4, 1e-4, 2e-6, 4e-6, -3e-6])
    unit = imucal.Calibration(
        imucal.Triad(np.diag([0.98, 1.02, 0.99]), B_ACCEL), imucal.Triad(np.eye(3), B_GYRO), effects=(warm,)
    )
    path = tmp_path / "exported.param"
    exported = imucal.export(unit, name)
    exported.save(path)
    found, expected = (c.apply_recording(WARM) for c in (imucal.read_calibration(path), exported.same_as))
    # The parameters are float32.
    np.testing.assert_allclose(found.angular_rate, expected.angular_rate, rtol=0, atol=2e-7)
    np.testing.assert_allclose(found.specific_force, expected.specific_force, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "name", ["kalibr", "basalt", "realsense", "ros", "c-header", "rust", "matlab", "fusion"]
)
def test_an_imported_calibration_is_exported(name, tmp_path):
    """Also from the frame of another program, in which the accelerometer has nine free entries."""
    given = imucal.Calibration(
        imucal.Triad(np.linalg.inv(S_ACCEL), B_ACCEL),
        imucal.Triad(np.linalg.inv(S_GYRO), B_GYRO),
        frame="given",
    )
    exported = imucal.export(given, name)
    rate, force = exported.same_as.apply(RATE, FORCE)
    expected_rate, expected_force = given.apply(RATE, FORCE)
    if name == "ros":
        rate = expected_rate
    imported = imucal.Imported("ros", "imu_calib", "f", (imucal.Source("their.yaml", "0" * 64),))
    made = dataclasses.replace(given, provenance=imucal.Provenance(imported=imported))
    assert "from their.yaml of imu_calib" in " ".join(imucal.export(made, name).text.split())
    rotation = np.linalg.lstsq(expected_force, force, rcond=None)[0].T
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(force, expected_force @ rotation.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(rate, expected_rate @ rotation.T, rtol=0, atol=1e-11)
