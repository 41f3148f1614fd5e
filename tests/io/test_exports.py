"""The exports of makers and apps in docs/formats.md, each on a file in the form of its description."""

import gzip
import re
import shlex

import numpy as np
import pyarrow as pa
import pytest

import imucal
import maker_exports
import phone_exports
import program_exports
from export_files import DEG, FORCE, NS, RATE, RATE_HZ, ROWS, TIME_S, G, colon_dates, lines, write, zipped
from imucal.cli import main
from imucal.cli.exports_page import EXPORTS
from maker_exports import packets
from program_exports import realsense_lines

SAMPLES = phone_exports.SAMPLES | maker_exports.SAMPLES | program_exports.SAMPLES


def test_every_export_of_the_page_has_a_sample_and_the_other_way_round():
    assert sorted(export.name for export in EXPORTS) == sorted(SAMPLES)
    assert len(SAMPLES) >= 25


@pytest.mark.parametrize("name", SAMPLES)
def test_export_is_read(tmp_path, name):
    made = SAMPLES[name](tmp_path)
    recording = imucal.read(*made.paths, **made.options)
    assert (recording.accel_unit, recording.gyro_unit) == ("m/s^2", "rad/s")
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    codes = {finding.code for finding in recording.findings}
    assert codes <= {"read_by_header", "lines_left_out", *(["resampled"] if made.resampled else [])}
    if made.resampled:
        between = (FORCE[:-1] + FORCE[1:]) / 2
        np.testing.assert_allclose(recording.specific_force, between, atol=1e-9)
        np.testing.assert_allclose(recording.angular_rate, RATE[:-1], atol=1e-9)
        return
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=2e-6)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=made.tolerance)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=made.tolerance)


@pytest.mark.parametrize("name", SAMPLES)
def test_export_is_read_by_the_command_of_the_page(tmp_path, name, monkeypatch):
    """The command has the options that the sample needs, and no other."""
    made = SAMPLES[name](tmp_path)
    command = next(export.command for export in EXPORTS if export.name == name)
    for option in made.options:
        assert f"--{option.replace('_', '-')}" in command
    assert command.count("--") == len(made.options)


def test_realsense_streams_have_two_rates_and_a_clock_in_ms_or_us(tmp_path):
    read = [
        imucal.read(write(tmp_path, "imu_pose.csv", realsense_lines(ticks, step=2, late_ms=0.0)))
        for ticks in (1, 1000)
    ]
    for recording in read:
        assert [finding.code for finding in recording.findings] == ["resampled"]
        assert recording.rate_hz == pytest.approx(RATE_HZ / 2)
        np.testing.assert_allclose(recording.specific_force, FORCE[2::2], atol=1e-12)
        averaged = (RATE[1:-2:2] + 2 * RATE[2:-1:2] + RATE[3::2]) / 4
        np.testing.assert_allclose(recording.angular_rate, averaged, atol=1e-9)
    np.testing.assert_array_equal(read[0].time_s, read[1].time_s)


def test_realsense_lines_that_are_cut_are_counted_and_other_clocks_refused(tmp_path):
    cut = realsense_lines()
    cut[-1] = cut[-1][:60]
    warning = imucal.read(write(tmp_path, "imu_pose.csv", cut)).findings[0]
    assert (warning.code, warning.count) == ("lines_left_out", 1)
    for lines_of, message in (
        (realsense_lines(60), "neither ms nor us"),
        ([line for line in realsense_lines() if not line.startswith("Gyro")], "no samples of the gyroscope"),
        ([line.replace("3DOF_y", "y") for line in realsense_lines()], "'3DOF_y'"),
        ([line[:60] if "Gyro,1" in line else line for line in realsense_lines()], "do not have 8 values"),
    ):
        with pytest.raises(imucal.FormatError, match=message):
            imucal.read(write(tmp_path, "imu_pose.csv", lines_of))


def test_a_betaflight_log_is_named_with_the_command_that_converts_it(tmp_path):
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(
        b"H Product:Blackbox flight data recorder by Nicholas Sherman\nH Data version:2\n\x00I\x01"
    )
    with pytest.raises(imucal.FormatError, match=r"blackbox_decode --unit-rotation deg/s .* LOG00001.BFL"):
        imucal.read(path)


def test_a_text_log_of_ardupilot_is_named_with_the_command_that_converts_it(tmp_path):
    above = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", "PARM, 333, INS_ACC_ID, 1.0, 0"]
    rows = [f"IMU, {50_000_000 + 10_000 * i}, 0, {row}" for i, row in enumerate(lines(RATE, FORCE))]
    with pytest.raises(imucal.FormatError, match=r"give the log itself \(.bin\), .*--types IMU 00000001.log"):
        imucal.read(write(tmp_path, "00000001.log", above, rows))


