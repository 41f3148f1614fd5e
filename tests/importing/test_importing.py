"""Calibrations of other programs against the consumers' own formulas, written here from their sources.

The matrices are random, neither symmetric nor close to the identity, so that a transposed or inverted matrix
fails. Each formula names the file and function of the other program.
"""

import dataclasses
import json
import struct
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import jsonschema
import numpy as np
import pytest
import yaml

import imucal
from imucal.cli import main
from imucal.importing import READERS, readers_markdown

ROOT = Path(__file__).resolve().parents[2]

SCHEMA = json.loads((Path(imucal.__file__).parent / "schema" / "calibration-1.json").read_text())
RANDOM = np.random.default_rng(11)
RATE, FORCE = RANDOM.normal(0, 2, (400, 3)), RANDOM.normal(0, 10, (400, 3))
# Correction matrices (corrected = S raw - b): far from the identity, condition numbers below 10.
S_ACCEL = np.array([[0.91, 0.53, -0.42], [-0.31, 1.22, 0.27], [0.66, -0.18, 0.84]])
S_GYRO = np.array([[1.13, -0.45, 0.22], [0.58, 0.79, -0.61], [-0.24, 0.37, 1.08]])
B_ACCEL, B_GYRO = np.array([-0.42, 0.24, 0.39]), np.array([-0.035, 0.0042, 0.001])
LOWER = np.array([[0.91, 0.0, 0.0], [-0.31, 1.22, 0.0], [0.66, -0.18, 0.84]])
ROTATION = np.linalg.qr(RANDOM.normal(size=(3, 3)))[0]
ROTATION = ROTATION * np.sign(np.linalg.det(ROTATION))


def assert_same(calibration, rate, force, *, raw=(RATE, FORCE)):
    """The corrections are those of the consumer, relative to the size of the samples."""
    found_rate, found_force = calibration.apply(*raw)
    np.testing.assert_allclose(found_rate, rate, rtol=0, atol=1e-12 * max(1.0, np.abs(rate).max()))
    np.testing.assert_allclose(found_force, force, rtol=0, atol=1e-12 * max(1.0, np.abs(force).max()))
    units = {"accel_unit": calibration.accel_unit, "gyro_unit": calibration.gyro_unit}
    recording = imucal.Recording(np.arange(len(raw[0])) / 100.0, raw[1], raw[0], **units)
    assert_same_recording(calibration, recording, rate, force)


def assert_same_recording(calibration, rec, rate, force):
    """The corrections of a recording, in Python and by `imucal apply`, are those of the consumer."""
    for corrected in (calibration.apply_recording(rec), corrected_by_command(calibration, rec)):
        for found, expected in ((corrected.angular_rate, rate), (corrected.specific_force, force)):
            atol = 1e-12 * max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def corrected_by_command(calibration, rec):
    """The recording that `imucal apply` writes; Parquet keeps every bit."""
    with TemporaryDirectory() as folder:
        paths = [str(Path(folder) / name) for name in ("unit.json", "raw.parquet", "corrected.parquet")]
        calibration.save(paths[0])
        imucal.write(rec, paths[1])
        assert main(["apply", *paths[:2], "-o", paths[2]]) == 0
        return imucal.read(paths[2])


def written(folder, name, text):
    path = folder / name
    path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
    return path


def same_after_a_file(calibration, folder):
    """The calibration file holds the same correction, and every field of the origin."""
    calibration.save(folder / "imported.json")
    jsonschema.validate(json.loads((folder / "imported.json").read_text()), SCHEMA)
    loaded = imucal.Calibration.load(folder / "imported.json")
    assert loaded.to_dict() == calibration.to_dict()
    return loaded


# --- Kalibr ---------------------------------------------------------------------------------------


def kalibr_block(**changes):
    return {
        "model": "scale-misalignment",
        "accelerometers": {"M": LOWER.tolist()},
        "gyroscopes": {
            "M": np.tril(S_GYRO).tolist(),
            "A": (1e-2 * S_ACCEL).tolist(),
            "C_gyro_i": ROTATION.tolist(),
        },
        "T_i_b": np.eye(4).tolist(),
        "accelerometer_noise_density": 0.0018,
        "gyroscope_random_walk": 2.5e-5,
        "rostopic": "/imu0",
        "update_rate": 200.0,
        **changes,
    }


