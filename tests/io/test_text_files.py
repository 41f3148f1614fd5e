"""Text files with more than numbers: lines that are left out are counted, ambiguous files are refused."""

import datetime
import gzip
import zipfile

import numpy as np
import pytest

import imucal
from imucal.cli import main

ROWS = 400
HEADER = "time_s,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
RANDOM = np.random.default_rng(2)
NUMBERS = np.column_stack(
    [
        np.arange(ROWS) / 100,
        np.array([0.3, -0.2, 9.79]) + RANDOM.normal(scale=0.02, size=(ROWS, 3)),
        RANDOM.normal(scale=1e-3, size=(ROWS, 3)),
    ]
).round(5)
LINES = [",".join(f"{number:.5f}" for number in row) for row in NUMBERS]


def read(folder, lines, name="run.csv", end="\n", **options):
    path = folder / name
    path.write_text("\n".join(lines) + end)
    return imucal.read(path, **options)


def assert_rows(recording, rows=slice(None)):
    numbers = NUMBERS[rows]
    np.testing.assert_array_equal(recording.time_s, numbers[:, 0])
    np.testing.assert_array_equal(recording.specific_force, numbers[:, 1:4])
    np.testing.assert_array_equal(recording.angular_rate, numbers[:, 4:])


# Lines that are left out


@pytest.mark.parametrize(
    ("lines", "count", "message"),
    [
        ([*LINES[:50], "FIFO overflow!", *LINES[50:]], 1, "1 lines of text (the first: 'FIFO overflow!')"),
        ([*LINES[:50], HEADER, *LINES[50:]], 1, "1 lines of text (the first: 'time_s accel_x_mps2"),
        ([*LINES[:50], ",,,,,,", ",,,,,,", *LINES[50:]], 2, "2 rows without values"),
        (
            [*LINES, "", "Samples: 400", "Mean,0,0,9.8,0,0,0"],
            2,
            "1 lines of text (the first: 'Samples: 400')",
        ),
        ([*LINES, "# stopped"], 1, "1 lines of text (the first: '# stopped')"),
        ([*LINES[:50], "0.1,0.2", *LINES[50:]], 1, "1 lines with too few or too many values"),
    ],
)
def test_lines_that_are_no_rows_are_counted(tmp_path, lines, count, message):
    for header, options in (([HEADER], {}), ([], {"columns": HEADER})):
        recording = read(tmp_path, [*header, *lines], **options)
        assert_rows(recording)
        (finding,) = recording.findings
        assert (finding.code, finding.count) == ("lines_left_out", count)
        assert message in finding.message


def test_a_garbled_line_is_named_by_its_place(tmp_path):
    lines = [HEADER, *LINES]
    lines[201] = lines[201].replace(".", "@", 1)
    lines[90] += ",#"
    recording = read(tmp_path, lines)
    assert_rows(recording, np.delete(np.arange(ROWS), [200, 89]))
    assert "1 lines with text among the numbers (the first: line 202)" in recording.findings[0].message


@pytest.mark.parametrize("kept", [-3, -8, -14, -40])
def test_a_last_line_that_is_cut_is_left_out(tmp_path, kept):
    text = "\n".join([HEADER, *LINES])
    recording = read(tmp_path, [text[:kept]], end="")
    assert_rows(recording, slice(ROWS - 1))
    assert "an incomplete last line" in recording.findings[0].message


def test_a_whole_last_line_without_a_line_end_is_kept(tmp_path):
    assert_rows(read(tmp_path, [HEADER, *LINES], end=""))
    # With numbers of any length, a shorter one is no sign of a cut.
    numbers = [f"{i},0,0,9.8,0,0,{0.25 if i % 3 else 0.125}" for i in range(31)]
    assert len(read(tmp_path, [HEADER, *numbers], end="")) == 31


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [x for line in LINES[:50] for x in (line, "state: ok", "free: 3")],
            "100 lines of text among 50 rows",
        ),
        (
            [line.replace(".", "@", 1) if i % 20 == 5 else line for i, line in enumerate(LINES)],
            "line 7, column time_s",
        ),
        ([line[:30] if i % 20 == 5 else line for i, line in enumerate(LINES)], "line 7 has 4 values, 7 are"),
    ],
)
def test_too_many_such_lines_are_refused(tmp_path, lines, message):
    with pytest.raises(imucal.FormatError, match=message):
        read(tmp_path, [HEADER, *lines])


