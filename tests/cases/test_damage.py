"""Spoilt files, and files that contradict themselves: a named reason, within limits, and a way out."""

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

import imucal
from imucal.cli import main
from raw_text import raw

# Limits of a command with a small file: processor time, s, and resident memory, bytes. A valid file takes
# 1 s and 0.1 GB; readers without a guard took minutes and 2 GB.
MOST_S, MOST_BYTES = 10, 500_000_000
# Patterns of the reason why a file cannot be read.
UNREADABLE = {
    "hostile/bag_mcap_memoryerror": "ROS 1 and ROS 2 bags: reading it needs more memory than a file",
    "hostile/dataflash_hang.bin": "dataflash: (reading it needs more memory|its library took more)",
    "hostile/dataflash_overflow.bin": "dataflash: int too big to convert: it is damaged",
    "hostile/mat4_memoryerror.mat": "MATLAB: .*it is damaged, truncated or of an unknown version",
    "hostile/mat5_segfault.mat": "MATLAB .mat, all versions: (its library has crashed|.*is damaged)",
    "hostile/mcap_memoryerror.mcap": "MCAP: reading it needs more memory than a file",
    "hostile/parquet_2GB.parquet": "damaged or truncated Parquet file: a structure has a field of",
    "hostile/parquet_unicode.parquet": "damaged or truncated Parquet file",
    "hostile/ulog_keyerror.ulg": "PX4 ULog: 'timestamp': it is damaged",
}
# Files with one sample that no sensor measures, and its value as the finding writes it.
IMPOSSIBLE = {"hostile/hang_1e153.csv": "1.700e153", "hostile/one_sample_flt_max.csv": "3.400e38"}


@pytest.fixture(scope="module")
def limited():
    """Run imucal in a process whose time and memory are within limits; exit code, and output in one line."""
    if sys.platform != "linux":
        pytest.skip("the process is limited with means of Linux")
    program = (
        "import resource as r, sys; from imucal.cli import main; "
        f"r.setrlimit(r.RLIMIT_CPU, ({MOST_S}, {MOST_S})); "
        "code = main(sys.argv[1:]); "
        # The largest resident memory of `getrusage` contains that of the process that started this one.
        "own = next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')); "
        "print(max(int(own), r.getrusage(r.RUSAGE_CHILDREN).ru_maxrss)); sys.exit(code)"
    )

    def run(*words):
        command = [sys.executable, "-c", program, *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode in (1, 2), done.stderr
        *shown, most_kb = done.stdout.splitlines()
        assert int(most_kb) * 1024 < MOST_BYTES
        return done.returncode, " ".join(" ".join([*shown, done.stderr]).split())

    return run


@pytest.mark.parametrize("name", UNREADABLE)
def test_damaged_files_have_a_reason_within_limits(case_file, limited, name):
    code, said = limited("inspect", case_file(name))
    assert code == 1, said
    assert re.match(f"imucal: {Path(name).name} .*{UNREADABLE[name]}", said), said


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_a_sample_that_no_sensor_measures(case_file, limited, tmp_path, name):
    path = case_file(name)
    code, said = limited("inspect", path)
    assert code == 2, said
    expected = raw(path)
    ((row, axis),) = np.argwhere(np.abs(expected.accel) > 1e30)
    place = f"in accel_{'xyz'[axis]}, sample {row}, at {expected.time_s[row]:.2f} s [value_impossible]"
    assert f"the first is {IMPOSSIBLE[name]} {place}: leave out these rows" in said
    lines = path.read_text().splitlines(keepends=True)
    del lines[1 + row]
    (tmp_path / path.name).write_text("".join(lines))
    codes = {finding.code for finding in imucal.inspect(imucal.read(tmp_path / path.name)).findings}
    assert codes == {"samples_missing"}


def test_a_line_that_is_no_row_and_no_text(case_file, limited, tmp_path):
    path = case_file("hostile/csv_bad_row_not_utf8.csv")
    code, said = limited("inspect", path)
    assert (code, said.partition(": complete")[0]) == (
        1,
        f"imucal: {path.name}: line 51 has 3 values, 7 are needed",
    )
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) == 51
    (tmp_path / path.name).write_bytes(b"".join(lines[:50]))
    expected = raw(tmp_path / path.name)
    recording = imucal.read(tmp_path / path.name)
    np.testing.assert_array_equal(recording.specific_force, expected.accel)
    np.testing.assert_array_equal(recording.angular_rate, expected.gyro)


def test_long_double_is_read_as_its_library_reads_it(case_file, limited):
    path = case_file("hostile/hdf5_longdouble.h5")
    with h5py.File(path) as file:
        arrays = {name: file[name][()] for name in file}
    assert arrays["temp_degc"].dtype == np.longdouble
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.specific_force, arrays["accel_mps2"])
    np.testing.assert_array_equal(recording.angular_rate, arrays["gyro_radps"])
    np.testing.assert_array_equal(recording.temperature_degc, arrays["temp_degc"].astype(float))
    np.testing.assert_array_equal(recording.time_s, (arrays["time_ns"] - arrays["time_ns"][0]) / 1e9)
    code, said = limited("inspect", path)
    assert code == 2 and "[too_short]" in said and "[temperature_implausible]" in said, said


