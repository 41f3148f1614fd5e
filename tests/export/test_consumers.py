"""Each export against the formula of its consumer, and what an export says about it.

The formulas are in tests/fixtures/consumers.py, with the versions that they were read from.
"""

import dataclasses
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import consumers
import imucal
from imucal.cli import main
from imucal.exporting.board_rotation import ORIENTATIONS, board_rotation

ROOT = Path(__file__).resolve().parents[2]
UNIT = consumers.UNIT


@pytest.mark.parametrize("name", consumers.CONSUMERS)
def test_the_consumer_computes_what_apply_computes(name):
    assert consumers.relative_error(name) < 1e-6


def test_the_page_has_the_versions_and_the_figures():
    page = (ROOT / "docs/export.md").read_text(encoding="utf-8")
    assert consumers.table() in page, "put the output of tests/fixtures/consumers.py into docs/export.md"


# --- Fusion: one header for both layouts of FusionMatrix ---------------------------------------------

LAYOUTS = {"before 1.3": "float array[3][3];", "since 1.3": "float array[9];"}
FUSION_H = """
typedef union {{ float array[3]; struct {{ float x; float y; float z; }} axis; }} FusionVector;
typedef union {{ {array} struct {{
    float xx; float xy; float xz; float yx; float yy; float yz; float zx; float zy; float zz; }} element;
}} FusionMatrix;
"""
PROGRAM = """
#include <stdio.h>
#include "unit.h"
int main(void) {
    const FusionMatrix *const all[] = {&gyroscopeMisalignment, &accelerometerMisalignment};
    for (int i = 0; i < 2; i++) fwrite(all[i], sizeof(float), 9, stdout);
    fwrite(&gyroscopeSensitivity, sizeof(float), 3, stdout);
    fwrite(&gyroscopeOffset, sizeof(float), 3, stdout);
    fwrite(&accelerometerSensitivity, sizeof(float), 3, stdout);
    fwrite(&accelerometerOffset, sizeof(float), 3, stdout);
    return 0;
}
"""
STRICT = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wmissing-braces",
    "-Wmissing-field-initializers",
    "-Werror",
)


