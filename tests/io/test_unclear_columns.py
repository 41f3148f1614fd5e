"""Columns that can mean several things: units, clocks, rows of several units, numbered axes."""

import re
import shlex

import numpy as np
import pytest

import imucal
from imucal.cli import main

ROWS = 400
RANDOM = np.random.default_rng(23)
TIME_S = np.arange(ROWS) / 50
ACCEL_G = np.array([0.02, -0.01, 0.99]) + RANDOM.normal(scale=0.002, size=(ROWS, 3))
GYRO_DPS = RANDOM.normal(scale=0.06, size=(ROWS, 3)).round(4)
GRAVITY = 9.80665
NAMES = "ax,ay,az,gx,gy,gz"
UNITS = "accel_x_g=ax,accel_y_g=ay,accel_z_g=az,gyro_x_dps=gx,gyro_y_dps=gy,gyro_z_dps=gz"
COLUMNS = "accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"


def table(header, *columns):
    cells = np.column_stack([np.asarray(column).astype(object) for column in columns])
    return [*([header] if header else []), *(",".join(str(cell) for cell in row) for row in cells)]


def write(folder, lines, name="run.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def refusal(*paths, **options):
    with pytest.raises(imucal.FormatError) as caught:
        imucal.read(*paths, **options)
    return str(caught.value)


def proposed(message):
    """The values of --columns in a message, each with the rate before it, or None."""
    found = re.findall(r"(?:--rate-hz (\S+) )?(--columns '[^']*')(?= or |\. )", message)
    return [(shlex.split(columns)[1], rate or None) for rate, columns in found]


# Units


@pytest.mark.parametrize(
    ("accel", "units"),
    [
        ((ACCEL_G / 0.99 * 981).round().astype(int), ["mg", "lsb"]),
        ((ACCEL_G / 0.99 * 1000).round().astype(int), ["mg", "lsb"]),
        ((ACCEL_G / 0.99 * 981).round(1), ["mg", "lsb"]),
        ((ACCEL_G / 0.99 * 1040).round().astype(int), ["mg"]),
        ((ACCEL_G / 0.99 * 1000).round(1), ["mg"]),
    ],
)
def test_counts_of_a_hundredth_of_m_per_s2_are_not_called_mg(tmp_path, accel, units):
    message = refusal(write(tmp_path, table(f"t,{NAMES}", TIME_S, accel, GYRO_DPS)))
    assert ("counts of 0.01 m/s^2" in message) == ("lsb" in units)
    assert [
        f"accel_x_{unit}=ax" in columns for unit, (columns, _) in zip(units, proposed(message), strict=True)
    ]
    for unit, (columns, _) in zip(units, proposed(message), strict=True):
        assert f"accel_x_{unit}=ax" in columns
        assert imucal.read(write(tmp_path, table(f"t,{NAMES}", TIME_S, accel, GYRO_DPS)), columns=columns)


def test_acceleration_without_gravity_is_not_called_g(tmp_path):
    linear = RANDOM.normal(scale=0.7, size=(ROWS, 3)).round(4)
    message = refusal(write(tmp_path, table(f"t,{NAMES}", TIME_S, linear, GYRO_DPS)))
    assert "it may be acceleration without gravity in m/s^2" in message
    assert [re.search("accel_x_([a-z0-9]+)=", columns)[1] for columns, _ in proposed(message)] == [
        "g",
        "mps2",
    ]
    # Strong motion with gravity in one direction is still in g.
    shaken = (ACCEL_G + RANDOM.normal(scale=0.5, size=(ROWS, 3))).round(4)
    message = refusal(write(tmp_path, table(f"t,{NAMES}", TIME_S, shaken, GYRO_DPS)))
    assert "without gravity" not in message
    assert "accel_x_g=ax" in message


def test_an_accelerometer_that_is_zero_is_not_proposed(tmp_path):
    header = "t,accX,accY,accZ,rawAccX,rawAccY,rawAccZ,rawGirX,rawGirY,rawGirZ"
    path = write(tmp_path, table(header, TIME_S, np.zeros((ROWS, 3)), ACCEL_G.round(4), GYRO_DPS))
    ((columns, _),) = proposed(refusal(path))
    recording = imucal.read(path, columns=columns)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(4) * GRAVITY, rtol=1e-12)