def kalibr_corrected(block, force_bias, rate_bias):
    """IccSensors.py, IccScaledMisalignedImu: a = M a_i + b; w = M (C_gyro_i w_i) + A (C_gyro_i a_i) + b."""
    gyro = {name: np.array(matrix) for name, matrix in block["gyroscopes"].items()}
    force = np.linalg.solve(np.array(block["accelerometers"]["M"]), (FORCE - force_bias).T)
    from_force = gyro["A"] @ gyro["C_gyro_i"] @ force
    rate = gyro["C_gyro_i"].T @ np.linalg.solve(gyro["M"], (RATE - rate_bias).T - from_force)
    return rate.T, force.T


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


# --- OpenVINS -------------------------------------------------------------------------------------

# The upper triangle of the inverse is not the inverse of the upper triangle, so only full matrices show which
# of them is used.
TRIANGLES = {"kalibr": np.tril, "calibrated": np.tril, "rpng": np.triu}


def openvins_block(**changes):
    return {
        "T_i_b": np.eye(4).tolist(),
        "accelerometer_noise_density": 0.0028,
        "gyroscope_random_walk": 2.2e-5,
        "rostopic": "/imu0",
        "model": "kalibr",
        "Tw": S_GYRO.tolist(),
        "R_IMUtoGYRO": ROTATION.tolist(),
        "Ta": S_ACCEL.tolist(),
        "R_IMUtoACC": ROTATION.T.tolist(),
        "Tg": (1e-2 * S_ACCEL).tolist(),
        **changes,
    }


def openvins_corrected(block, force_bias, rate_bias):
    """VioManagerOptions.h: triangles of the inverses; Propagator.cpp: R_ACCtoIMU Da (a - b_a), then
    R_GYROtoIMU Dw (w - b_w - Tg a)."""
    triangle = TRIANGLES[block["model"]]
    of_accel, of_gyro = (triangle(np.linalg.inv(np.array(block[name]))) for name in ("Ta", "Tw"))
    force = np.array(block["R_IMUtoACC"]).T @ of_accel @ (FORCE - force_bias).T
    rate = np.array(block["R_IMUtoGYRO"]).T @ of_gyro @ ((RATE - rate_bias).T - np.array(block["Tg"]) @ force)
    return rate.T, force.T


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


# --- Basalt ---------------------------------------------------------------------------------------


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


# --- RealSense ------------------------------------------------------------------------------------


def realsense_corrected(sensitivity, bias, samples):
    """motion-transform.cpp: sensitivity * xyz - bias; float3.h: a * b is a.x b.x + a.y b.y + a.z b.z."""
    columns = sensitivity.T
    return np.array([columns[0] * v[0] + columns[1] * v[1] + columns[2] * v[2] - bias for v in samples])


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


def realsense_table(accel, gyro, valid=1):
    """get_IMU_Calib_Table, get_calibration_table and get_eeprom of rs-imu-calibration.py."""

    def table(version, kind, content):
        return (
            version + struct.pack("<HII", kind, len(content), 2**32 - 1) + struct.pack("<I", crc32(content))
        ) + content

    numbers = [np.concatenate((matrix.T.ravel(), bias)) for matrix, bias in (accel, gyro)]
    content = bytes([0, valid, 0, 0]) + b"\xff" * 48 + np.concatenate(numbers).astype("<f4").tobytes()
    module = table(b"\x02\x01", 0x20, content + b"\xff" * 96) + b"\xff" * 32
    image = table(b"\x02\x00", 0x20, module)
    return table(b"\x01\x01", 0x09, image + b"\xff" * (504 - len(image)))


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


# --- ROS imu_calib --------------------------------------------------------------------------------


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


# --- INAV -----------------------------------------------------------------------------------------

INAV_SETTINGS = {
    **dict(zip((f"acczero_{axis}" for axis in "xyz"), (31, -24, 96), strict=True)),
    **dict(zip((f"accgain_{axis}" for axis in "xyz"), (4180, 4016, 4137), strict=True)),
    "init_gyro_cal": "OFF",
    **dict(zip((f"gyro_zero_{axis}" for axis in "xyz"), (17, -45, 51), strict=True)),
}
COUNTS = (np.rint(RATE * 940), np.rint(FORCE * 209))


