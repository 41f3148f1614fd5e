"""Files of loggers and phones that were once refused or misread: values, units, axes and rate."""

import csv
import io
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pytest

import imucal
from imucal.cli import main
from raw_text import SEVEN, TO_SI, Raw, raw

# Files with canonical names, and the codes of what `inspect` says about them.
CANONICAL = {
    "arrival_called_missing/log.csv": {"clock_irregular"},
    "cube-faces/cube_mix12.csv": set(),
    "cube-faces/pybricks_roll.csv": set(),
    "false_rest_called_units/walk.csv": {"samples_missing", "gyro_saturation"},
    "frd-gravity-sign/frd1.csv": {"gravity_sign"},
    "frd-gravity-sign/stand_frd.csv": {"gravity_sign"},
    "gap_headline/log.csv": set(),
    "hostile/control_lsb.csv": set(),
    "hostile/hang_1e153.csv": {"value_impossible"},
    "hostile/one_sample_flt_max.csv": {"value_impossible"},
    "lsb-gap-names/a8_1.csv": {"noise_below_lsb"},
    "lsb-gap-names/gq4_1.csv": {"noise_below_lsb"},
    "lsb-gap-names/gq4_2.csv": {"noise_below_lsb"},
    "lsb-gap-names/lsm2000.csv": {"noise_below_lsb"},
    "mirrored_axes/left_handed_y.csv": set(),
    "mirrored_axes/xyz.csv": set(),
    "mirrored_axes/zyx_named_xyz.csv": set(),
    "rate_of_bursts/bursts.csv": {"clock_irregular"},
    "rows_written_twice/log.csv": {"samples_duplicated"},
    "six-means/six.csv": set(),
    "truncated_last_line/log.csv": {"lines_left_out"},
}


def assert_is(recording, expected, *, exact_time=True):
    """The recording has the samples, units and rate of the raw text."""
    if exact_time:
        np.testing.assert_array_equal(recording.time_s, expected.time_s)
    else:
        np.testing.assert_allclose(recording.time_s, expected.time_s, atol=1e-9)
    np.testing.assert_allclose(recording.specific_force, expected.accel, rtol=1e-15)
    np.testing.assert_allclose(recording.angular_rate, expected.gyro, rtol=1e-15)
    assert recording.column_units == expected.units
    assert recording.accel_unit == ("lsb" if expected.units[0] == "lsb" else "m/s^2")
    assert recording.gyro_unit == ("lsb" if expected.units[1] == "lsb" else "rad/s")
    assert recording.rate_hz == pytest.approx(expected.rate_hz, rel=1e-6)


def found(recording, code):
    """The message of the only finding with this code."""
    (message,) = (finding.message for finding in recording.findings if finding.code == code)
    return message


@pytest.mark.parametrize("name", CANONICAL)
def test_canonical_names(case_file, name):
    recording = imucal.read(case_file(name))
    assert_is(recording, raw(case_file(name)), exact_time="walk" not in name)
    codes = {finding.code for finding in imucal.inspect(recording).findings}
    assert codes == CANONICAL[name]


def test_copies_and_an_incomplete_last_line_are_counted(case_file):
    path = case_file("rows_written_twice/log.csv")
    copies = len(path.read_text().splitlines()) - 1 - len(raw(path).time_s)
    assert f"{copies} rows are exact copies" in found(imucal.read(path), "samples_duplicated")
    path = case_file("truncated_last_line/log.csv")
    last = path.read_text().splitlines()[-1]
    assert f"an incomplete last line ({last!r})" in found(imucal.read(path), "lines_left_out")


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("dates/colon_before_ms.csv", "%Y-%m-%d %H:%M:%S:%f"),
        ("dates/month_name.csv", "%d-%b-%Y %H:%M:%S.%f"),
        ("dates/time_of_day.csv", "%H:%M:%S.%f"),
    ],
)
def test_dates(case_file, name, form):
    path = case_file(name)
    first = datetime.strptime(path.read_text().splitlines()[1].partition(",")[0], form)
    elapsed = raw(path, time_of=lambda cell: (datetime.strptime(cell, form) - first) / timedelta(seconds=1))
    assert_is(imucal.read(path), elapsed, exact_time=False)


def test_tabs_and_quotes(case_file):
    path = case_file("tab_header/phone.csv")
    rows = "\n".join(path.read_text().splitlines()[1:])
    numbers = np.array(list(csv.reader(io.StringIO(rows), delimiter="\t")), float)
    recording = imucal.read(path)
    assert_is(recording, Raw(numbers[:, 0], numbers[:, 1:4], numbers[:, 4:], ("mps2", "radps")))
    assert "time_s=Time (s), accel_x_mps2=Acceleration x (m/s^2)" in found(recording, "read_by_header")


def test_lines_of_text_among_the_rows(case_file):
    path = case_file("serial_text/serial.txt")
    lines = [line.split("\t") for line in path.read_text().splitlines()]
    numbers = np.array([line for line in lines if len(line) == len(SEVEN)], float)
    others = [line for line in lines if len(line) != len(SEVEN)]
    recording = imucal.read(path, columns=SEVEN)
    assert_is(recording, Raw(numbers[:, 0], numbers[:, 1:4], numbers[:, 4:], ("mps2", "radps")))
    # The first line is above the rows and no lost sample.
    assert others == [["MPU6050 connection successful"], ["FIFO overflow!"]]
    assert "1 lines of text (the first: 'FIFO overflow!')" in found(recording, "lines_left_out")


