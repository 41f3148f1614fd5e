"""Damaged and incomplete calibration files of other programs are named."""

import json

import numpy as np
import pytest
import yaml

import imucal
from autopilot_imports import ardupilot_values, inav_text, plain
from estimator_imports import kalibr_block, openvins_block
from import_files import B_ACCEL, ROTATION, S_GYRO, written
from laboratory_imports import MISALIGNMENT, imu_tk_text
from realsense_imports import REALSENSE


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