# Calibration files


def undo(document):
    document["accelerometer"]["T"][1][0] = document["accelerometer"]["T"][0][1]


def restore_names(document):
    document["covariance"]["names"] = [parameter["name"] for parameter in document["parameters"]]


def in_si(document):
    document["raw_units"] = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}


def exchange(document):
    document["temperature_range_degc"].reverse()


# Reason why a calibration file is refused, and a change that follows the advice; None if a number is lost, so
# that only a new calibration helps.
CONTRADICTIONS = {
    "hostile/cal_accel_T_lower_edited.json": (
        r"\$\.accelerometer\.T\[1\]\[0\] is 0\.05, but .*correct one of them",
        undo,
    ),
    "hostile/cal_cov_names_swapped.json": (
        r"\$\.covariance\.names\[1\] is accel_bias_y, but .*restore that",
        restore_names,
    ),
    "hostile/cal_gyro_T_near_singular.json": (
        r"\$\.gyroscope\.T: .* is nearly singular: .*two axes are nearly",
        None,
    ),
    "hostile/cal_lsb_T_is_1.json": (
        r"\$\.gyroscope\.T is about 0\.977 lsb per rad/s, .*correct the unit, or",
        None,
    ),
    "hostile/cal_raw_units_edited.json": (
        r"\$\.gyroscope\.T is about 0\.977 lsb per rad/s, .*correct the unit",
        in_si,
    ),
    "hostile/temperature_range_reversed.json": (
        r"\$\.temperature_range_degc\[0\] is 80\.0, .*: exchange them",
        exchange,
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_calibration_files_that_contradict_themselves(case_file, tmp_path, capsys, name):
    path, control = case_file(name), case_file("hostile/control_lsb.csv")
    reason, follow = CONTRADICTIONS[name]
    assert main(["evaluate", str(path), str(control)]) == 1
    said = " ".join("".join(capsys.readouterr()).split())
    assert re.search(reason, said), said
    with pytest.raises(imucal.FormatError, match=reason):
        imucal.Calibration.load(path)
    if follow is not None:
        document = json.loads(path.read_text())
        follow(document)
        (tmp_path / "mended.json").write_text(json.dumps(document))
        mended = imucal.Calibration.load(tmp_path / "mended.json")
        np.testing.assert_array_equal(mended.gyroscope.sensitivity, document["gyroscope"]["T"])


def test_a_line_separator_in_a_name_adds_no_key_to_yaml(case_file, tmp_path):
    # k.yaml was written by an earlier version: its comment ends at the line separator of the name.
    earlier = case_file("hostile/yaml/k.yaml")
    with_key = yaml.safe_load(earlier.read_text(encoding="utf-8"))
    assert set(with_key) == {"evil", "imu0"}
    output = tmp_path / "k.yaml"
    assert main(["export", str(case_file("hostile/yaml/c.json")), "--to", "kalibr", "-o", str(output)]) == 0
    written = yaml.safe_load(output.read_text(encoding="utf-8"))
    assert written == {"imu0": with_key["imu0"]}


# Programs


def test_a_turn_without_bounds_becomes_no_g_code(case_file, tmp_path, capsys):
    program, output = case_file("hostile/prog_turn1e300.json"), tmp_path / "run.nc"
    assert main(["stand", "gcode", str(program), "-o", str(output)]) == 1
    assert "$.steps[2].turn_deg[0] turns the motor to 1e+300 deg" in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.parametrize(
    ("name", "word", "key", "reason"),
    [
        ("hostile/g_turn1e300.nc", r"G1X(\d+)", "turn_deg", r"turn_deg\[0\] turns the motor to 1e\+300 deg"),
        ("hostile/g_hold1e308.nc", r"G4P(\d+)", "hold_s", r"hold_s is 1e\+308"),
    ],
)
def test_g_code_without_bounds_is_of_no_program(case_file, tmp_path, name, word, key, reason):
    # The G-code of an earlier version. A program with its largest number is refused.
    most = max(float(found) for found in re.findall(word, case_file(name).read_text()))
    steps = [
        {"turn_deg": [0, 0, 0], "move_s": 0, "hold_s": 1},
        {"turn_deg": [9, 0, 0], "move_s": 1, "hold_s": 1},
    ]
    steps[1][key] = [most, 0, 0] if key == "turn_deg" else most
    path = tmp_path / "program.json"
    path.write_text(json.dumps({"schema": "imucal.program/1", "steps": steps}))
    with pytest.raises(imucal.ImucalError, match=reason):
        imucal.Program.read(path)
