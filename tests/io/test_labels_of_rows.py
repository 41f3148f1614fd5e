"""Columns that name the sensor, the unit or the session of a row, and columns that only look so."""

import json

import numpy as np
import pytest

import imucal
from export_files import DEG, FORCE, NS, RATE, ROWS, TIME_S, lines, write

NAMES = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
HEADER = ",".join(NAMES)


def check(recording):
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)


def wide(folder, column, labels):
    return write(folder, "run.csv", f"{column},{HEADER}", lines(labels, TIME_S, FORCE, RATE))


def long(folder, header, *blocks):
    """A table with one sensor per row; each block is the cells before the time, and the samples."""
    rows = [lines(*([cell] * ROWS for cell in cells), TIME_S, values) for *cells, values in blocks]
    return write(folder, "run.csv", header, *rows)


def test_a_column_of_units_gives_the_unit_of_each_sensor(tmp_path):
    header = "sensor,unit,time_s,x,y,z"
    blocks = ("acc", "m/s^2", FORCE), ("gyro", "deg/s", RATE / DEG)
    path = long(tmp_path, header, *blocks)
    check(imucal.read(path))
    with pytest.raises(imucal.InputError, match="contradicts the given unit: it says dps"):
        imucal.read(path, gyro_unit="rad/s")
    with pytest.raises(imucal.FormatError, match=r"not read \(turns/s\)"):
        imucal.read(long(tmp_path, header, blocks[0], ("gyro", "turns/s", RATE)))
    with pytest.raises(imucal.FormatError, match=r"sensor gyro have several units \(deg/s, rad/s\)"):
        imucal.read(long(tmp_path, header, *blocks, ("gyro", "rad/s", RATE)))


def test_labels_with_other_letters_name_one_sensor(tmp_path):
    halves = [
        lines([label] * len(part), TIME_S[part], values[part])
        for label, values, part in (
            ("acc", FORCE, slice(0, 150)),
            ("ACC", FORCE, slice(150, None)),
            ("Gyro", RATE, slice(0, 150)),
            ("gyro ", RATE, slice(150, None)),
        )
        for part in [np.arange(ROWS)[part]]
    ]
    path = write(tmp_path, "run.csv", "sensor,time_s,x,y,z", *halves)
    check(imucal.read(path, accel_unit="m/s^2", gyro_unit="rad/s"))


def test_a_block_of_the_other_sensor_is_found_in_a_column_of_any_name(tmp_path):
    many = np.arange(3000) % ROWS
    rows = [
        lines([label] * len(many), NS[0] + 10**7 * (np.arange(3000) + 3000 * at), values[many])
        for at, (label, values) in enumerate((("acc", FORCE), ("gyr", RATE)))
    ]
    path = write(tmp_path, "accelerometer.csv", "quantity,timestamp_ns,x,y,z", *rows)
    with pytest.raises(
        imucal.FormatError, match=r"one of 2 sensors, named in the column 'quantity' \(acc, gyr"
    ):
        imucal.read(path)


@pytest.mark.parametrize("column", ["session_id", "recording"])
def test_two_sessions_in_one_table_are_refused(tmp_path, column):
    check(imucal.read(wide(tmp_path, column, ["7"] * ROWS)))
    with pytest.raises(imucal.FormatError, match=rf"2 sessions, named in the column '{column}' .*rename it"):
        imucal.read(wide(tmp_path, column, ["7"] * 150 + ["8"] * 150))


@pytest.mark.parametrize(
    ("column", "labels"),
    [
        ("sensor_status", ["accel_ok", "gyro_ok"] * 150),
        ("serial_no", [str(at) for at in range(ROWS)]),
        ("device", ["IMU1", "imu1"] * 150),
    ],
)
def test_states_counters_and_spellings_are_no_sensors_and_no_units(tmp_path, column, labels):
    check(imucal.read(wide(tmp_path, column, labels)))
    rows = [
        {column: label, "time_s": t, "accel_mps2": f, "gyro_radps": w}
        for label, t, f, w in zip(labels, TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
    ]
    if column != "device":
        check(imucal.read(write(tmp_path, "run.jsonl", [json.dumps(row) for row in rows])))


def test_one_sensor_with_canonical_names_does_not_hide_the_other(tmp_path):
    header = ",".join(["time_s", *(f"acc_{a} (m/s^2)" for a in "xyz"), *NAMES[4:]])
    check(imucal.read(write(tmp_path, "run.csv", header, lines(TIME_S, FORCE, RATE))))


def test_a_list_of_another_length_among_triples_is_refused(tmp_path):
    rows = [
        {"time_s": t, "acc": [*f, *f] if at % 3 == 0 else f, "gyro": w}
        for at, (t, f, w) in enumerate(zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True))
    ]
    with pytest.raises(imucal.FormatError, match="member 'acc' of an object is a list with several samples"):
        imucal.read(write(tmp_path, "run.json", json.dumps(rows)))


def test_rows_of_two_topics_are_refused(tmp_path):
    rows = [
        {"topic": f"home/{side}/imu", "time_s": t, "accel_mps2": f, "gyro_radps": w}
        for t, own, w in zip(TIME_S.tolist(), FORCE, RATE.tolist(), strict=True)
        for side, f in (("a", own.tolist()), ("b", (-own).tolist()))
    ]
    with pytest.raises(imucal.FormatError, match="one of 2 units, named in the column 'topic'"):
        imucal.read(write(tmp_path, "run.jsonl", [json.dumps(row) for row in rows]))
