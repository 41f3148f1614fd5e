"""Headers that leave something open: what messages say of units, times and sensors, and what follows."""

import re
import shlex

import numpy as np
import pytest

import imucal

ROWS = 600
RANDOM = np.random.default_rng(11)
TIME_S = np.arange(ROWS) / 50
ACCEL_G = np.array([0.02, -0.01, 0.99]) + RANDOM.normal(scale=0.002, size=(ROWS, 3))
GYRO_DPS = RANDOM.normal(scale=0.06, size=(ROWS, 3))
SWUNG_RADPS = RANDOM.normal(scale=0.1, size=(ROWS, 3))
SHAKEN_G = ACCEL_G + RANDOM.normal(scale=0.1, size=(ROWS, 3))
GRAVITY = 9.80665


def table(header, *columns):
    cells = np.column_stack([np.asarray(column).astype(object) for column in columns])
    return [header, *(",".join(str(cell) for cell in row) for row in cells)]


def write(folder, lines, name="run.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def refusal(path, **options):
    with pytest.raises(imucal.FormatError) as caught:
        imucal.read(path, **options)
    return str(caught.value)


def proposed(message):
    """The values of --columns in a message."""
    return [shlex.split(found)[1] for found in re.findall(r"--columns '[^']*'", message)]


# Sensors


@pytest.mark.parametrize("name", ["GForce{}", "gforce_{}", "G-Force {}", "g force {}"])
def test_g_force_is_the_accelerometer(tmp_path, name):
    header = ",".join(["Time", *(name.format(axis) for axis in "XYZ"), "GyroX", "GyroY", "GyroZ"])
    path = write(tmp_path, table(header, TIME_S, ACCEL_G.round(5), GYRO_DPS.round(4)))
    (columns,) = proposed(refusal(path))
    recording = imucal.read(path, columns=columns)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(5) * GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, np.radians(GYRO_DPS.round(4)), rtol=1e-12)


@pytest.mark.parametrize(
    ("sensor", "other", "unit"), [("accelerometer", "gyroscope", "g"), ("gyroscope", "accelerometer", "dps")]
)
def test_one_sensor_among_other_columns_can_be_read_alone(tmp_path, sensor, other, unit):
    what, values = ("accel", ACCEL_G.round(4)) if sensor == "accelerometer" else ("gyro", GYRO_DPS.round(4))
    header = f"time,{what}_x,{what}_y,{what}_z,q0,q1,q2,q3"
    path = write(tmp_path, table(header, TIME_S, values, np.tile([1, 0, 0, 0], (ROWS, 1))))
    message = refusal(path)
    assert f"columns of the {sensor} ({what}_x, {what}_y, {what}_z)" in message
    assert f"if there are columns of the {other}, name them too" in message
    (columns,) = proposed(message)
    assert f"{what}_x_{unit}={what}_x" in columns
    recording = imucal.read(path, columns=columns)
    assert [finding.code for finding in recording.findings] == ["sensor_missing"]
    np.testing.assert_array_equal(recording.time_s, TIME_S)


LINES_OF_ONE_SENSOR = [
    f"{what} {20 * row} {x:.4f} {y:.4f} {z:.4f}"
    for row, samples in enumerate(zip(ACCEL_G, GYRO_DPS, strict=True))
    for what, (x, y, z) in zip(("acc", "gyro"), samples, strict=True)
]


def test_lines_of_one_sensor_each_are_refused_with_the_way_out(tmp_path):
    path = write(tmp_path, LINES_OF_ONE_SENSOR, "run.txt")
    for options in ({}, {"columns": "-,time_ms,accel_x_g,accel_y_g,accel_z_g"}):
        message = refusal(path, **options)
        assert "Each row contains one sensor, named in the column '1' (acc, gyro)" in message
        assert "write the rows of each sensor to a separate file, and give both files" in message
    files = [
        write(tmp_path, [line.split(" ", 1)[1] for line in LINES_OF_ONE_SENSOR if line.startswith(of)], of)
        for of in ("acc", "gyro")
    ]
    recording = imucal.read(*files, format="pair", time_unit="ms", accel_unit="g", gyro_unit="deg/s")
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(4) * GRAVITY, rtol=1e-12)