def inav_text(**changes):
    settings = INAV_SETTINGS | changes
    lines = [f"set {name} = {value}" for name, value in settings.items() if value is not None]
    # A dump also has lines that are no settings of a calibration.
    return "\n".join(
        ["# dump all", "# INAV/MATEKF405 7.1.2", "feature TX", *lines, "set acc_lpf_hz = 15", ""]
    )


def inav_corrected(per_g, per_dps, *, zero=(17, -45, 51), gain=(4180, 4016, 4137)):
    """accUpdate without its truncation, g to m/s^2, and gyroUpdateAndCalibrate, deg/s to rad/s."""
    force = (COUNTS[1] - [31, -24, 96]) * np.array(gain) / 4096 / per_g * 9.80665
    return np.deg2rad((COUNTS[0] - zero) / per_dps), force


@pytest.mark.parametrize(("per_g", "per_dps"), [(None, None), (1365.0, 16.384)])
def test_inav(per_g, per_dps, tmp_path):
    path = written(tmp_path, "dump.txt", inav_text())
    calibration = imucal.read_calibration(path, accel_lsb_per_g=per_g, gyro_lsb_per_dps=per_dps)
    same_after_a_file(calibration, tmp_path)
    assert_same(calibration, *inav_corrected(per_g or 2048, per_dps or 16.4), raw=COUNTS)
    assert (calibration.accel_unit, calibration.gyro_unit, calibration.frame) == ("lsb", "lsb", "symmetric")
    imported = calibration.provenance.imported
    assert f"acc_1G is taken as {per_g or 2048:g} counts per g" in imported.notes[0]
    assert {"accel_misalignment", "gyro_scale"} <= set(
        imported.missing
    ) and "gyro_bias" not in imported.missing


def test_inav_measures_the_zero_of_the_gyroscope_at_its_start(tmp_path):
    path = written(tmp_path, "dump.txt", inav_text(init_gyro_cal="ON"))
    calibration = imucal.read_calibration(path)
    assert_same(calibration, *inav_corrected(2048, 16.4, zero=(0, 0, 0)), raw=COUNTS)
    imported = calibration.provenance.imported
    assert "gyro_bias" in imported.missing and "at each start" in imported.notes[-1]


def test_inav_settings_that_diff_does_not_list_are_defaults(tmp_path):
    path = written(tmp_path, "diff.txt", inav_text(accgain_y=None))
    calibration = imucal.read_calibration(path)
    assert_same(calibration, *inav_corrected(2048, 16.4, gain=(4180, 4096, 4137)), raw=COUNTS)
    assert any(note.startswith("accgain_y not in the file") for note in calibration.provenance.imported.notes)