def compiled_constants(folder, *includes):
    """The 30 numbers of the header, as a C program sees them."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    (folder / "main.c").write_text(PROGRAM)
    arguments = [*STRICT, *includes, "main.c", "-o", "main", "-lm"]
    done = subprocess.run([compiler, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.frombuffer(subprocess.run([folder / "main"], capture_output=True).stdout, dtype=np.float32)


def constants(unit=UNIT):
    """The same numbers from the calibration: T = diag(gain) N, and N^-1."""
    matrices, vectors = [], []
    for triad, per_si in ((unit.gyroscope, 180 / np.pi), (unit.accelerometer, 1 / 9.80665)):
        gain = np.linalg.norm(triad.sensitivity, axis=1)
        matrices.append(np.linalg.inv(triad.sensitivity / gain[:, None]).ravel())
        vectors += [per_si / gain, triad.bias]
    return np.concatenate((*matrices, *vectors))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_fusion_constants_fill_both_layouts_of_its_matrix(tmp_path, layout):
    imucal.export(UNIT, "fusion").save(tmp_path / "unit.h")
    (tmp_path / "Fusion.h").write_text(FUSION_H.format(array=LAYOUTS[layout]))
    np.testing.assert_allclose(compiled_constants(tmp_path), constants(), rtol=1e-7, atol=1e-9)


def test_fusion_constants_with_the_headers_of_fusion(tmp_path):
    # FUSION_SOURCE is the folder Fusion of its repository or of the source distribution of imufusion.
    if "FUSION_SOURCE" not in os.environ:
        pytest.skip("FUSION_SOURCE does not name the folder of Fusion's headers")
    imucal.export(UNIT, "fusion").save(tmp_path / "unit.h")
    found = compiled_constants(tmp_path, "-I", os.environ["FUSION_SOURCE"])
    np.testing.assert_allclose(found, constants(), rtol=1e-7, atol=1e-9)


# --- ArduPilot: the rotation of the board ------------------------------------------------------------


def test_orientations_are_those_of_mavlink():
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common")
    names = mavlink.enums["MAV_SENSOR_ORIENTATION"]
    for number, angles in enumerate(ORIENTATIONS[:41]):
        words = names[number].name.removeprefix("MAV_SENSOR_ROTATION_")
        named = {axis: float(angle) for axis, angle in re.findall(r"(ROLL|PITCH|YAW)_(\d+)", words)}
        assert tuple(named.get(axis, 0) for axis in ("ROLL", "PITCH", "YAW")) == tuple(map(int, angles)), (
            words
        )


@pytest.mark.parametrize(
    ("number", "rotated"),
    [
        # Vector3::rotate of vector3.cpp, of (x, y, z) = (1, 2, 3).
        (2, (-2, 1, 3)),
        (10, (2, 1, -3)),
        (16, (1, -3, 2)),
        (24, (3, 2, -1)),
        (26, (-2, -1, -3)),
        (36, (3, -1, -2)),
        (37, (-3, -1, 2)),
    ],
)
def test_orientations_rotate_as_ardupilot(number, rotated):
    # ROLL_90_YAW_90 and the like are exact.
    np.testing.assert_array_equal(board_rotation(number) @ [1, 2, 3], rotated)
    assert np.array_equal(board_rotation(number), np.rint(board_rotation(number)))


def test_the_orientation_with_odd_angles_is_that_of_ardupilot():
    # vector3.cpp, ROTATION_ROLL_90_PITCH_68_YAW_293.
    expected = [[0.143039, 0.368776, -0.918446], [-0.332133, -0.856289, -0.395546], [-0.932324, 0.361625, 0]]
    np.testing.assert_allclose(board_rotation(38), expected, rtol=0, atol=1e-6)


def test_a_log_exported_without_its_orientation_is_another_correction():
    consumer = consumers.CONSUMERS["ardupilot, `--board-orientation 17`"]
    rec = consumers.recording(consumer.unit)
    wrong = imucal.export(consumer.unit, "ardupilot")
    _, force = consumer.corrected(wrong, rec)
    assert np.abs(force - consumer.unit.apply_recording(rec).specific_force).max() > 0.1
    assert "--board-orientation" in wrong.text


def test_what_an_orientation_loses_is_said_in_the_axes_of_the_sensor(tmp_path):
    turned = imucal.export(UNIT, "ardupilot", board_orientation="0,0,90")
    same = imucal.export(UNIT, "ardupilot", board_orientation=2)
    assert turned.text == same.text and turned.lost
    rec = consumers.recording(UNIT)
    found = consumers.ardupilot(same, rec, board_rotation(2))
    expected = same.same_as.apply_recording(rec)
    np.testing.assert_allclose(found[0], expected.angular_rate, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found[1], expected.specific_force, rtol=0, atol=1e-5)


@pytest.mark.parametrize("wrong", ["44", "-1", "1,2", "x", "nan,0,0", ""])
def test_no_orientation_is_guessed(wrong):
    with pytest.raises(imucal.InputError, match="AHRS_ORIENTATION as a number from 0 to 43"):
        imucal.export(UNIT, "ardupilot", board_orientation=wrong)


def test_a_calibration_of_a_log_needs_the_orientation():
    import dataclasses

    log = imucal.Source("/logs/00000012.BIN", "ab" * 32)
    unit = dataclasses.replace(UNIT, provenance=dataclasses.replace(UNIT.provenance, files=(log,)))
    with pytest.raises(imucal.InputError, match=r"00000012.BIN: .*give --board-orientation"):
        imucal.export(unit, "ardupilot")
    for orientation in (0, 2):
        body = imucal.export(unit, "ardupilot", board_orientation=orientation).text.partition("INS_")[2]
        assert (
            body == imucal.export(UNIT, "ardupilot", board_orientation=orientation).text.partition("INS_")[2]
        )
    # Other formats do not depend on it.
    imucal.export(unit, "c-header")


# --- INAV --------------------------------------------------------------------------------------------


def test_inav_in_si_units_is_within_its_resolution():
    exported = imucal.export(UNIT, "inav", accel_lsb_per_g=4096, gyro_lsb_per_dps=16.4)
    found = dict(re.findall(r"^set (\w+) = (-?\d+)$", exported.text, re.MULTILINE))
    for i, axis in enumerate("xyz"):
        zero = UNIT.accelerometer.bias[i] / 9.80665 * 4096
        assert abs(int(found[f"acczero_{axis}"]) - zero) <= 0.5
        assert abs(int(found[f"gyro_zero_{axis}"]) - np.rad2deg(UNIT.gyroscope.bias[i]) * 16.4) <= 0.5
    assert "INAV stores integers: up to" in exported.lost[0] and "1/4096" in exported.lost[0]
    # Whole counts and gains lose nothing.
    assert not imucal.export(consumers.INAV_UNIT, "inav").lost
    # The model that is said to be the same has the rounded numbers.
    raw = UNIT.accelerometer.bias
    assert exported.same_as.accelerometer.bias == pytest.approx(raw, abs=0.5 * 9.80665 / 4096)


def test_inav_truncates_to_counts():
    # accADC is an integer: (raw - zero) * gain / 4096 loses less than a count, as the file says.
    consumer = consumers.CONSUMERS["inav"]
    rec = consumers.recording(consumer.unit)
    exported = imucal.export(consumer.unit, "inav")
    _, force = consumer.corrected(exported, rec)
    truncated = np.trunc(force / 9.80665 * 2048) / 2048 * 9.80665
    assert np.abs(truncated - force).max() < 9.80665 / 2048
    assert "truncates each corrected accelerometer sample" in exported.text.replace("\n#   ", " ")


def test_inav_refuses_what_its_settings_cannot_hold():
    unit = imucal.Calibration(imucal.Triad(np.eye(3) * 0.4, [0, 0, 0]), None)
    with pytest.raises(imucal.InputError, match=r"accgain is .* outside of 1 to 8192"):
        imucal.export(unit, "inav")
    with pytest.raises(imucal.InputError, match="accel_lsb_per_g is 0: a positive number"):
        imucal.export(UNIT, "inav", accel_lsb_per_g=0)


def test_inav_refuses_counts_of_another_resolution():
    gyro = imucal.Triad(consumers.INAV_UNIT.gyroscope.sensitivity * 8, [0, 0, 0])
    accel = imucal.Triad(consumers.INAV_UNIT.accelerometer.sensitivity * 8, [0, 0, 0])
    for sensor, triad, said in (
        (
            "accelerometer",
            accel,
            r"has 16\d+ counts per g, but acc_1G is assumed to be 2048: .*--accel-lsb-per-g",
        ),
        ("gyroscope", gyro, r"has 131.2 counts per deg/s, .* is assumed to be 16.4: .*--gyro-lsb-per-dps"),
    ):
        unit = dataclasses.replace(consumers.INAV_UNIT, **{sensor: triad})
        with pytest.raises(imucal.InputError, match=said):
            imucal.export(unit, "inav")
    both = dataclasses.replace(consumers.INAV_UNIT, accelerometer=accel, gyroscope=gyro)
    assert imucal.export(both, "inav", accel_lsb_per_g=8 * 2048, gyro_lsb_per_dps=8 * 16.4).same_as


# --- OpenVINS and Kalibr ------------------------------------------------------------------------------


def test_openvins_has_a_times_c_of_kalibr():
    import yaml

    kalibr = yaml.safe_load(imucal.export(consumers.WITH_G, "kalibr").text)["imu0"]["gyroscopes"]
    text = imucal.export(consumers.WITH_G, "openvins").text
    openvins = yaml.safe_load(text.partition("\n")[2])["imu0"]
    np.testing.assert_allclose(openvins["Tg"], np.array(kalibr["A"]) @ kalibr["C_gyro_i"], rtol=0, atol=1e-18)
    assert np.abs(np.array(openvins["Tg"]) - kalibr["A"]).max() > 1e-7
    said = imucal.export(consumers.WITH_G, "kalibr").text.replace("\n#   ", " ")
    assert "its Tg is A C_gyro_i instead of A" in said


def test_openvins_takes_the_noise_of_a_recording():
    import yaml

    rest = imucal.simulate(
        imucal.Static(300), unit=imucal.Unit.named("icm42688p"), rate_hz=100, seed=2
    ).recording
    noise = imucal.noise(rest)
    exported = imucal.export(consumers.WITH_G, "openvins", noise=noise)
    assert "noise figures" not in exported.lost
    imu = yaml.safe_load(exported.text.partition("\n")[2])["imu0"]
    largest = max(noise.axes[f"gyro_{axis}"].noise_density.value for axis in "xyz")
    assert imu["gyroscope_noise_density"] == pytest.approx(largest)
    # Keys without which OpenVINS does not start.
    assert {"accelerometer_noise_density", "accelerometer_random_walk", "gyroscope_random_walk"} <= imu.keys()
    assert {"rostopic", "update_rate", "time_offset", "T_i_b", "R_IMUtoACC"} <= imu.keys()
    assert "noise figures" in imucal.export(consumers.WITH_G, "openvins").lost


# --- messages -----------------------------------------------------------------------------------------


def test_px4_is_told_not_to_replace_the_offsets():
    assert "SENS_IMU_AUTOCAL to 0" in imucal.export(UNIT, "px4").text.replace("\n#   ", " ")


def test_the_table_of_realsense_is_written_by_the_command(tmp_path, capsys):
    UNIT.save(tmp_path / "unit.json")
    arguments = ["export", str(tmp_path / "unit.json"), "--to", "realsense-table"]
    assert main([*arguments]) == 1
    assert "realsense-table is not a text: give a file for it (-o FILE)" in capsys.readouterr().err
    assert main([*arguments, "-o", str(tmp_path / "unit.bin")]) == 0
    assert (tmp_path / "unit.bin").read_bytes() == imucal.export(UNIT, "realsense-table").binary
    said = capsys.readouterr().err
    assert "librealsense multiplies it by pi / 180" in said and "write_eeprom_to_camera" in said


def test_options_of_other_formats_are_refused(tmp_path, capsys):
    UNIT.save(tmp_path / "unit.json")
    for option in (["--board-orientation", "2"], ["--accel-lsb-per-g", "2048"]):
        assert main(["export", str(tmp_path / "unit.json"), "--to", "px4", *option]) == 1
        assert f"remove {option[0]}" in capsys.readouterr().err
    arguments = ["export", str(tmp_path / "unit.json"), "--to", "ardupilot", "--board-orientation", "2"]
    assert main(arguments) == 0
    assert capsys.readouterr().out == imucal.export(UNIT, "ardupilot", board_orientation=2).text