def test_labels_of_classes_are_no_sensors(tmp_path):
    labels = ["a" if row % 2 else "w" for row in range(ROWS)]
    lines = table("", labels, TIME_S, ACCEL_G.round(5))[1:]
    recording = imucal.read(write(tmp_path, lines), columns="-,time_s,accel_x_g,accel_y_g,accel_z_g")
    assert len(recording.time_s) == ROWS


def test_the_source_of_a_unit_is_said(tmp_path):
    for header, said in (
        ("t,ax,ay,az", "columns were read from the header; the unit g follows from the size of gravity"),
        ("t,ax (g),ay (g),az (g)", "columns and units were read from the header"),
    ):
        recording = imucal.read(write(tmp_path, table(header, TIME_S, ACCEL_G.round(5))))
        (message,) = [each.message for each in recording.findings if each.code == "read_by_header"]
        assert message.startswith(said)


def test_the_source_of_a_unit_is_said_for_two_files(tmp_path):
    gyro = tmp_path / "gyro.csv"
    gyro.write_text("\n".join(table("t,gx (deg/s),gy (deg/s),gz (deg/s)", TIME_S, ACCEL_G.round(5))))
    for header, said in (
        ("t,ax,ay,az", "columns were read from the headers; the unit g follows from the size of gravity"),
        ("t,ax (g),ay (g),az (g)", "columns and units were read from the headers"),
    ):
        recording = imucal.read(write(tmp_path, table(header, TIME_S, ACCEL_G.round(5))), gyro)
        (message,) = [each.message for each in recording.findings if each.code == "read_by_header"]
        assert message.startswith(said)


# Units


def test_a_unit_in_motion_does_not_exclude_rad_per_s(tmp_path):
    header = "time,ax,ay,az,gx,gy,gz"
    message = refusal(write(tmp_path, table(header, TIME_S, SHAKEN_G.round(5), SWUNG_RADPS.round(5))))
    assert "the data do not tell which" in message
    assert "Give the one that is right" in message
    assert ["gyro_x_dps=gx" in message, "gyro_x_radps=gx" in message] == [True, True]
    # The same rates while the accelerometer is at rest are noise, of which rad/s would be too much.
    still = refusal(write(tmp_path, table(header, TIME_S, ACCEL_G.round(5), SWUNG_RADPS.round(5))))
    assert ["gyro_x_dps=gx" in still, "gyro_x_radps=gx" in still] == [True, False]


def test_a_short_rest_in_much_motion_does_not_exclude_rad_per_s(tmp_path):
    radps = SWUNG_RADPS / 2
    radps[:40] /= 50
    lines = table("time,ax,ay,az,gx,gy,gz", TIME_S, ACCEL_G.round(5), radps.round(6))
    assert "the data do not tell which" in refusal(write(tmp_path, lines))


# Times


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (1_700_000_000 + np.arange(ROWS) // 20, "time: whole seconds since 1970, several samples in each"),
        (1 + np.arange(ROWS), "the column of the time counts by 1, so it can be the number of the sample"),
        (np.resize([16, 5, 6, 5], ROWS), "the column of the time does not increase"),
    ],
)
def test_a_column_that_is_no_clock_is_not_proposed(tmp_path, stamps, said):
    lines = table("t,ax,ay,az,gx,gy,gz", stamps, ACCEL_G.round(5), GYRO_DPS.round(4))
    message = refusal(write(tmp_path, lines))
    assert said in message
    assert "--rate-hz HZ" in message
    (columns,) = proposed(message)
    assert "time" not in columns