@pytest.mark.parametrize("copies", [[10], [10, 10, 200], list(range(100, 150))])
def test_copies_of_rows_are_left_out_wherever_they_stand(tmp_path, copies):
    adjacent = sorted([*range(ROWS), *copies])
    for order in (adjacent, [*range(ROWS), *copies]):
        recording = read(tmp_path, [HEADER, *(LINES[i] for i in order)])
        assert_rows(recording)
        (finding,) = recording.findings
        assert (finding.code, finding.count) == ("samples_duplicated", len(copies))
        pieces = list(imucal.io.read_pieces(tmp_path / "run.csv"))
        assert sum(map(len, pieces)) == ROWS


def test_coarse_stamps_are_not_taken_for_copies(tmp_path):
    # Two samples to a stamp, a few of them equal by chance.
    ticks = [f"{i // 2 / 50:.2f},0,0,{9.8 if i < 6 else i},0,0,0" for i in range(40)]
    recording = read(tmp_path, [HEADER, *ticks])
    assert len(recording) == 40
    assert recording.findings == ()


# Dates

FORMS = {
    "2026-01-31T23:59:58.010Z": lambda at: at.isoformat(timespec="milliseconds") + "Z",
    "2026-01-31 23:59:58:010": lambda at: at.strftime("%Y-%m-%d %H:%M:%S:%f")[:-3],
    "2026/01/31 23:59:58,010": lambda at: '"' + at.strftime("%Y/%m/%d %H:%M:%S,%f")[:-3] + '"',
    "20260131_235958010": lambda at: at.strftime("%Y%m%d_%H%M%S%f")[:-3],
    "31-Jan-2026 23:59:58.010": lambda at: at.strftime("%d-%b-%Y %H:%M:%S.%f")[:-3],
    "Jan 31, 2026 11:59:58.010 PM": lambda at: '"' + at.strftime("%b %d, %Y %I:%M:%S.%f %p") + '"',
    "31.01.2026 23:59:58.010": lambda at: at.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "01/31/2026 11:59:58.010 PM": lambda at: at.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    "23:59:58.010": lambda at: at.strftime("%H:%M:%S.%f"),
    "0 days 00:00:00.010": lambda at: f"0 days {(at - datetime.timedelta(hours=23)).strftime('%H:%M:%S.%f')}",
    "59:58.01": lambda at: at.strftime("%M:%S.%f")[:-4],
    "2026-01-31 23:59:58.010+01:00": lambda at: at.isoformat(timespec="milliseconds") + "+01:00",
}


@pytest.mark.parametrize("form", FORMS)
def test_dates_over_midnight(tmp_path, form):
    start = datetime.datetime(2026, 1, 31, 23, 59, 58)
    stamps = [FORMS[form](start + datetime.timedelta(milliseconds=10 * i)) for i in range(ROWS)]
    lines = [f"{at},{line.split(',', 1)[1]}" for at, line in zip(stamps, LINES, strict=True)]
    np.testing.assert_allclose(read(tmp_path, [HEADER, *lines]).time_s, NUMBERS[:, 0], atol=1e-9)


def test_a_date_of_another_form_is_named_with_the_forms_that_are_read(tmp_path):
    lines = [f"third day,{line.split(',', 1)[1]}" for line in LINES]
    with pytest.raises(imucal.FormatError, match=r"line 2, column time_s: 'third day' .*31-Jan-2026"):
        read(tmp_path, [HEADER, *lines])


# Headers


