"""Options for recordings with one file per sensor: each option works, or is refused with the way out."""

import re

import numpy as np
import pytest

import imucal
from imucal.cli import main

ROWS = 400
RANDOM = np.random.default_rng(5)
TIME_S = np.arange(ROWS) / 100
FORCE = (np.array([0.3, -0.2, 9.79]) + RANDOM.normal(scale=0.02, size=(ROWS, 3))).round(5)
RATE = (np.outer(np.sin(TIME_S), [1.5, -0.7, 0.4]) + RANDOM.normal(scale=1e-3, size=(ROWS, 3))).round(5)
# Header of Sensor Logger, whose documentation states rad/s. The header itself states no unit.
LOGGER = "seconds_elapsed,x,y,z"


def write(path, header, time_s, values):
    rows = [",".join(map(repr, row)) for row in np.column_stack([time_s, values]).tolist()]
    path.write_text("\n".join([header, *rows, ""]))
    return path


def folder_of(path, accel_header, gyro_header, force=FORCE, rate=RATE, time_s=TIME_S):
    path.mkdir(exist_ok=True)
    write(path / "Accelerometer.csv", accel_header, time_s, force)
    write(path / "Gyroscope.csv", gyro_header, time_s[: len(rate)], rate)
    return path


def both_ways(folder, **options):
    """The recording read as a folder, and as two files."""
    return imucal.read(folder, **options), imucal.read(*sorted(folder.iterdir()), **options)


def remark_of(recording):
    (finding,) = [finding for finding in recording.findings if finding.code == "read_by_header"]
    return finding


# Units


def test_a_given_unit_replaces_the_unit_in_the_manual_of_the_app(tmp_path):
    folder = folder_of(tmp_path / "phone", LOGGER, LOGGER, rate=np.degrees(RATE))
    for recording in both_ways(folder, gyro_unit="deg/s"):
        np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)
        assert "the unit dps is that of --gyro-unit" in remark_of(recording).message
    # A unit in the header itself cannot be replaced.
    stated = folder_of(tmp_path / "stated", LOGGER, "t (s),x (rad/s),y (rad/s),z (rad/s)")
    with pytest.raises(imucal.InputError, match="contradicts the given unit: it says radps"):
        imucal.read(stated, gyro_unit="deg/s")


def test_rates_that_exclude_the_unit_in_the_manual_ask_for_the_option(tmp_path, capsys):
    folder = folder_of(tmp_path / "phone", LOGGER, LOGGER, rate=np.degrees(RATE))
    assert main(["convert", str(folder), "-o", str(tmp_path / "run.csv")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "exclude rad/s" in said
    option = re.search(r"probably (--gyro-unit) (\S+)$", said)
    assert main(["convert", str(folder), *option.groups(), "-o", str(tmp_path / "run.csv")]) == 0
    np.testing.assert_allclose(imucal.read(tmp_path / "run.csv").angular_rate, RATE, atol=1e-12)


def test_the_origin_of_both_units_is_reported(tmp_path):
    for recording in both_ways(folder_of(tmp_path / "phone", LOGGER, LOGGER)):
        finding = remark_of(recording)
        assert "the unit mps2 follows from the size of gravity" in finding.message
        assert "the unit radps is assumed, because Sensor Logger writes it by default" in finding.message
        assert "give --accel-unit or --gyro-unit" in finding.way_out
        np.testing.assert_array_equal(recording.angular_rate, RATE)


# The sampling rate

ACCEL, GYRO = "t (s),x (m/s^2),y (m/s^2),z (m/s^2)", "t (s),x (rad/s),y (rad/s),z (rad/s)"


def test_a_sampling_rate_replaces_the_time_stamps_of_packets(tmp_path):
    packets_s = np.repeat(TIME_S[9::10], 10)
    folder = folder_of(tmp_path / "phone", ACCEL, GYRO, time_s=packets_s)
    for recording in both_ways(folder, rate_hz=100.0):
        np.testing.assert_array_equal(recording.time_s, TIME_S)
        np.testing.assert_array_equal(recording.specific_force, FORCE)
        np.testing.assert_array_equal(recording.angular_rate, RATE)
    alone = tmp_path / "alone"
    alone.mkdir()
    write(alone / "Accelerometer.csv", LOGGER, packets_s, FORCE)
    write(alone / "TotalAcceleration.csv", LOGGER, packets_s, FORCE)
    np.testing.assert_array_equal(imucal.read(alone, rate_hz=100.0).time_s, TIME_S)


def test_files_without_a_time_column_ask_for_the_sampling_rate(tmp_path):
    folder = folder_of(tmp_path / "phone", ACCEL, GYRO)
    for path in folder.iterdir():
        lines = path.read_text().splitlines()
        path.write_text("\n".join(line.split(",", 1)[1] for line in lines))
    with pytest.raises(imucal.FormatError, match="give the sampling rate with --rate-hz"):
        imucal.read(folder)
    for recording in both_ways(folder, rate_hz=100.0):
        np.testing.assert_array_equal(recording.time_s, TIME_S)
        np.testing.assert_array_equal(recording.angular_rate, RATE)


def test_a_sampling_rate_needs_equal_numbers_of_samples(tmp_path):
    folder = folder_of(tmp_path / "phone", ACCEL, GYRO, rate=RATE[:-3])
    with pytest.raises(imucal.InputError, match="400 samples of the accelerometer, 397 of the gyroscope"):
        imucal.read(folder, rate_hz=100.0)


# Options that the files do not need


def test_no_option_is_silently_ignored(tmp_path):
    folder = folder_of(tmp_path / "phone", ACCEL, GYRO)
    with pytest.raises(imucal.InputError, match=r"--columns.*leave the option out.*--rate-hz"):
        imucal.read(folder, columns="-,accel_x_mps2,accel_y_mps2,accel_z_mps2", rate_hz=100.0)
    with pytest.raises(imucal.InputError, match="time_unit and rate_hz are both given"):
        imucal.read(folder, time_unit="s", rate_hz=100.0)
    (folder / "Gyroscope.csv").unlink()
    with pytest.raises(imucal.InputError, match="gyro_unit is the unit of the other one"):
        imucal.read(folder, gyro_unit="deg/s")
    assert imucal.read(folder, accel_unit="m/s^2").angular_rate is None
    table = tmp_path / "table"
    table.mkdir()
    header = "t (s),ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)"
    write(table / "run.csv", header, TIME_S, np.column_stack([FORCE, RATE]))
    for option in ({"time_unit": "ms"}, {"accel_unit": "g"}, {"gyro_unit": "deg/s"}):
        with pytest.raises(imucal.InputError, match=f"no option {next(iter(option))}: .*--columns"):
            imucal.read(table, **option)


# Files that are given in another way


def test_four_sensor_files_are_answered_with_folders(tmp_path, capsys):
    folders = [folder_of(tmp_path / name, ACCEL, GYRO) for name in ("one", "two")]
    files = [str(path) for folder in folders for path in sorted(folder.iterdir())]
    assert main(["calibrate", *files, "-o", str(tmp_path / "unit.json")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "[sensor_missing]" in said and "give each recording as a folder with both files" in said


def test_an_empty_folder_is_called_empty(tmp_path):
    (tmp_path / "phone").mkdir()
    with pytest.raises(imucal.InputError, match="phone is a folder without files"):
        imucal.read(tmp_path / "phone")