def test_lines_of_labels(case_file):
    path = case_file("serial_text/plotter.txt")
    rows = [
        dict(cell.split(":") for cell in line.split("\t")) for line in path.read_text().strip().splitlines()
    ]
    labels = ["t", "ax", "ay", "az", "gx", "gy", "gz"]
    numbers = np.array([[row[label] for label in labels] for row in rows], float)
    columns = ",".join(f"{ours}={theirs}" for ours, theirs in zip(SEVEN, labels, strict=True))
    recording = imucal.read(path, columns=columns)
    assert_is(recording, Raw(numbers[:, 0], numbers[:, 1:4], numbers[:, 4:], ("mps2", "radps")))
    assert recording.findings == ()


def test_text_in_a_column_that_is_left_out(case_file):
    path = case_file("text_in_left_out_column/device_name.csv")
    recording = imucal.read(path, columns=["-", *SEVEN])
    assert_is(recording, raw(path, names=["-", *SEVEN], separator=";"))
    assert recording.findings == ()


@pytest.mark.parametrize("columns", [None, ["-"] * 7 + SEVEN[1:]], ids=["by the manual", "by columns"])
def test_sentences(case_file, columns):
    path = case_file("text_in_left_out_column/vnymr.txt")
    # The fields 7 to 12 of $VNYMR: VN-100 user manual, "Yaw, Pitch, Roll, Magnetic, Acceleration and Angular
    # Rates".
    rows = [line.partition("*")[0].split(",")[7:] for line in path.read_text().splitlines()]
    numbers = np.array(rows, float)
    recording = imucal.read(path, rate_hz=100, columns=columns)
    time_s = np.arange(len(rows)) / 100
    assert_is(recording, Raw(time_s, numbers[:, :3], numbers[:, 3:], ("mps2", "radps")))
    assert "the check sum 5A, which is a placeholder" in found(recording, "checksums_missing")
    # Without the rate the command ends with what is missing.
    with pytest.raises(imucal.FormatError, match="--rate-hz"):
        imucal.read(path)


# Two files


def triad(path):
    """Time and samples of a file with a header of time and three axes, in the order x, y, z."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    header = [name[0].lower() for name in rows[0]]
    numbers = np.array(rows[1:], float)
    return numbers[:, 0], np.column_stack([numbers[:, header.index(axis)] for axis in "xyz"])


# Files, unit of the gyroscope, and what the warning says of its columns.
PAIRS = {
    "deg/s": (
        ("pair_headers_ignored/Accelerometer.csv", "pair_headers_ignored/Gyroscope.csv"),
        "dps",
        "gyro_x_dps, gyro_y_dps, gyro_z_dps from X (deg/s), Y (deg/s), Z (deg/s)",
    ),
    "z, y, x": (
        ("pair_headers_ignored/A_zyx.csv", "pair_headers_ignored/G_zyx.csv"),
        "radps",
        "gyro_x_radps, gyro_y_radps, gyro_z_radps from x, y, z",
    ),
}


@pytest.mark.parametrize("format", [None, "imu_tk", "pair"])
@pytest.mark.parametrize("name", PAIRS)
def test_headers_of_two_files(case_file, name, format):
    files, unit, said = PAIRS[name]
    paths = [case_file(file) for file in files]
    (time_s, force), (_, rate) = map(triad, paths)
    recording = imucal.read(*paths, format=format)
    assert_is(recording, Raw(time_s, force, rate * TO_SI[unit], ("mps2", unit)))
    assert said in found(recording, "read_by_header")


@pytest.mark.parametrize("given", [{"accel_unit": "lsb"}, {"gyro_unit": "rad/s"}, {"time_unit": "ms"}])
def test_options_that_contradict_the_headers_of_two_files(case_file, given):
    paths = [case_file(name) for name in PAIRS["deg/s"][0]]
    for format in ("imu_tk", "pair"):
        with pytest.raises(imucal.InputError, match=r"contradicts the given unit|is in s, --time-unit is ms"):
            imucal.read(*paths, format=format, **given)


def test_two_clocks(case_file, tmp_path):
    paths = [case_file(name) for name in ("two_clocks/Accelerometer.csv", "two_clocks/Gyroscope.csv")]
    (accel_s, force), (gyro_s, rate) = map(triad, paths)
    output = tmp_path / "both.csv"
    for order in (paths, paths[::-1]):
        assert main(["convert", *map(str, order), "-o", str(output)]) == 0
        recording = imucal.read(output)
        # The rates are equal, so the accelerometer is interpolated to the time stamps of the gyroscope, all
        # of which are between its first and its last.
        np.testing.assert_allclose(recording.time_s, gyro_s - gyro_s[0], atol=1e-9)
        expected = np.column_stack([np.interp(gyro_s, accel_s, force[:, axis]) for axis in range(3)])
        np.testing.assert_allclose(recording.specific_force, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(recording.angular_rate, rate)
        assert recording.rate_hz == pytest.approx(100.0)
    read = imucal.read(*paths)
    assert "its white noise per sample is 0.71 of the original" in found(read, "resampled")


def test_zip_of_text_files(case_file):
    path = case_file("zip_called_numpy/phone.zip")
    parsed = {}
    with zipfile.ZipFile(path) as archive:
        for name in ("Accelerometer.csv", "Gyroscope.csv"):
            header, *rows = csv.reader(archive.read(name).decode().splitlines())
            assert header == ["time", "seconds_elapsed", "z", "y", "x"]
            ns = np.array([int(row[0]) for row in rows])
            parsed[name] = ns, np.array([row[:1:-1] for row in rows], float)
    (ns, force), (gyro_ns, rate) = parsed.values()
    np.testing.assert_array_equal(ns, gyro_ns)
    recording = imucal.read(path)
    assert_is(recording, Raw((ns - ns[0]) / 1e9, force, rate, ("mps2", "radps")))