@pytest.mark.parametrize(
    ("header", "columns", "says"),
    [
        ("t,az,ay,ax,gz,gy,gx", HEADER, "accel_x_mps2 is given for the column 'az', which says the axis z"),
        ("t,gx,gy,gz,ax,ay,az", HEADER, "which says a gyroscope"),
        ("t (ms),ax,ay,az,gx,gy,gz", HEADER, "time_s is given for .* the unit ms"),
        ("t,a_x [mg],a_y [mg],a_z [mg],gx,gy,gz", HEADER, "the unit mg"),
        (
            "t,ax,ay,az,gx (°/s),gy (°/s),gz (°/s)",
            "time_s=t,accel_x_mps2=ax,accel_y_mps2=ay,accel_z_mps2=az,gyro_x_radps=gx (°/s),"
            "gyro_y_radps=gy (°/s),gyro_z_radps=gz (°/s)",
            "gyro_x_radps is given .* the unit deg/s:",
        ),
        (
            "t,a_x [hPa],a_y [hPa],a_z [hPa],gx,gy,gz",
            HEADER,
            r"'a_x \[hPa\]', which says a unit of another quantity",
        ),
    ],
)
def test_a_header_that_contradicts_the_given_columns(tmp_path, header, columns, says):
    with pytest.raises(imucal.InputError, match=says):
        read(tmp_path, [header, *LINES], columns=columns)
    # Whoever knows better leaves the header out.
    assert_rows(read(tmp_path, [header, *LINES], columns=HEADER, skip_rows=1))


def test_a_unit_that_the_numbers_exclude_is_refused(tmp_path):
    header = "Time (s),Acc x (g),Acc y (g),Acc z (g),Gyr x (rad/s),Gyr y (rad/s),Gyr z (rad/s)"
    with pytest.raises(imucal.FormatError, match=r"the header says g .* median magnitude then is 9.79 g"):
        read(tmp_path, [header, *LINES])


def test_acceleration_without_gravity_is_named(tmp_path):
    header = ",".join(
        [
            "t (s)",
            *(f"Linear Acceleration {a} (m/s^2)" for a in "xyz"),
            *(f"Gyroscope {a} (rad/s)" for a in "xyz"),
        ]
    )
    with pytest.raises(imucal.FormatError, match="without gravity"):
        read(tmp_path, [header, *LINES])


def test_the_same_names_mean_what_the_program_above_them_writes(tmp_path):
    names = ["SampleTimeFine", *(f"Acc_{a}" for a in "XYZ"), *(f"Gyr_{a}" for a in "XYZ")]
    ticks = [f"{i * 100},{line.split(',', 1)[1]}" for i, line in enumerate(LINES)]
    mti = read(tmp_path, ["// General information:", "//  MT Manager version: 4.6", ",".join(names), *ticks])
    np.testing.assert_allclose(mti.time_s, NUMBERS[:, 0], atol=1e-12)
    np.testing.assert_array_equal(mti.angular_rate, NUMBERS[:, 4:])
    dot = read(tmp_path, ["sep=,", "DeviceTag:,1", "OutputRate:,60Hz", ",".join(names), *ticks])
    np.testing.assert_allclose(dot.time_s, NUMBERS[:, 0] / 100, atol=1e-12)
    np.testing.assert_allclose(dot.angular_rate, np.radians(NUMBERS[:, 4:]), rtol=1e-12)
    with pytest.raises(imucal.FormatError, match="does not give every unit"):
        read(tmp_path, [",".join(names), *ticks])


# Two files

ACCEL, GYRO = "Time (s),X (m/s^2),Y (m/s^2),Z (m/s^2)", "Time (s),X (rad/s),Y (rad/s),Z (rad/s)"


def sensor(folder, name, header, values, delay_s=0.0):
    path = folder / name
    rows = [
        ",".join(map(repr, [at + delay_s, *row]))
        for at, row in zip(NUMBERS[:, 0].tolist(), values.tolist(), strict=True)
    ]
    path.write_text("\n".join([header, *rows, ""]))
    return path


def two(folder, accel_header=ACCEL, gyro_header=GYRO, names=("a.csv", "g.csv"), **options):
    return (
        sensor(folder, names[0], accel_header, NUMBERS[:, 1:4]),
        sensor(folder, names[1], gyro_header, NUMBERS[:, 4:], **options),
    )


def test_two_files_in_any_order_and_with_any_clock(tmp_path):
    paths = two(tmp_path)
    for given in (paths, paths[::-1]):
        assert_rows(imucal.read(*given))
    late = imucal.read(*two(tmp_path, delay_s=0.003))
    assert [finding.code for finding in late.findings] == ["read_by_header", "resampled"]
    np.testing.assert_array_equal(late.angular_rate, NUMBERS[:-1, 4:])