def test_columns_of_which_only_the_first_has_a_name_are_x_y_z(tmp_path):
    files = [
        write(
            tmp_path, f"GX01-{name}.csv", f'"cts","date","{name} [{unit}]","1","2","temperature [°C]"', rows
        )
        for name, unit, rows in (
            ("Accelerometer", "m/s2", lines(TIME_S * 1000, colon_dates(), FORCE, np.full(ROWS, 40.0))),
            ("Gyroscope", "rad/s", lines(TIME_S * 1000, colon_dates(), RATE, np.full(ROWS, 40.0))),
        )
    ]
    recording = imucal.read(*files)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    assert "from Accelerometer [m/s2], 1, 2" in recording.findings[0].message


def test_topic_sensor_combined_of_px4_is_read_by_its_names(tmp_path):
    names = [
        *("timestamp", *(f"gyro_rad[{i}]" for i in range(3)), "gyro_integral_dt"),
        *("accelerometer_timestamp_relative", *(f"accelerometer_m_s2[{i}]" for i in range(3))),
    ]
    us, none = 50_000_000 + np.round(TIME_S * 1e6).astype(int), np.zeros(ROWS, int)
    path = write(tmp_path, "a.csv", ",".join(names), lines(us, RATE, none, none, FORCE))
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def test_sensor_combined_of_px4_as_text_is_already_corrected(tmp_path):
    names = [
        "timestamp",
        *(f"gyro_rad[{i}]" for i in range(3)),
        *(f"accelerometer_m_s2[{i}]" for i in range(3)),
    ]
    us = 50_000_000 + np.round(TIME_S * 1e6).astype(int)
    path = write(tmp_path, "flight_sensor_combined_0.csv", ",".join(names), lines(us, RATE, FORCE))
    canonical = [*(f"gyro_{a}_radps" for a in "xyz"), *(f"accel_{a}_mps2" for a in "xyz")]
    given = ",".join(f"{ours}={theirs}" for ours, theirs in zip(["time_us", *canonical], names, strict=True))
    frame = pa.table(dict(zip(names, [us, *RATE.T, *FORCE.T], strict=True)))
    for recording in (imucal.read(path), imucal.read(path, columns=given), imucal.read(frame)):
        found = [finding for finding in recording.findings if finding.code == "already_corrected"]
        assert [finding.message for finding in found] == [
            "PX4 has applied its calibration parameters (CAL_*, TC_*) to sensor_combined"
        ]
    # sensor_accel and sensor_gyro are not corrected.
    files = SAMPLES["PX4, ulog2csv"](tmp_path).paths
    assert "already_corrected" not in {finding.code for finding in imucal.read(*files).findings}


def test_degrees_per_sec_are_a_unit(tmp_path):
    names = ["Time (sec)", *(f"Gyro {a} (°/sec)" for a in "XYZ"), *(f"Accel {a} (mg)" for a in "XYZ")]
    path = write(tmp_path, "adis.csv", ",".join(names), lines(TIME_S, RATE / DEG, FORCE / G * 1000))
    np.testing.assert_allclose(imucal.read(path).angular_rate, RATE, atol=1e-12)


def test_linear_acceleration_that_includes_gravity_is_offered_as_the_accelerometer(tmp_path):
    names = ["id", "timestamp", *(f"ang_vel_{a}" for a in "xyz"), *(f"lin_acc_{a}" for a in "xyz")]
    rows = [np.arange(ROWS), NS / 1e9, RATE]
    path = write(tmp_path, "imu.txt", "# " + " ".join(names), lines(*rows, FORCE, separator=" "))
    with pytest.raises(imucal.FormatError, match=r"--columns '([^']*)'") as caught:
        imucal.read(path)
    columns = re.search(r"--columns '([^']*)'", str(caught.value))[1]
    np.testing.assert_array_equal(imucal.read(path, columns=columns).specific_force, FORCE)
    still = FORCE - FORCE.mean(axis=0)
    path = write(tmp_path, "linear.txt", "# " + " ".join(names), lines(*rows, still, separator=" "))
    with pytest.raises(imucal.FormatError, match="without gravity"):
        imucal.read(path)


