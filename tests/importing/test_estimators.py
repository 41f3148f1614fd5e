"""Calibrations of Kalibr, OpenVINS, Basalt and ROS against the formulas of these programs.

Each formula names the file and function of the other program.
"""

import numpy as np
import pytest
import yaml

import imucal
from estimator_imports import TRIANGLES, kalibr_block, kalibr_corrected, openvins_block, openvins_corrected
from import_files import (
    B_ACCEL,
    B_GYRO,
    FORCE,
    LOWER,
    RANDOM,
    RATE,
    ROTATION,
    S_ACCEL,
    S_GYRO,
    assert_same,
    assert_same_recording,
    corrected_by_command,
    same_after_a_file,
    written,
)


# As newer and older versions of PyYAML write nested lists.
@pytest.mark.parametrize("flow", [None, False])
def test_kalibr(flow, tmp_path):
    block = kalibr_block()
    path = written(tmp_path, "results-imucam.yaml", yaml.dump({"imu0": block}, default_flow_style=flow))
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    assert_same(calibration, *kalibr_corrected(block, np.zeros(3), np.zeros(3)))
    assert calibration.frame == "triangular"
    assert calibration.noise == {
        "accel_noise_density_mps2_per_sqrt_hz": 0.0018,
        "gyro_random_walk_radps2_per_sqrt_hz": 2.5e-5,
    }
    missing = calibration.provenance.imported.missing
    assert {"accel_bias", "gyro_bias", "covariance", "gravity"} <= set(missing) and "noise" not in missing


def test_kalibr_with_the_biases_of_an_estimator(tmp_path):
    block = kalibr_block()
    path = written(tmp_path, "imu.yaml", yaml.dump({"imu0": block}))
    calibration = imucal.read_calibration(path, accel_bias=B_ACCEL, gyro_bias=B_GYRO)
    assert_same(calibration, *kalibr_corrected(block, B_ACCEL, B_GYRO))
    assert not {"accel_bias", "gyro_bias"} & set(calibration.provenance.imported.missing)


def test_kalibr_second_imu_and_its_frame(tmp_path):
    rotated = np.eye(4)
    rotated[:3, :3] = ROTATION
    second = kalibr_block(T_i_b=rotated.tolist())
    second["accelerometers"] = {"M": (1.1 * LOWER).tolist()}
    path = written(tmp_path, "two.yaml", yaml.dump({"imu0": kalibr_block(), "imu1": second}))
    calibration = imucal.read_calibration(path, instance=1)
    assert_same(calibration, *kalibr_corrected(second, np.zeros(3), np.zeros(3)))
    notes = " ".join(calibration.provenance.imported.notes)
    assert "T_i_b" in notes and "imu0" in notes
    with pytest.raises(imucal.InputError, match=r"imu0, imu1, but no imu2"):
        imucal.read_calibration(path, instance=2)


@pytest.mark.parametrize("x", [[0.0, 0.0, 0.0], [0.004, -0.002, 0.003]])
def test_kalibr_size_effect(x, tmp_path):
    positions = np.array([x, [0.01, -0.02, 0.005], [-0.007, 0.004, 0.03]])
    block = kalibr_block(model="scale-misalignment-size-effect")
    block["accelerometers"] |= dict(zip(("rx_i", "ry_i", "rz_i"), positions.tolist(), strict=True))
    block["gyroscopes"]["A"] = np.zeros((3, 3)).tolist()
    calibration = imucal.read_calibration(written(tmp_path, "k.yaml", yaml.dump({"imu0": block})))
    # IccScaledMisalignedSizeEffectImu: M (f + the component i of dw x r_i + w x (w x r_i)). The angular
    # acceleration of a constant rate is zero.
    rate, force = np.tile([0.7, -1.9, 1.2], (400, 1)), FORCE
    centripetal = [np.cross(rate, np.cross(rate, r)) for r in positions]
    seen = force + np.column_stack([centripetal[i][:, i] for i in range(3)])
    gyro = np.tril(S_GYRO) @ ROTATION
    raw = imucal.Recording(np.arange(400) / 100.0, seen @ LOWER.T, rate @ gyro.T)
    assert_same_recording(calibration, raw, rate, force)