def test_commands_take_two_files_of_one_sensor_as_one_recording(tmp_path, capsys):
    main(["inspect", *map(str, two(tmp_path))])
    shown = capsys.readouterr()
    assert "a.csv + g.csv" in shown.out + shown.err


@pytest.mark.parametrize(
    ("headers", "options", "message"),
    [
        ((ACCEL, ACCEL), {}, "a.csv holds an accelerometer, g.csv an accelerometer"),
        ((ACCEL, "Time (s),X,Y,Z"), {"format": "pair"}, "gives no unit .*--gyro-unit"),
        (
            (ACCEL, GYRO),
            {"format": "pair", "gyro_unit": "deg/s"},
            "contradicts the given unit: it says radps",
        ),
        (
            (ACCEL, GYRO),
            {"format": "imu_tk", "accel_unit": "lsb"},
            "contradicts the given unit: it says mps2",
        ),
        ((ACCEL, GYRO), {"format": "pair", "time_unit": "ms"}, "Time \\(s\\) is in s, --time-unit is ms"),
        ((ACCEL, "Time (s),a,b,c"), {}, "no three columns x, y, z"),
    ],
)
def test_two_files_that_do_not_say_or_contradict(tmp_path, headers, options, message):
    with pytest.raises(imucal.ImucalError, match=message):
        imucal.read(*two(tmp_path, *headers), **options)


def test_units_that_no_header_gives_are_options(tmp_path):
    plain = "seconds,x,y,z"
    paths = two(tmp_path, plain, plain, ("accel.csv", "gyro.csv"))
    recording = imucal.read(*paths, accel_unit="m/s^2", gyro_unit="deg/s")
    np.testing.assert_allclose(recording.angular_rate, np.radians(NUMBERS[:, 4:]), rtol=1e-12)


def test_the_accelerometer_with_gravity_is_chosen_from_an_archive(tmp_path):
    header = "seconds_elapsed,z,y,x"
    without = NUMBERS[:, 1:4] - [0.3, -0.2, 9.79]
    files = [
        sensor(tmp_path, "Accelerometer.csv", header, without[:, ::-1]),
        sensor(tmp_path, "TotalAcceleration.csv", header, NUMBERS[:, 3:0:-1]),
        sensor(tmp_path, "Gyroscope.csv", header, NUMBERS[:, :3:-1]),
    ]

    def zipped(kept):
        with zipfile.ZipFile(tmp_path / "phone.zip", "w") as archive:
            for path in kept:
                archive.write(path, path.name)
        return tmp_path / "phone.zip"

    recording = imucal.read(zipped(files))
    assert_rows(recording)
    assert [source.path for source in recording.sources] == [str(tmp_path / "phone.zip")]
    with pytest.raises(imucal.FormatError, match=r"without gravity .*TotalAcceleration"):
        imucal.read(zipped([files[0], files[2]]))
    # Without the gyroscope's file it is a recording of the accelerometer alone, with a warning.
    alone = imucal.read(zipped(files[:2]))
    assert alone.angular_rate is None and "sensor_missing" in {finding.code for finding in alone.findings}
    assert np.array_equal(alone.specific_force, recording.specific_force)


def test_the_time_of_a_file_of_one_sensor_is_proposed(tmp_path):
    header = "t," + ",".join(HEADER.split(",")[1:4])
    rows = [line.rsplit(",", 3)[0] for line in LINES]
    with pytest.raises(imucal.FormatError, match="--columns 'time_s=t'") as caught:
        read(tmp_path, [header, *rows])
    assert "both files" not in str(caught.value)
    recording = read(tmp_path, [header, *rows], columns="time_s=t")
    np.testing.assert_array_equal(recording.time_s, NUMBERS[:, 0])
    np.testing.assert_array_equal(recording.specific_force, NUMBERS[:, 1:4])
    assert recording.angular_rate is None


# Other containers and lines