@pytest.mark.parametrize(
    ("above", "rate"),
    [("// Sample rate: 100.0Hz", "100"), ("#sps,125", "125"), ("// Update Rate: 60Hz", "60"), ("// x", "HZ")],
)
def test_the_advice_has_the_rate_that_stands_above_the_header(tmp_path, above, rate):
    names = ["Counter", *(f"{what}_{a}" for what in ("Acc", "Gyr") for a in "XYZ")]
    rows = lines(np.arange(ROWS), FORCE, RATE, separator="\t")
    with pytest.raises(imucal.FormatError, match=f"--rate-hz {rate} "):
        imucal.read(write(tmp_path, "MT.txt", above, "\t".join(names), rows))
    # A given rate is kept.
    with pytest.raises(imucal.FormatError, match=r"--rate-hz 104\.1667 --columns 'accel_x"):
        imucal.read(write(tmp_path, "MT.txt", above, "\t".join(names), rows), rate_hz=104.1667)


@pytest.mark.parametrize("names", ["p q r", "roll_rate pitch_rate yaw_rate"])
def test_columns_of_rates_without_names_of_axes_are_offered(tmp_path, names):
    header = ["timestamps", *(f"acc_{a} (m/s2)" for a in "xyz"), *(f"{n} (deg/s)" for n in names.split())]
    path = write(tmp_path, "a.csv", ",".join(header), lines(1_767_268_800 + TIME_S, FORCE, RATE / DEG))
    with pytest.raises(imucal.FormatError, match=r"--columns '([^']*)'") as caught:
        imucal.read(path)
    recording = imucal.read(path, columns=re.search(r"--columns '([^']*)'", str(caught.value))[1])
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)
    assert recording.rate_hz == pytest.approx(RATE_HZ)


def test_columns_with_equal_names_are_named_in_their_order(tmp_path):
    path = write(tmp_path, "a.csv", "time,x,y,z,x,y,z", lines(TIME_S, FORCE, RATE))
    with pytest.raises(imucal.FormatError, match=r"x, y, z occur more than once .* --format columns"):
        imucal.read(path)
    columns = [
        "time_s",
        *(f"{what}_{a}_{unit}" for what, unit in (("accel", "mps2"), ("gyro", "radps")) for a in "xyz"),
    ]
    recording = imucal.read(path, columns=columns, format="columns")
    np.testing.assert_array_equal(recording.angular_rate, RATE)


def test_two_files_without_header_may_have_the_time_last(tmp_path):
    pair = [write(tmp_path, f"{n}.csv", lines(v, NS)) for n, v in (("accel", FORCE), ("gyro", RATE))]
    recording = imucal.read(*pair)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    assert [finding.code for finding in recording.findings] == ["counts_assumed"]
    in_units = imucal.read(*pair, accel_unit="m/s^2", gyro_unit="rad/s")
    np.testing.assert_array_equal(in_units.angular_rate, RATE)
    assert in_units.findings == ()
    np.testing.assert_allclose(in_units.time_s - in_units.time_s[0], TIME_S, atol=1e-6)


def test_packets_have_their_own_time_and_are_checked(tmp_path):
    content, path = packets(), tmp_path / "wt901.bin"
    path.write_bytes(content)
    recording = imucal.read(path)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_array_equal(recording.temperature_degc, 25.5)
    spoilt = bytearray(content)
    spoilt[44 * 50 + 11 + 4] ^= 1
    path.write_bytes(bytes(spoilt[:-7]))
    again = imucal.read(path)
    assert len(again) == ROWS - 1
    np.testing.assert_allclose(np.delete(TIME_S, 50), again.time_s, atol=1e-9)
    path.write_bytes(packets(scale=4.0))
    with pytest.raises(imucal.FormatError, match="set the ranges to 16 g"):
        imucal.read(path)


@pytest.mark.parametrize("kind", ["gzip", "utf-16", "utf-16-le", "zip"])
def test_packed_and_encoded_texts(tmp_path, kind):
    path = SAMPLES["phyphox, CSV (tabulator)"](tmp_path).paths[0]
    text = path.read_text()
    if kind == "gzip":
        path = tmp_path / "run.csv.gz"
        path.write_bytes(gzip.compress(text.encode()))
    elif kind == "zip":
        path = zipped(tmp_path, "run.zip")
    else:
        path.write_bytes(text.encode(kind))
    recording = imucal.read(path)
    np.testing.assert_allclose(recording.specific_force, FORCE, rtol=1e-12)
    assert len(recording.sources) == 1


def test_a_data_frame_is_read_by_names_with_units():
    dates = pa.array(NS.astype("datetime64[ns]"))
    frame = pa.table(
        {
            "timestamp": dates,
            **{f"acc_{a} [m/s^2]": FORCE[:, i] for i, a in enumerate("xyz")},
            **{f"gyr_{a} [rad/s]": RATE[:, i] for i, a in enumerate("xyz")},
        }
    )
    recording = imucal.read(frame)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    bare = frame.rename_columns([name.partition(" ")[0] for name in frame.column_names])
    with pytest.raises(imucal.FormatError, match=r"--columns 'time_s=timestamp,accel_x_mps2=acc_x,.*gyr_z'"):
        imucal.read(bare)