@pytest.mark.parametrize(("name", "unit", "ticks"), [("ustime", "us", 1e6), ("mstime", "ms", 1e3)])
def test_the_unit_of_time_in_one_word(tmp_path, name, unit, ticks):
    header = f"{name},ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"
    stamps = (5_000_000 + TIME_S * ticks).round().astype(int)
    recording = imucal.read(write(tmp_path, table(header, stamps, ACCEL_G.round(5), GYRO_DPS.round(4))))
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


@pytest.mark.parametrize("name", ["Time [10ms]", "Time (10 ms)", "Time_10ms", "Timestamp [100ns]"])
def test_a_multiple_of_a_unit_of_time_is_not_that_unit(tmp_path, name):
    header = f"{name},ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"
    lines = table(header, 7 + 2 * np.arange(ROWS), ACCEL_G.round(5), GYRO_DPS.round(4))
    path = write(tmp_path, lines)
    message = refusal(path)
    assert re.search(r"a unit of time that is not read \((10 ?ms|100ns)\)", message)
    assert "time_" not in "".join(proposed(message))
    np.testing.assert_array_equal(imucal.read(path, rate_hz=50).time_s, TIME_S)


@pytest.mark.parametrize("name", ["t1_ms", "Time [1 ms]", "Time 2 [ms]"])
def test_other_numbers_in_a_name_leave_the_unit_of_time(tmp_path, name):
    header = f"{name},ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"
    stamps = (7 + TIME_S * 1e3).round().astype(int)
    recording = imucal.read(write(tmp_path, table(header, stamps, ACCEL_G.round(5), GYRO_DPS.round(4))))
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def test_dates_with_underscores_are_dates(tmp_path):
    stamps = [f"2026_06_15_18_{22 + second // 60}_{second % 60:02}.{ms:03}" for second, ms in _clock()]
    for options, header in (
        ({}, "UTC_Time,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"),
        ({"columns": "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"}, None),
    ):
        lines = table(header, stamps, ACCEL_G.round(5), GYRO_DPS.round(4))
        recording = imucal.read(write(tmp_path, lines[0 if header else 1 :]), **options)
        np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def _clock():
    return [((55_000 + 20 * row) // 1000, 20 * row % 1000) for row in range(ROWS)]


def test_seconds_and_nanoseconds_with_the_source_at_the_end(tmp_path):
    names = ["stamp_sec_gps", "stamp_nanosec_gps", "stamp_sec_imu", "stamp_nanosec_imu"]
    names += [f"{what}_{axis}" for what in ("linear_acceleration", "angular_velocity") for axis in "xyz"]
    ns = (TIME_S * 1e9).round().astype(np.int64)
    lines = table(
        ",".join(names),
        np.full(ROWS, 1_700_000_000),
        np.full(ROWS, 0),
        1_700_000_003 + ns // 10**9,
        ns % 10**9,
        (ACCEL_G * GRAVITY).round(5),
        np.radians(GYRO_DPS).round(6),
    )
    recording = imucal.read(write(tmp_path, lines))
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def test_two_files_without_time_say_what_to_do(tmp_path):
    accel = write(tmp_path, table("ax (g),ay (g),az (g)", ACCEL_G.round(5)), "accel.csv")
    gyro = write(tmp_path, table("gx (deg/s),gy (deg/s),gz (deg/s)", GYRO_DPS.round(4)), "gyro.csv")
    with pytest.raises(imucal.FormatError, match="give the sampling rate with --rate-hz"):
        imucal.read(accel, gyro)
    followed = imucal.read(accel, gyro, rate_hz=50)
    np.testing.assert_allclose(followed.specific_force, ACCEL_G.round(5) * GRAVITY, rtol=1e-12)
    lines = [
        ",".join(pair)
        for pair in zip(accel.read_text().splitlines(), gyro.read_text().splitlines(), strict=True)
    ]
    recording = imucal.read(write(tmp_path, lines, "both.csv"), rate_hz=50)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(5) * GRAVITY, rtol=1e-12)