def test_the_resolution_is_for_inav_only(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    with pytest.raises(imucal.InputError, match="realsense does not use the resolution"):
        imucal.read_calibration(path, accel_lsb_per_g=2048)
    with pytest.raises(imucal.InputError, match="accel_lsb_per_g is -1"):
        imucal.read_calibration(written(tmp_path, "dump.txt", inav_text()), accel_lsb_per_g=-1)


# --- imu_tk ---------------------------------------------------------------------------------------


def imu_tk_text(misalignment, scale, bias):
    """calibration.h, save: the matrices row by row, then the bias."""
    rows = ["  ".join(repr(v) for v in row) for row in (*misalignment.tolist(), *np.diag(scale).tolist())]
    return "\n".join([*rows, *(repr(v) for v in bias.tolist())]) + "\n"


MISALIGNMENT = np.array([[1.0, -0.32, 0.21], [0.0, 1.0, -0.44], [0.0, 0.0, 1.0]])
GYRO_MISALIGNMENT = np.array([[1.0, -0.21, 0.33], [0.12, 1.0, -0.27], [-0.42, 0.17, 1.0]])


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


# --- PX4 and ArduPilot ----------------------------------------------------------------------------

ACCEL_SCALE = np.array([1.31, 0.74, 1.12])
LINEAR, SQUARE = np.array([3e-3, -2e-3, 1e-3]), np.array([4e-5, 2e-5, -3e-5])
WARM = imucal.Recording(np.arange(400) / 100.0, FORCE, RATE, temperature_degc=RANDOM.uniform(-5.0, 65.0, 400))


def px4_values(cubic=0.0, instance=0):
    values = {f"CAL_ACC{instance}_{a}OFF": v for a, v in zip("XYZ", B_ACCEL, strict=True)}
    values |= {f"CAL_ACC{instance}_{a}SCALE": v for a, v in zip("XYZ", ACCEL_SCALE, strict=True)}
    values |= {f"CAL_GYRO{instance}_{a}OFF": v for a, v in zip("XYZ", B_GYRO, strict=True)}
    values |= {f"CAL_ACC{instance}_ID": 1310988, f"CAL_GYRO{instance}_ID": 1310989}
    for letter, device, size in (("A", 1310988, 1.0), ("G", 1310989, 0.1)):
        # The thermal terms of this sensor are in another slot, which its device ID tells.
        values |= {f"TC_{letter}_ENABLE": 1, f"TC_{letter}0_ID": 42, f"TC_{letter}1_ID": device}
        values |= {f"TC_{letter}1_TREF": 40.0, f"TC_{letter}1_TMIN": -10.0, f"TC_{letter}1_TMAX": 70.0}
        for i in range(3):
            powers = (0.02 * (i + 1), LINEAR[i], SQUARE[i], cubic)
            values |= {f"TC_{letter}1_X{k}_{i}": size * v for k, v in enumerate(powers)}
    return values


def px4_corrected(values, rec, instance=0):
    """Accelerometer.hpp and Gyroscope.hpp, Correct; TemperatureCompensation.cpp, calc_thermal_offsets_3D."""

    def thermal(letter):
        c = {k: np.array([values[f"TC_{letter}1_X{k}_{i}"] for i in range(3)]) for k in range(4)}
        held = np.clip(rec.temperature_degc, values[f"TC_{letter}1_TMIN"], values[f"TC_{letter}1_TMAX"])
        delta = (held - values[f"TC_{letter}1_TREF"])[:, None]
        return c[0] + c[1] * delta + c[2] * delta**2 + c[3] * delta**3

    def vector(name):
        return np.array([values[name.format(axis)] for axis in "XYZ"])

    scale = vector(f"CAL_ACC{instance}_{{}}SCALE")
    force = (rec.specific_force - thermal("A") - vector(f"CAL_ACC{instance}_{{}}OFF")) * scale
    return rec.angular_rate - thermal("G") - vector(f"CAL_GYRO{instance}_{{}}OFF"), force


PX4_LAYOUTS = {
    "QGroundControl": lambda n, v: f"1\t1\t{n}\t{v!r}\t{6 if isinstance(v, int) else 9}",
    "param set": lambda n, v: f"param set {n} {v!r}",
    "param show": lambda n, v: f"x + {n} [12,345] : {v!r}",
}


def plain(values):
    return {name: value if isinstance(value, int) else float(value) for name, value in values.items()}


@pytest.mark.parametrize("instance", [0, 1])
@pytest.mark.parametrize("layout", PX4_LAYOUTS)
def test_px4(layout, instance, tmp_path):
    values = plain(px4_values(instance=instance))
    # The first lines of QGroundControl, and of the console.
    head = ["# Onboard parameters for Vehicle 1", "#", "# Stack: PX4 Pro", "Symbols: x = used, + = saved"]
    lines = [*head, *(PX4_LAYOUTS[layout](*item) for item in values.items())]
    path = written(tmp_path, "vehicle.params", "\n".join(lines))
    calibration = same_after_a_file(imucal.read_calibration(path, instance=instance), tmp_path)
    assert_same_recording(calibration, WARM, *px4_corrected(values, WARM, instance))
    assert calibration.temperature_range_degc == (-10.0, 70.0)


def test_px4_of_old_versions_scales_the_gyroscope(tmp_path):
    values = plain(px4_values()) | {
        f"CAL_GYRO0_{a}SCALE": v for a, v in zip("XYZ", (1.2, 0.9, 1.1), strict=True)
    }
    text = "\n".join(PX4_LAYOUTS["QGroundControl"](*item) for item in values.items())
    calibration = imucal.read_calibration(written(tmp_path, "old.params", text))
    # Module sensors of old versions: (raw - thermal - offset) * scale for the gyroscope too.
    rate, force = px4_corrected(values, WARM)
    assert_same_recording(calibration, WARM, rate * [1.2, 0.9, 1.1], force)
    assert "gyro_scale" not in calibration.provenance.imported.missing
    text += "\n" + PX4_LAYOUTS["QGroundControl"]("TC_G1_SCL_0", 1.01)
    with pytest.raises(imucal.InputError, match="TC_G1_SCL is not 1"):
        imucal.read_calibration(written(tmp_path, "older.params", text))


def ardupilot_values(cubic=0.0, instance=0):
    number, other = ("", "2", "3")[instance], instance + 1
    values = {f"INS_ACC{number}OFFS_{a}": v for a, v in zip("XYZ", B_ACCEL, strict=True)}
    values |= {f"INS_ACC{number}SCAL_{a}": v for a, v in zip("XYZ", ACCEL_SCALE, strict=True)}
    gyro = f"INS_GYR{number}OFFS" if number else "INS_GYROFFS"
    values |= {f"{gyro}_{a}": v for a, v in zip("XYZ", B_GYRO, strict=True)}
    values |= {f"INS_ACC{other}_CALTEMP": 43.5, f"INS_GYR{other}_CALTEMP": -300.0}
    group = f"INS_TCAL{other}"
    values |= {f"{group}_ENABLE": 1.0, f"{group}_TMIN": -8.0, f"{group}_TMAX": 66.0}
    for name, size in (("ACC", 1.0), ("GYR", 0.1)):
        for i, axis in enumerate("XYZ"):
            for k, value in ((1, LINEAR[i]), (2, SQUARE[i]), (3, cubic)):
                values[f"{group}_{name}{k}_{axis}"] = 1e6 * size * value
    return values


def ardupilot_corrected(values, rec, instance=0):
    """AP_InertialSensor_Backend.cpp, _rotate_and_correct_accel; AP_InertialSensor_tempcal.cpp."""
    number, other = ("", "2", "3")[instance], instance + 1
    group = f"INS_TCAL{other}"

    def vector(name):
        return np.array([values[f"{name}_{axis}"] for axis in "XYZ"])

    def polynomial(name, degc):
        # correct_sensor clamps both temperatures; polynomial_eval.
        x = np.reshape(np.clip(degc, values[f"{group}_TMIN"], values[f"{group}_TMAX"]) - 35.0, (-1, 1))
        c = [vector(f"{group}_{name}{k}") for k in (1, 2, 3)]
        return (c[0] + (c[1] + c[2] * x) * x) * x * 1.0e-6

    def thermal(name):
        at_calibration = polynomial(name, values[f"INS_{name}{other}_CALTEMP"])
        return polynomial(name, rec.temperature_degc) - at_calibration

    force = (rec.specific_force - thermal("ACC") - vector(f"INS_ACC{number}OFFS")) * vector(
        f"INS_ACC{number}SCAL"
    )
    gyro = f"INS_GYR{number}OFFS" if number else "INS_GYROFFS"
    return rec.angular_rate - thermal("GYR") - vector(gyro), force


ARDUPILOT_LAYOUTS = {"comma": "{},{!r}", "space": "{} {!r}", "tab": "{}\t{!r}", "persistent": "{}={!r}"}


@pytest.mark.parametrize("instance", [0, 1, 2])
@pytest.mark.parametrize("layout", ARDUPILOT_LAYOUTS)
def test_ardupilot(layout, instance, tmp_path):
    values = plain(ardupilot_values(instance=instance))
    text = "\n".join(["#NOTE: 2026", *(ARDUPILOT_LAYOUTS[layout].format(*item) for item in values.items())])
    path = written(tmp_path, "copter.param", text)
    calibration = same_after_a_file(imucal.read_calibration(path, instance=instance), tmp_path)
    assert_same_recording(calibration, WARM, *ardupilot_corrected(values, WARM, instance))


AUTOPILOTS = {
    "px4": (px4_values, px4_corrected, "{} {}"),
    "ardupilot": (ardupilot_values, ardupilot_corrected, "{},{}"),
}


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_cubic_thermal_terms(name, tmp_path):
    """As fits of autopilots have them; they are constant at temperatures outside of their range."""
    make, formula, layout = AUTOPILOTS[name]
    values = plain(make(cubic=1e-6))
    prefix = "param set " if name == "px4" else ""
    text = "\n".join(prefix + layout.format(n, repr(v)) for n, v in values.items())
    path = written(tmp_path, "cubic.param", text)
    hot = dataclasses.replace(WARM, temperature_degc=np.linspace(-40.0, 100.0, 400))
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    assert_same_recording(calibration, hot, *formula(values, hot))
    at_one = imucal.read_calibration(path, temperature_degc=51.0)
    at_51 = dataclasses.replace(WARM, temperature_degc=np.full(400, 51.0))
    assert_same_recording(at_one, at_51, *formula(values, at_51))
    assert at_one.temperature_range_degc == (51.0, 51.0) and not at_one.effects


def test_an_autopilot_that_rotates_after_the_correction_is_noted(tmp_path):
    values = plain(px4_values()) | {"CAL_ACC0_ROT": 8, "CAL_GYRO0_ROT": 8}
    text = "\n".join(PX4_LAYOUTS["QGroundControl"](*item) for item in values.items())
    notes = imucal.read_calibration(written(tmp_path, "a.params", text)).provenance.imported.notes
    assert any("CAL_ACC0_ROT 8" in note for note in notes)
    with pytest.raises(imucal.InputError, match="CAL_GYRO0_ROT is 4"):
        imucal.read_calibration(
            written(
                tmp_path,
                "b.params",
                text.replace("ROT\t8\t6", "ROT\t4\t6", 2).replace("CAL_ACC0_ROT\t4", "CAL_ACC0_ROT\t8"),
            )
        )


# --- the inverse of the exports -------------------------------------------------------------------

UNIT = imucal.Calibration(
    imucal.Triad([[0.9804, 0, 0], [0.0112, 0.9727, 0], [-0.0155, 0.0083, 0.9921]], B_ACCEL),
    imucal.Triad([[0.9771, 0.0097, -0.0060], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.0030]], B_GYRO),
    frame="triangular",
)


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