def test_a_data_frame_given_as_times_is_named():
    frame = pa.table({"time_s": TIME_S, **{f"accel_{a}_mps2": FORCE[:, i] for i, a in enumerate("xyz")}})
    with pytest.raises(imucal.InputError, match=r"give one \(imucal.read converts a Table\)"):
        imucal.Recording(frame)


def test_a_time_column_alone_does_not_make_the_other_names_canonical(tmp_path):
    names = ["time_us", *(f"acc[{i}] (g)" for i in range(3)), *(f"gyro[{i}] (deg/s)" for i in range(3))]
    us = np.round(TIME_S * 1e6).astype(int)
    recording = imucal.read(write(tmp_path, "a.csv", ",".join(names), lines(us, FORCE / G, RATE / DEG)))
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def test_what_cannot_be_read_is_named(tmp_path):
    units = "time(s),ax(mGal),ay(mGal),az(mGal),gx(rps),gy(rps),gz(rps)"
    for name, content, message in (
        ("a.csv", [units, *lines(TIME_S, FORCE * 1e5, RATE / DEG / 360)], r"not read \(mGal, rps\)"),
        ("a.json", ['{"version": 3, "platform": "android"}'], "is JSON without samples in a known form"),
    ):
        with pytest.raises(imucal.FormatError, match=message):
            imucal.read(write(tmp_path, name, content))


def test_the_rate_is_asked_for_where_no_name_has_the_unit_of_the_time(tmp_path):
    """SampleTimeFine counts in 100 us."""
    names = ["SampleTimeFine", *(f"{what}_{a}" for what in ("Acc", "Gyr", "Acc2") for a in "XYZ")]
    ticks = np.round(TIME_S * 1e4).astype(int)
    path = write(
        tmp_path, "a.txt", "// x", "\t".join(names), lines(ticks, FORCE, RATE, FORCE, separator="\t")
    )
    with pytest.raises(imucal.FormatError, match="--rate-hz HZ") as caught:
        imucal.read(path)
    assert "=SampleTimeFine" not in str(caught.value)


def test_the_columns_proposed_for_sensorlog_are_right_as_pasted(tmp_path, capsys):
    """The time is that of the samples, corrected samples are not used, and the sign of iOS is reversed."""
    made = SAMPLES["SensorLog (iOS)"](tmp_path)
    of_names, *rows = made.paths[0].read_text().splitlines()
    motion = [f"motionRotationRate{a}(rad/s)" for a in "XYZ"]
    # The same table with a number as the time of writing, and with the corrected rates first.
    seconds = [f"{1.7e9 + at:.3f},9,9,9,{row.split(',', 1)[1]}" for at, row in zip(TIME_S, rows, strict=True)]
    names = ",".join(["loggingTime(txt)", *motion, *of_names.split(",")[1:-3]])
    other = write(tmp_path, "other.csv", names, [row.rsplit(",", 3)[0] for row in seconds])
    for path in (made.paths[0], other):
        assert main(["inspect", str(path)]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert "reversed (-1 g on the axis that points up)" in said and "no usable time" not in said
        pasted = shlex.split(re.search(r"their units: (--columns '.*?' --axes \S+)\. ", said)[1])
        assert pasted[1] == made.options["columns"]
        assert main(["convert", str(path), *pasted, "-o", str(tmp_path / "rec.csv")]) == 0
        recording = imucal.read(tmp_path / "rec.csv")
        np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
        np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)
        np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=2e-6)


def test_no_file_of_sensorlog_is_read_with_the_reversed_sign(tmp_path):
    names = ["accelerometerTimestamp_sinceReboot(s)", *(f"accelerometerAcceleration{a}(G)" for a in "XYZ")]
    path = write(tmp_path, "accel.csv", ",".join(names), lines(TIME_S, -FORCE / G))
    with pytest.raises(imucal.FormatError, match=r"--axes accel=-x,-y,-z"):
        imucal.read(path)


def test_two_sensors_of_a_kind_are_the_reason_for_a_refusal(tmp_path):
    """Units and time are in the header."""
    sensors = (("acc", "m/s^2"), ("gyro1", "rad/s"), ("gyro2", "rad/s"))
    names = ["t (s)", *(f"{of} {a} ({unit})" for of, unit in sensors for a in "xyz")]
    path = write(tmp_path, "two.csv", ",".join(names), lines(TIME_S, FORCE, RATE, RATE))
    with pytest.raises(imucal.FormatError, match="the header names several sensors of a kind"):
        imucal.read(path)