def test_a_gzip_file_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    # Really 200 MB, which would take seconds to make.
    monkeypatch.setattr("imucal.io.packed.ALWAYS_ALLOWED", 1_000_000)
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(f"{HEADER}\n".encode() + b"0,0,0,9.8,0,0,0\n" * 200_000, 1))
    with pytest.raises(imucal.FormatError, match="times larger decompressed"):
        imucal.read(path)


def sentence(row, start="VNIMU,"):
    body = start + ",".join(f"{number:+.6f}" for number in [0.1, 0.2, 0.3, *row, 25.5, 101.3])
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}"


def test_sentences_with_a_wrong_check_sum(tmp_path):
    good = [sentence(row) for row in NUMBERS[:, 1:]]
    bad = [line.replace("+9.", "+8.") if i in (7, 9) else line for i, line in enumerate(good)]
    recording = read(tmp_path, ["VN-100 log", *bad], rate_hz=100)
    kept = np.delete(np.arange(ROWS), [7, 9])
    np.testing.assert_array_equal(recording.angular_rate, NUMBERS[kept, 4:])
    np.testing.assert_array_equal(recording.temperature_degc, 25.5)
    told = "; ".join(finding.message for finding in recording.findings)
    assert "2 sentences with a wrong check sum" in told
    assert "1 other lines" in told
    with pytest.raises(imucal.FormatError, match=r"wrong check sum"):
        read(tmp_path, [line.replace("+9.", "+8.") for line in good[:-1]] + good[-1:], rate_hz=100)
    placeholder = read(tmp_path, [line.rpartition("*")[0] + "*XX" for line in good], rate_hz=100)
    assert [finding.code for finding in placeholder.findings] == ["checksums_missing"]


def test_other_sentences_are_read_by_their_fields(tmp_path):
    own = [sentence(row, "PIMU,A,") for row in NUMBERS[:, 1:]]
    mixed = [line for pair in zip(own, [sentence([], "GPX,")] * ROWS, strict=True) for line in pair]
    columns = "-,-,-,-,-," + HEADER.removeprefix("time_s,") + ",-,-"
    recording = read(tmp_path, mixed, columns=columns, rate_hz=100)
    np.testing.assert_array_equal(recording.specific_force, NUMBERS[:, 1:4])
    with pytest.raises(imucal.FormatError, match=r"\$PIMU with 12 fields.*name every field"):
        read(tmp_path, mixed, rate_hz=100)


@pytest.mark.parametrize(
    "form",
    [
        "ax:{} ay:{} az:{} gx:{} gy:{} gz:{}",
        "ax={}, ay={}, az={}, gx={}, gy={}, gz={}",
        '{{"ax": {}, "ay": {}, "az": {}, "gx": {}, "gy": {}, "gz": {}}}',
    ],
)
def test_lines_of_labels(tmp_path, form):
    lines = [form.format(*row) for row in NUMBERS[:, 1:]]
    columns = ",".join(f"accel_{a}_mps2=a{a},gyro_{a}_radps=g{a}" for a in "xyz")
    recording = read(tmp_path, ["ready", *lines[:9], "overflow!", *lines[9:]], columns=columns, rate_hz=100)
    np.testing.assert_array_equal(recording.specific_force, NUMBERS[:, 1:4])
    assert recording.findings[0].count == 2
    with pytest.raises(imucal.FormatError, match=r"accel_x_mps2=ax,.*gyro_z_radps=gz"):
        read(tmp_path, lines)


def test_stamps_of_the_serial_monitor_are_a_column(tmp_path):
    lines = [
        f"12:00:0{at:.3f} -> {line.split(',', 1)[1]}" for at, line in zip(NUMBERS[:, 0], LINES, strict=True)
    ]
    np.testing.assert_allclose(read(tmp_path, lines, columns=HEADER).time_s, NUMBERS[:, 0], atol=1e-9)


def test_bytes_that_are_no_text_in_a_bad_line(tmp_path):
    path = tmp_path / "run.csv"
    lines = [line.encode() for line in [HEADER, *LINES]]
    lines[100] = b"1.0,\xdc\xe8,2\x00"
    path.write_bytes(b"\n".join([*lines, b""]))
    recording = imucal.read(path)
    assert_rows(recording, np.delete(np.arange(ROWS), 99))
    assert recording.findings[0].count == 1