# --- damaged and incomplete files -----------------------------------------------------------------


def kalibr_without(*path):
    block = {"imu0": kalibr_block()}
    inner = block
    for name in path[:-1]:
        inner = inner[name]
    del inner[path[-1]]
    return yaml.dump(block)


def with_entry(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


ARDUPILOT_TEXT = "\n".join(f"{n},{v!r}" for n, v in plain(ardupilot_values()).items())
REALSENSE = {
    "imus": [
        {
            s: {"scale_and_alignment": [1, 0, 0, 0, 1, 0, 0, 0, 1], "bias": [0, 0, 0]}
            for s in ("accelerometer", "gyroscope")
        }
    ]
}
DAMAGED = {
    "kalibr without M": (
        kalibr_without("imu0", "accelerometers", "M"),
        r"\$\.imu0\.accelerometers\.M is missing",
    ),
    "kalibr without gyroscopes": (kalibr_without("imu0", "gyroscopes"), r"\$\.imu0\.gyroscopes is missing"),
    "kalibr of another model": (
        yaml.dump({"imu0": kalibr_block(model="scale-only")}),
        r"\$\.imu0\.model is \"scale-only\", it must be one of calibrated",
    ),
    "kalibr with a rotation that is none": (
        yaml.dump(
            {
                "imu0": kalibr_block()
                | {"gyroscopes": kalibr_block()["gyroscopes"] | {"C_gyro_i": (1.01 * ROTATION).tolist()}}
            }
        ),
        "C_gyro_i is no rotation",
    ),
    "kalibr cut off": ("imu0:\n  accelerometers:\n    M: [[1.0, 0.0", "cannot be read as YAML"),
    "kalibr twice": ("imu0:\n  model: calibrated\n  model: calibrated\n", "'model' occurs twice"),
    "basalt with an array that is too short": (
        json.dumps({"value0": {"calib_accel_bias": [0.0] * 8, "calib_gyro_bias": [0.0] * 12}}),
        r"calib_accel_bias is .* it must be a list of 9 items, not 8",
    ),
    "basalt half": (
        json.dumps({"value0": {"calib_accel_bias": [0.0] * 9}}),
        r"\$\.value0\.calib_gyro_bias is missing",
    ),
    "realsense without a bias": (
        with_entry(json.dumps(REALSENSE), ', "bias": [0, 0, 0]', ""),
        r"\$\.imus\[0\]\.accelerometer\.bias is missing",
    ),
    "realsense singular": (
        with_entry(json.dumps(REALSENSE), "[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[1, 0, 0, 1, 0, 0, 0, 0, 1]"),
        "singular",
    ),
    "realsense cut off": (json.dumps(REALSENSE)[:-20], "is not JSON"),
    "ardupilot without a scale": (
        ARDUPILOT_TEXT.replace("INS_ACCSCAL_Y", "INS_OTHER_Y"),
        "the parameter INS_ACCSCAL_Y is missing",
    ),
    "ardupilot not calibrated": (
        with_entry(ARDUPILOT_TEXT, "INS_ACCSCAL_X,1.31", "INS_ACCSCAL_X,0"),
        "INS_ACCSCAL_X is 0: the sensor is not calibrated",
    ),
    "ardupilot twice": (
        ARDUPILOT_TEXT + "\nINS_ACCOFFS_X,0.5",
        "INS_ACCOFFS_X is -0.42 and 0.5",
    ),
    "openvins without a matrix": (
        yaml.dump({"imu0": {k: v for k, v in openvins_block().items() if k != "Tg"}}),
        r"\$\.imu0\.Tg is missing",
    ),
    "openvins with a rotation that is none": (
        yaml.dump({"imu0": openvins_block(R_IMUtoGYRO=S_GYRO.tolist())}),
        "R_IMUtoGYRO is no rotation",
    ),
    "openvins singular": (yaml.dump({"imu0": openvins_block(Ta=np.ones((3, 3)).tolist())}), "singular"),
    "inav twice": (inav_text() + "set acczero_x = 30\n", "acczero_x is 31 and 30"),
    "inav with a fraction": (inav_text(acczero_y=2.5), "acczero_y is '2.5': a whole number"),
    "inav not calibrated": (inav_text(accgain_z=0), "the sensor is not calibrated"),
    "ardupilot with text": (with_entry(ARDUPILOT_TEXT, "SCAL_Z,1.12", "SCAL_Z,nan"), "a finite number"),
    "imu_tk with 20 numbers": (
        "1 0 0 0 1 0 0 0 1\n1 0 0 0 1 0 0 0 1\n0 0\n",
        "no calibration that imucal reads",
    ),
    "imu_tk with a full scale matrix": (
        "1 0 0 0 1 0 0 0 1\n1 0.1 0 0 1 0 0 0 1\n0 0 0\n",
        "the diagonal of the scales",
    ),
    "something else": ("hello, world\n", "no calibration that imucal reads"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_file_is_named(case, tmp_path):
    text, message = DAMAGED[case]
    path = written(tmp_path, "acc.txt", text)
    with pytest.raises(imucal.FormatError, match=message) as raised:
        imucal.read_calibration(path)
    assert "acc.txt" in str(raised.value)


@pytest.mark.parametrize("name", ["kalibr", "openvins", "basalt", "realsense", "ardupilot", "imu_tk"])
def test_a_file_that_is_cut_off_or_lacks_a_line_is_read_or_refused(name, tmp_path):
    """Never another exception than those of the package, wherever the file ends."""
    text = {
        "kalibr": yaml.dump({"imu0": kalibr_block()}),
        "openvins": yaml.dump({"imu0": openvins_block()}),
        "basalt": json.dumps({"calib_accel_bias": [0.1] * 9, "calib_gyro_bias": [0.1] * 12}),
        "realsense": json.dumps(REALSENSE, indent=1),
        "ardupilot": ARDUPILOT_TEXT,
        "imu_tk": imu_tk_text(MISALIGNMENT, np.full(3, 0.0024), B_ACCEL),
    }[name]
    lines = text.splitlines(keepends=True)
    cut = [text[: len(text) * k // 30] for k in range(1, 30)]
    cut += ["".join(lines[:k] + lines[k + 1 :]) for k in range(0, len(lines), max(1, len(lines) // 20))]
    refused = 0
    for damaged in cut:
        try:
            imucal.read_calibration(written(tmp_path, "acc.txt", damaged))
        except imucal.ImucalError as error:
            refused += 1
            assert "acc.txt" in str(error)
    assert refused > len(cut) / 3


def test_a_file_of_another_format_than_given(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    assert imucal.read_calibration(path, format="realsense").provenance.imported.format == "realsense"
    with pytest.raises(imucal.FormatError, match="is no file of Kalibr"):
        imucal.read_calibration(path, format="kalibr")
    with pytest.raises(imucal.InputError, match=r"there is no format 'vins': give one of kalibr"):
        imucal.read_calibration(path, format="vins")
    with pytest.raises(imucal.FormatError, match="is no text"):
        (tmp_path / "calibration.bin").write_bytes(b"\x02\x01\xff\xfe" * 20)
        imucal.read_calibration(tmp_path / "calibration.bin")


def test_units_that_no_sensor_has_are_refused(tmp_path):
    in_g = json.loads(
        json.dumps(REALSENSE).replace("1, 0, 0, 0, 1, 0, 0, 0, 1", "9.8, 0, 0, 0, 9.8, 0, 0, 0, 9.8", 1)
    )
    with pytest.raises(
        imucal.FormatError, match=r"calibration.json: .*accelerometer\.T is about 0.102 m/s\^2"
    ):
        imucal.read_calibration(written(tmp_path, "calibration.json", in_g))


# --- the command ----------------------------------------------------------------------------------


def test_command(tmp_path, capsys):
    path = written(tmp_path, "imu.yaml", yaml.dump({"imu0": kalibr_block()}))
    output, document = tmp_path / "imported.json", tmp_path / "document.json"
    assert (
        main(["import", str(path), "-o", str(output), "--json", str(document), "--gyro-bias", "0.1,0,-0.2"])
        == 0
    )
    shown = capsys.readouterr().out
    assert "not in the file: covariance, temperature, gravity, accel bias" in shown
    found = json.loads(document.read_text())
    assert found["format"] == "kalibr" and "accel_bias" in found["missing"]
    calibration = imucal.Calibration.load(output)
    assert calibration.gyroscope.bias.tolist() == [0.1, 0.0, -0.2]
    assert calibration.judged[0] == "incomplete" and "Kalibr" in calibration.judged[1][0]
    assert calibration.provenance.imported.files[0].path == str(path)


def test_an_evaluation_names_what_the_file_does_not_state(tmp_path):
    run = imucal.simulate("random", unit="paper", seed=1, rate_hz=50)
    exported = imucal.export(run.truth.calibration, "kalibr")
    exported.save(tmp_path / "k.yaml")
    without = imucal.evaluate(imucal.read_calibration(tmp_path / "k.yaml"), run.recording)
    assert without.verdict == "poor"
    assert "the files of Kalibr do not state accel bias, gyro bias" in without.reasons[-1]
    truth = run.truth.calibration
    known = imucal.read_calibration(
        tmp_path / "k.yaml", accel_bias=truth.accelerometer.bias, gyro_bias=truth.gyroscope.bias
    )
    assert imucal.evaluate(known, run.recording).verdict == "good"


def test_command_names_the_formats_and_the_faults(tmp_path, capsys):
    assert main(["import", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(f"{name}: " in listed for name in READERS)
    assert main(["import", str(written(tmp_path, "x.txt", "hello"))]) == 1
    assert "-o PATH" in capsys.readouterr().err
    assert main(["import", str(tmp_path / "x.txt"), "-o", str(tmp_path / "o.json")]) == 1
    assert "no calibration that imucal reads" in capsys.readouterr().err
    numbers = [
        imu_tk_text(MISALIGNMENT, np.full(3, 9.8), B_ACCEL),
        imu_tk_text(MISALIGNMENT, np.ones(3), B_GYRO),
    ]
    pair = [str(written(tmp_path, name, text)) for name, text in zip(("acc", "gyro"), numbers, strict=True)]
    assert main(["import", *pair, "-o", str(tmp_path / "o.json")]) == 1
    assert "give --accel-unit g or --accel-unit lsb" in capsys.readouterr().err
    assert not (tmp_path / "o.json").exists()


def test_other_commands_name_the_import(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    with pytest.raises(imucal.FormatError, match="imucal import reads calibrations of other programs"):
        imucal.Calibration.load(path)


def test_the_page_has_the_table_of_formats():
    page = (ROOT / "docs/imports.md").read_text(encoding="utf-8")
    assert readers_markdown() in page, "put readers_markdown() of imucal.importing into docs/imports.md"


def test_yaml_is_loaded_only_for_yaml(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    code = f"import sys, imucal; imucal.read_calibration({str(path)!r}); assert 'yaml' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