def test_kalibr_noise_alone(tmp_path):
    text = (
        "%YAML:1.0\naccelerometer_noise_density: 1.86e-03\ngyroscope_noise_density: 2e-4\nupdate_rate: 200\n"
    )
    calibration = imucal.read_calibration(written(tmp_path, "imu.yaml", text))
    assert_same(calibration, RATE, FORCE)
    assert calibration.noise["gyro_noise_density_radps_per_sqrt_hz"] == 2e-4
    assert {"accel_scale", "gyro_misalignment"} <= set(calibration.provenance.imported.missing)


@pytest.mark.parametrize("model", TRIANGLES)
def test_openvins(model, tmp_path):
    block = openvins_block(model=model)
    # As the files of OpenVINS begin; OpenCV accepts the comment.
    text = f"%YAML:1.0 # need to specify the file type at the top!\n\n{yaml.dump({'imu0': block})}"
    path = written(tmp_path, "kalibr_imu_chain.yaml", text)
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    assert calibration.provenance.imported.format == "openvins"
    assert_same(calibration, *openvins_corrected(block, np.zeros(3), np.zeros(3)))
    assert calibration.noise == {
        "accel_noise_density_mps2_per_sqrt_hz": 0.0028,
        "gyro_random_walk_radps2_per_sqrt_hz": 2.2e-5,
    }
    missing = calibration.provenance.imported.missing
    assert {"accel_bias", "gyro_bias", "covariance"} <= set(missing) and "noise" not in missing
    known = imucal.read_calibration(path, accel_bias=B_ACCEL, gyro_bias=B_GYRO)
    assert_same(known, *openvins_corrected(block, B_ACCEL, B_GYRO))


@pytest.mark.parametrize("wrapped", [True, False])
def test_basalt(wrapped, tmp_path):
    accel = np.concatenate((B_ACCEL, RANDOM.uniform(-0.4, 0.4, 6)))
    gyro = np.concatenate((B_GYRO, RANDOM.uniform(-0.4, 0.4, 9)))
    fields = {
        "calib_accel_bias": accel.tolist(),
        "calib_gyro_bias": gyro.tolist(),
        "accel_noise_std": [0.016, 0.017, 0.018],
        "gyro_noise_std": 0.000282,
    }
    path = written(tmp_path, "calibration.json", {"value0": fields} if wrapped else fields)
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    # calib_bias.hpp: getBiasAndScale fills the columns, getCalibrated is raw + scale * raw - bias.
    accel_scale, gyro_scale = np.zeros((3, 3)), np.zeros((3, 3))
    accel_scale[:, 0] = accel[3:6]
    accel_scale[1, 1], accel_scale[2, 1], accel_scale[2, 2] = accel[6], accel[7], accel[8]
    for column in range(3):
        gyro_scale[:, column] = gyro[3 + 3 * column : 6 + 3 * column]
    rate = np.array([raw + gyro_scale @ raw - gyro[:3] for raw in RATE])
    force = np.array([raw + accel_scale @ raw - accel[:3] for raw in FORCE])
    assert_same(calibration, rate, force)
    assert calibration.frame == "triangular"
    assert calibration.noise["accel_noise_density_z_mps2_per_sqrt_hz"] == 0.018
    assert calibration.noise["gyro_noise_density_y_radps_per_sqrt_hz"] == 0.000282


def test_ros_imu_calib(tmp_path):
    text = yaml.dump({"SM": S_ACCEL.ravel().tolist(), "bias": B_ACCEL.tolist()})
    calibration = imucal.read_calibration(written(tmp_path, "imu_calib.yaml", text))
    # accel_calib.cpp: loadCalib fills SM_(i/3, i%3), applyCalib is SM_*raw_accel - bias_.
    force = np.array([S_ACCEL @ raw - B_ACCEL for raw in FORCE])
    alone = imucal.Recording(np.arange(400) / 100.0, FORCE)
    for found in (calibration.apply(None, FORCE)[1], corrected_by_command(calibration, alone).specific_force):
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-12 * np.abs(force).max())
    assert "gyroscope" in calibration.provenance.imported.missing
    assert same_after_a_file(calibration, tmp_path).gyroscope is None
    # apply_calib.cpp: the gyroscope minus the mean rate of the first samples.
    with_mean = imucal.read_calibration(tmp_path / "imu_calib.yaml", gyro_bias=B_GYRO)
    np.testing.assert_allclose(with_mean.apply(RATE, FORCE)[0], RATE - B_GYRO, rtol=0, atol=1e-15)
    assert "gyro_scale" in with_mean.provenance.imported.missing