def test_files_without_a_header_that_are_no_counts_say_so(tmp_path):
    accel = write(tmp_path, table("", TIME_S, (ACCEL_G * GRAVITY).round(4)), "acc.txt")
    # Other time stamps of the gyroscope, for which the accelerometer is interpolated.
    gyro = write(tmp_path, table("", (TIME_S + 0.003).round(3), np.radians(GYRO_DPS).round(6)), "gyro.txt")
    for options in ({}, {"format": "pair"}):
        codes = {finding.code: finding for finding in imucal.read(accel, gyro, **options).findings}
        assert "--accel-unit m/s^2 --gyro-unit rad/s" in codes["counts_assumed"].way_out
    given = imucal.read(accel, gyro, accel_unit="m/s^2", gyro_unit="rad/s")
    assert [finding.code for finding in given.findings] == ["resampled"]


def test_other_columns_of_a_file_without_a_header_can_be_named(tmp_path):
    files = []
    for sensor, samples in (("ACCE", ACCEL_G.round(4)), ("GYRO", GYRO_DPS)):
        rows = table("", [sensor] * ROWS, TIME_S, samples, np.zeros(ROWS, int))
        files.append(write(tmp_path, rows, f"{sensor}.csv"))
    assert "write a line with the names of all columns above the rows" in refusal(*files, format="pair")
    for file in files:
        file.write_text("sensor,time,x,y,z,accuracy\n" + file.read_text())
    recording = imucal.read(*files, accel_unit="g", gyro_unit="deg/s", time_unit="s")
    np.testing.assert_allclose(recording.angular_rate, np.radians(GYRO_DPS), rtol=1e-12)


# Names


@pytest.mark.parametrize(
    "header",
    [
        "accel_x,accel_y,accel_z,giro_x,giro_y,giro_z",
        "acelX,acelY,acelZ,giroX,giroY,giroZ",
        "accl0,accl1,accl2,rot0,rot1,rot2",
        "acc_0,acc_1,acc_2,gyr_0,gyr_1,gyr_2",
    ],
)
def test_names_in_other_languages_and_numbered_axes(tmp_path, header):
    path = write(tmp_path, table(f"t,{header}", TIME_S, ACCEL_G.round(4), GYRO_DPS))
    ((columns, _),) = proposed(refusal(path))
    recording = imucal.read(path, columns=columns)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(4) * GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, np.radians(GYRO_DPS), rtol=1e-12)


def test_a_quaternion_is_no_sensor(tmp_path):
    turned = np.tile([0.1, 0.2, 0.3, 0.927], (ROWS, 1))
    assert "one sensor only" not in refusal(write(tmp_path, table("t,x,y,z,w", TIME_S, turned)))
    # Names that occur more than once do not tell which x, y, z belong to w.
    twice = write(tmp_path, table("t,x,y,z,x,y,z,w", TIME_S, ACCEL_G, turned))
    assert "the columns x, y, z occur more than once" in refusal(twice)
    # Four numbered columns are no axes either.
    numbered = write(tmp_path, table("t,acc0,acc1,acc2,acc3", TIME_S, turned))
    assert proposed(refusal(numbered)) == []


def test_rows_without_a_header_say_how_many_columns_there_are(tmp_path):
    many = refusal(write(tmp_path, table("", np.tile(ACCEL_G.round(3), (1, 5)))))
    assert ", ... (15 columns). " in many
    assert "7 columns" not in refusal(write(tmp_path, table("", TIME_S, ACCEL_G.round(3), GYRO_DPS)))


def test_lists_in_cells_are_named(tmp_path):
    cell = '"[""0.1"",""0.2"",""0.3""]"'
    message = refusal(
        write(tmp_path, ["id,time,ax,ay,az", *(f"a{row},{cell},{cell},{cell},{cell}" for row in range(9))])
    )
    assert "the cells hold lists" in message


def test_a_log_with_brackets_is_not_called_json(tmp_path):
    lines = [f"[{1e9 + row / 100}][{row}][State]: {{'roll': 0.5, 'pitch': -3}}" for row in range(60)]
    assert "JSON" not in refusal(write(tmp_path, lines, "run.txt"))
    for start in ("[[0.1, 0.2],", '[{"ax": 1},', "[\n0.1,", "[0.5, 0.6,"):
        assert "is JSON" in refusal(write(tmp_path, [start, "[0.3, 0.4]]"], "run.txt"))


# Times


def test_stamps_that_are_all_equal_are_no_time(tmp_path):
    header = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
    samples = np.column_stack([ACCEL_G * GRAVITY, np.radians(GYRO_DPS)]).round(6)
    path = write(
        tmp_path, ["// General information:", *table(header, np.arange(ROWS), np.zeros(ROWS, int), samples)]
    )
    message = refusal(path)
    assert "the header gives no usable time" in message
    assert f"the first {ROWS} time stamps are all 0, so they are no time" in message
    recording = imucal.read(path, rate_hz=50)
    np.testing.assert_array_equal(recording.time_s, TIME_S)


