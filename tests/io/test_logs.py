"""Logs of PX4 and ArduPilot, each encoded by its own library: pyulog and pymavlink."""

import json
import struct

import numpy as np
import pytest
from pyulog import ULog

import imucal
from log_files import UNITS, combined, dataflash, encoded, imu, microseconds, pair, raw, ulog


def assert_is(recording, known):
    np.testing.assert_array_equal(recording.time_s, (known.time_ns - known.time_ns[0]) / 1e9)
    np.testing.assert_array_equal(recording.specific_force, known.accel)
    np.testing.assert_array_equal(recording.angular_rate, known.gyro)
    assert (recording.accel_unit, recording.gyro_unit) == ("m/s^2", "rad/s")


def codes(recording):
    return [finding.code for finding in recording.findings]


def test_ulog_of_both_sensors(tmp_path, known):
    ulog(tmp_path / "flight.ulg", *pair(known), ("vehicle_status", 0, [struct.pack("<QB", 1, 2)]))
    recording = imucal.read(tmp_path / "flight.ulg")
    assert_is(recording, known)
    np.testing.assert_array_equal(recording.temperature_degc, known.temperature)
    assert recording.findings == ()


def test_ulog_of_sensor_combined_says_that_px4_has_corrected_it(tmp_path, known):
    ulog(tmp_path / "flight.ulg", combined(microseconds(known), known.accel, known.gyro, [0] * 400))
    recording = imucal.read(tmp_path / "flight.ulg")
    assert_is(recording, known)
    assert recording.temperature_degc is None
    assert codes(recording) == ["already_corrected"]


def test_slower_accelerometer_of_sensor_combined_is_the_clock(tmp_path, known):
    # Every second message repeats the accelerometer's sample, with the time since it was taken.
    time_us, invalid = microseconds(known), 0x7FFFFFFF
    accel = np.repeat(known.accel[::2], 2, axis=0)
    relative_us = np.repeat(time_us[::2], 2) - time_us
    relative_us[-2:] = invalid
    ulog(tmp_path / "flight.ulg", combined(time_us, accel, known.gyro, relative_us.tolist()))
    recording = imucal.read(tmp_path / "flight.ulg")
    # The first sample of the clock has half of its interval before the first of the gyroscope.
    np.testing.assert_array_equal(recording.specific_force, known.accel[2:-2:2])
    assert codes(recording) == ["already_corrected", "resampled"]
    assert "averaged over the intervals" in recording.findings[1].message


def test_choices_of_a_ulog_are_listed(tmp_path, known):
    time_us = microseconds(known)
    path = tmp_path / "flight.ulg"
    ulog(path, *pair(known), *pair(known, 1), combined(time_us, -known.accel, known.gyro, [0] * 400))
    with pytest.raises(imucal.InputError) as caught:
        imucal.read(path)
    for words in (
        "flight.ulg contains 3 sensors",
        "--topic sensor_accel --instance 1 (",
        "--topic sensor_combined --instance 0 (",
        "corrected by PX4",
    ):
        assert words in str(caught.value)
    assert_is(imucal.read(path, topic="sensor_accel", instance=1), known)
    assert_is(imucal.read(path, topic="sensor_gyro", instance=0), known)
    np.testing.assert_array_equal(imucal.read(path, topic="sensor_combined").specific_force, -known.accel)
    with pytest.raises(imucal.InputError, match="there is no sensor_accel 2; found: --topic sensor_accel"):
        imucal.read(path, topic="sensor_accel", instance=2)


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        (lambda known: [("vehicle_status", 0, [struct.pack("<QB", 1, 2)])], "found of these: none: log them"),
        (lambda known: [pair(known)[0]], "found of these: sensor_accel 0"),
        (lambda known: [pair(known)[0], pair(known, 1)[1]], "found of these: sensor_accel 0, sensor_gyro 1"),
    ],
)
def test_ulog_without_both_sensors(tmp_path, known, messages, message):
    ulog(tmp_path / "flight.ulg", *messages(known))
    with pytest.raises(
        imucal.FormatError, match=f"contains neither sensor_accel with sensor_gyro.*{message}"
    ):
        imucal.read(tmp_path / "flight.ulg")