def test_stamps_that_are_too_coarse_for_the_rate(tmp_path):
    message = refusal(
        write(
            tmp_path, table(f"{NAMES},Timestamp", ACCEL_G.round(4), GYRO_DPS, 3581629 + np.arange(ROWS) // 2)
        )
    )
    assert "50 % of the stamps repeat the stamp before" in message
    ((columns, rate),) = proposed(message)
    assert ("time" in columns, rate) == (False, "HZ")
    # A counter of ms at almost 1 kHz repeats few stamps.
    stamps = np.arange(ROWS) - (np.arange(ROWS) // 20)
    ((columns, _),) = proposed(
        refusal(write(tmp_path, table(f"t,{NAMES}", stamps, ACCEL_G.round(4), GYRO_DPS)))
    )
    assert "time_ms=t" in columns


def test_blocks_that_are_written_twice_keep_their_time(tmp_path):
    rows = table("", (TIME_S * 1e3).round().astype(int), ACCEL_G.round(4), GYRO_DPS)
    twice = [row for at in range(0, ROWS, 4) for row in rows[at : at + 4] * 2]
    path = write(tmp_path, [f"t,{NAMES}", *twice])
    ((columns, _),) = proposed(refusal(path))
    assert "time_ms=t" in columns
    recording = imucal.read(path, columns=columns)
    inspection = imucal.inspect(recording)
    assert inspection.rate_hz == pytest.approx(50, rel=1e-3)
    assert "samples_duplicated" in [finding.code for finding in inspection.findings]


@pytest.mark.parametrize(
    ("header", "chosen"),
    [
        (f"server_time,device_time_ms,{NAMES}", "time_ms=device_time_ms"),
        (f"iso_time,time,{NAMES}", "time_s=time"),
        (f"iso_time,imu.timeStamp_lowG,{NAMES}", "time_s=iso_time"),
    ],
)
def test_the_finest_clock_is_proposed(tmp_path, header, chosen):
    dates = [f"2026-05-21T16:07:{row // 10 % 60:02}.{row % 10}00" for row in range(ROWS)]
    clock = 1779347254.25 + TIME_S if ",time," in header else (5000 + TIME_S * 1e3).round().astype(int)
    path = write(tmp_path, table(header, dates, clock, ACCEL_G.round(4), GYRO_DPS))
    ((columns, _),) = proposed(refusal(path))
    assert columns.startswith(chosen + ",")


def test_a_sensor_in_the_name_of_the_time_leaves_it_a_time(tmp_path):
    header = ",".join(f"lowG_data.{name}" for name in ("timeStamp_lowG", *NAMES.split(",")))
    path = write(tmp_path, table(header, (TIME_S * 1e6).round().astype(int), ACCEL_G.round(4), GYRO_DPS))
    ((columns, _),) = proposed(refusal(path))
    np.testing.assert_allclose(imucal.read(path, columns=columns).time_s, TIME_S, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("# Config: data_rate = 2000.0 Hz, filter = 488 Hz", "2000"),
        ("Frecuencia (Hz);100", "100"),
        ("% Sampling frequency: 62.5 Hz", "62.5"),
        ("# Sample_rate,50", "50"),
        ("# Baud rate: 115200", "HZ"),
        ("# Cutoff frequency: 20 Hz", "HZ"),
    ],
)
def test_the_rate_before_the_header(tmp_path, line, rate):
    path = write(tmp_path, [line, *table(NAMES, ACCEL_G.round(4), GYRO_DPS)])
    assert [given for _, given in proposed(refusal(path))] == [rate]


def test_an_unknown_rate_is_not_printed_as_a_number(tmp_path, capsys):
    header = f"time_s,{COLUMNS}"
    path = write(tmp_path, table(header, 7 + np.arange(ROWS) // 50, ACCEL_G.round(4), GYRO_DPS))
    assert main(["inspect", str(path)]) == 2
    first, *_ = capsys.readouterr().out.splitlines()
    assert "rate unknown (most time steps are 0)" in first
    assert "nan" not in first


def test_two_files_with_whole_seconds_say_that_they_are_too_coarse(tmp_path):
    dates = [f"2026-05-21 16:07:{second:02}" for second in np.arange(ROWS) // 50]
    accel = write(tmp_path, table("Timestamp,ax (g),ay (g),az (g)", dates, ACCEL_G.round(4)), "a.csv")
    other = ["2026-05-21 16:07:00", *dates[:-1]]
    gyro = write(tmp_path, table("Timestamp,gx (deg/s),gy (deg/s),gz (deg/s)", other, GYRO_DPS), "g.csv")
    message = refusal(accel, gyro)
    assert f"{ROWS - 8} time stamps of a.csv are those of the sample before" in message
    assert "write time stamps of finer resolution" in message


# Rows of several units

OTHER_G = np.array([0.97, 0.1, -0.2]) + RANDOM.normal(scale=0.002, size=(ROWS, 3))


@pytest.mark.parametrize("block", [1, 4])
@pytest.mark.parametrize("labels", [("Mov", "Wrist"), ("0x50", "0x51"), ("1", "2")])
def test_rows_of_two_units_are_refused_with_the_way_out(tmp_path, block, labels):
    which = np.arange(ROWS) // block % 2
    accel = np.where(which[:, None] == 0, ACCEL_G, OTHER_G).round(4)
    names = [labels[unit] for unit in which]
    path = write(tmp_path, table(f"t,{NAMES},canal", TIME_S, accel, GYRO_DPS, names))
    message = refusal(path, columns=f"time_s=t,{UNITS}")
    assert f"one of 2 units, named in the column 'canal' ({', '.join(labels)})" in message
    bare = write(tmp_path, table("", TIME_S, accel, GYRO_DPS, names))
    assert "named in the column '7'" in refusal(bare, columns=f"time_s,{COLUMNS},-")
    alone = [row for row, unit in zip(bare.read_text().splitlines(), which, strict=True) if unit == 0]
    recording = imucal.read(write(tmp_path, alone), columns=f"time_s,{COLUMNS},-")
    np.testing.assert_allclose(recording.specific_force, ACCEL_G[which == 0].round(4) * GRAVITY, rtol=1e-12)


@pytest.mark.parametrize("kinds", [["a", "w"], ["0", "1", "1"], ["OK"], ["rest"] * 30 + ["move"] * 30])
def test_labels_that_do_not_divide_the_samples_are_no_units(tmp_path, kinds):
    moving = ACCEL_G + 0.3 * np.sin(TIME_S[:, None] * [3, 4, 5])
    labels = [kinds[row % len(kinds)] for row in range(ROWS)]
    path = write(tmp_path, table(f"t,{NAMES},label", TIME_S, moving.round(4), GYRO_DPS, labels))
    assert len(imucal.read(path, columns=f"time_s=t,{UNITS}").time_s) == ROWS


# Lines and packets


@pytest.mark.parametrize("colon", [": ", ":", " - ", " | ", " "])
def test_lines_with_a_colon_after_the_sensor(tmp_path, colon):
    lines = [
        f"{what}{colon}X={x} Y={y} Z={z}"
        for samples in zip(ACCEL_G.round(4), GYRO_DPS, strict=True)
        for what, (x, y, z) in zip(("ACCEL", "GYRO"), samples, strict=True)
    ]
    path = write(tmp_path, lines, "run.log")
    ((columns, rate),) = proposed(refusal(path))
    assert rate == "HZ"
    recording = imucal.read(path, columns=columns, rate_hz=50)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G.round(4) * GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, np.radians(GYRO_DPS), rtol=1e-12)


def packets(has_time):
    made = b""
    for row, (accel, gyro) in enumerate(zip(ACCEL_G, GYRO_DPS, strict=True)):
        counts = np.round([*(accel / 16 * 32768), *(gyro / 2000 * 32768), 1, 2, 3])
        second, ms = divmod(20 * row, 1000)
        stamp = bytes([26, 6, 22, 14, 59, 50 + second]) + ms.to_bytes(2, "little")
        made += b"\x55\x61" + counts.astype("<i2").tobytes() + stamp * has_time
    return made


@pytest.mark.parametrize("has_time", [True, False])
def test_packets_of_witmotion_with_a_whole_sample(tmp_path, has_time):
    path = tmp_path / "WIT18.TXT"
    path.write_bytes(packets(has_time))
    if not has_time:
        assert "give the sample rate" in refusal(path)
    recording = imucal.read(path, **({} if has_time else {"rate_hz": 50}))
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.specific_force, ACCEL_G * GRAVITY, atol=3e-3)
    np.testing.assert_allclose(recording.angular_rate, np.radians(GYRO_DPS), atol=6e-4)
    assert not recording.findings
    lost = packets(has_time)
    path.write_bytes(lost[:1001] + lost[1400:])
    (finding,) = imucal.read(path, **({} if has_time else {"rate_hz": 50})).findings
    assert finding.code == "file_damaged"