@pytest.mark.parametrize("kept", [0, 5, 20, 100])
def test_ulog_that_ends_before_its_data(tmp_path, known, kept):
    path = tmp_path / "flight.ulg"
    ulog(path, *pair(known))
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(
        imucal.FormatError, match=r"flight\.ulg (is empty|cannot be read as|contains neither)"
    ):
        imucal.read(path)


def test_cut_ulog_is_read_to_its_last_message(tmp_path, known):
    path = tmp_path / "flight.ulg"
    ulog(path, *pair(known))
    path.write_bytes(path.read_bytes()[:-30])
    recording = imucal.read(path)
    assert len(recording) == 399
    np.testing.assert_array_equal(recording.specific_force, known.accel[:399])


def test_damaged_ulog_says_so(tmp_path, known, capfd):
    path = tmp_path / "flight.ulg"
    ulog(path, *pair(known))
    # Junk between two messages, and the mark after which a reader finds its way again.
    content, row = path.read_bytes(), 3 + 2 + struct.calcsize("<QQI4fI3BB")
    sync = struct.pack("<HB", 8, ord("S")) + ULog.SYNC_BYTES
    path.write_bytes(content[: -400 * row] + bytes([1]) * 200 + sync + content[-400 * row :])
    recording = imucal.read(path)
    assert "file_damaged" in codes(recording)
    assert capfd.readouterr() == ("", "")
    assert_is(recording, known)


def test_dataflash_imu(tmp_path, known):
    dataflash(tmp_path / "flight.bin", ["IMU", "ATT"], [encoded("ATT", 1, 0.5), *imu(known)])
    recording = imucal.read(tmp_path / "flight.bin")
    assert_is(recording, known)
    np.testing.assert_array_equal(recording.temperature_degc, known.temperature)
    assert codes(recording) == ["already_corrected"]


@pytest.mark.parametrize(
    ("values", "way_out"),
    [
        ([0], None),
        ([2], "--board-orientation 2"),
        ([2, 2], "--board-orientation 2"),
        ([0, 6], "record again"),
    ],
)
def test_the_rotation_of_the_board_is_reported(tmp_path, known, values, way_out):
    parameters = [encoded("PARM", 1, "AHRS_ORIENTATION", float(value)) for value in values]
    others = [encoded("PARM", 1, "INS_GYR_CAL", 1.0)]
    dataflash(tmp_path / "flight.bin", ["IMU", "PARM"], [*others, *parameters, *imu(known)])
    recording = imucal.read(tmp_path / "flight.bin")
    assert_is(recording, known)
    found = [finding for finding in recording.findings if finding.code == "board_rotated"]
    assert bool(found) == (way_out is not None)
    assert all(way_out in str(finding) for finding in found)


def test_a_rotated_log_is_converted_only_with_axes(tmp_path, known, command):
    rotation = encoded("PARM", 1, "AHRS_ORIENTATION", 2.0)
    dataflash(tmp_path / "flight.bin", ["IMU", "PARM"], [rotation, *imu(known)])
    call = ["convert", str(tmp_path / "flight.bin"), "-o", str(tmp_path / "rec.csv")]
    refused = command(*call)
    assert refused.returncode == 1
    assert "AHRS_ORIENTATION is 2" in refused.stderr and "--axes" in refused.stderr
    assert not (tmp_path / "rec.csv").exists()
    assert command(*call, "--axes", "x,y,z").returncode == 0
    assert_is(imucal.read(tmp_path / "rec.csv"), known)


def test_dataflash_sensors_at_their_own_rate(tmp_path, known):
    time_us = microseconds(known)
    messages = [*raw("ACC", time_us, known.accel), *raw("GYR", time_us, known.gyro)]
    dataflash(tmp_path / "flight.bin", ["ACC", "GYR"], messages)
    recording = imucal.read(tmp_path / "flight.bin")
    assert_is(recording, known)
    assert recording.temperature_degc is None
    dataflash(tmp_path / "both.bin", ["IMU", "ACC", "GYR"], [*imu(known)[::10], *imu(known)[-1:], *messages])
    recording = imucal.read(tmp_path / "both.bin", topic="ACC")
    assert_is(recording, known)
    np.testing.assert_allclose(recording.temperature_degc, known.temperature, atol=1e-4)


def test_dataflash_before_4_1(tmp_path, known):
    rows = zip(microseconds(known).tolist(), known.gyro, known.accel, known.temperature, strict=True)
    messages = [
        encoded("IMU2", t, *rate, *force, 0, 0, degc, 1, 1, 400, 400) for t, rate, force, degc in rows
    ]
    dataflash(tmp_path / "flight.bin", ["IMU2"], messages)
    recording = imucal.read(tmp_path / "flight.bin", instance=1)
    assert_is(recording, known)
    np.testing.assert_array_equal(recording.temperature_degc, known.temperature)


def test_choices_of_a_dataflash_log_are_listed(tmp_path, known):
    path, time_us = tmp_path / "flight.bin", microseconds(known)
    high = [*raw("ACC", time_us, known.accel, 1), *raw("GYR", time_us, known.gyro, 1)]
    dataflash(path, ["IMU", "ACC", "GYR"], [*imu(known, 0), *imu(known, 1), *high])
    with pytest.raises(imucal.InputError) as caught:
        imucal.read(path)
    for words in ("contains 3 sensors", "--topic IMU --instance 1 (", "--topic ACC --instance 1 ("):
        assert words in str(caught.value)
    assert_is(imucal.read(path, topic="IMU", instance=0), known)
    assert_is(imucal.read(path, topic="GYR"), known)
    with pytest.raises(imucal.InputError, match="there is no ACC 0; found: --topic ACC --instance 1"):
        imucal.read(path, topic="ACC", instance=0)


def test_dataflash_of_other_units_and_without_sensors(tmp_path, known):
    path = tmp_path / "flight.bin"
    dataflash(path, ["IMU"], imu(known), units={"IMU": UNITS["IMU"].replace("E", "k")})
    with pytest.raises(imucal.FormatError, match=r"IMU.GyrX is in deg/s, expected rad/s"):
        imucal.read(path)
    dataflash(path, ["ATT"], [encoded("ATT", 1, 0.5)])
    with pytest.raises(
        imucal.FormatError, match=r"neither IMU nor ACC with GYR; found of these: none: .*LOG_BITMASK"
    ):
        imucal.read(path)


@pytest.mark.parametrize("kept", [0, 1, 50, 300])
def test_dataflash_that_ends_before_its_data(tmp_path, known, capfd, kept):
    path = tmp_path / "flight.bin"
    dataflash(path, ["IMU"], imu(known))
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(
        imucal.FormatError, match=r"flight\.bin (is empty|is not a|cannot be read as|contains neither)"
    ):
        imucal.read(path)
    assert capfd.readouterr() == ("", "")


def test_cut_and_damaged_dataflash_is_read_as_far_as_it_goes(tmp_path, known, capfd):
    path = tmp_path / "flight.bin"
    dataflash(path, ["IMU"], imu(known))
    content = bytearray(path.read_bytes())
    path.write_bytes(content[:-20])
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.specific_force, known.accel[:399])
    content[5000:5100] = bytes(100)
    path.write_bytes(content)
    recording = imucal.read(path)
    assert 395 < len(recording) < 400
    assert "file_damaged" in codes(recording)
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_examples_run_as_printed(tmp_path, known, example_of):
    ulog(tmp_path / "flight.ulg", *pair(known), *pair(known, 1))
    dataflash(tmp_path / "flight.bin", ["IMU"], [*imu(known), *imu(known, 1)])
    for format in ("ulog", "dataflash"):
        assert_is(example_of(format), known)


def test_convert_says_what_a_file_cannot_keep(tmp_path, known, command):
    path = tmp_path / "flight.ulg"
    ulog(path, combined(microseconds(known), known.accel, known.gyro, [0] * 400))
    done = command("convert", path, "-o", tmp_path / "rec.csv", "--json", tmp_path / "rec.json")
    assert "warning: flight.ulg: PX4 has applied its calibration parameters" in done.stdout
    document = json.loads((tmp_path / "rec.json").read_text())
    assert [finding["code"] for finding in document["findings"]] == ["already_corrected"]
    assert document["samples"] == 400
