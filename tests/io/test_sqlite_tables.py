"""SQLite databases: which tables are read, which are left out, and that no file is left beside them."""

import json
import shutil
import sqlite3
import tracemalloc
from contextlib import closing

import numpy as np
import pytest

import imucal
from export_files import FORCE, NS, RATE, ROWS, TIME_S

UNIT = {"gyro_unit": "rad/s"}
WIDE = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
BOTH = np.column_stack([TIME_S, FORCE, RATE]).tolist()


def rows_of(values):
    return [[ns, *row] for ns, row in zip(NS.tolist(), values.tolist(), strict=True)]


def filled(database, table, columns, rows):
    database.execute(f"CREATE TABLE {table} ({', '.join(columns)})")
    database.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * len(columns))})", rows)


def of_two_tables(database):
    filled(database, "accelerometer", ["t", "x", "y", "z"], rows_of(FORCE))
    filled(database, "gyroscope", ["t", "x", "y", "z"], rows_of(RATE))


def made(folder, *parts, name="run.db"):
    path = folder / name
    with closing(sqlite3.connect(path)) as database, database:
        for part in parts:
            part(database)
    return path


def of_sensors(name, order=list, column="sensor", words=("accelerometer", "gyroscope")):
    rows = [
        [at, ns, word, *row]
        for word, values in zip(words, (FORCE, RATE), strict=True)
        for at, (ns, *row) in enumerate(rows_of(values))
    ]
    return lambda database: filled(database, name, ["id", "timestamp", column, "x", "y", "z"], order(rows))


def check(recording):
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def interleaved(rows):
    return [row for pair in zip(rows[:ROWS], rows[ROWS:], strict=True) for row in pair]


@pytest.mark.parametrize("order", [list, interleaved])
@pytest.mark.parametrize("name", ["samples", "acc_log", "accelerometer_and_gyroscope"])
@pytest.mark.parametrize("column", ["sensor", "kind"])
def test_a_table_with_the_name_of_the_sensor_in_each_row(tmp_path, order, name, column):
    path = made(tmp_path, of_sensors(name, order, column))
    check(imucal.read(path, **UNIT))
    with pytest.raises(imucal.FormatError, match="give --gyro-unit"):
        imucal.read(path)


def test_rows_without_the_name_of_a_sensor_are_counted(tmp_path):
    path = made(
        tmp_path,
        of_sensors("log"),
        lambda database: database.execute("INSERT INTO log VALUES (0, 1, NULL, 2.0, 3.0, 4.0)"),
    )
    recording = imucal.read(path, **UNIT)
    check(recording)
    assert "1 rows without the name of a sensor" in recording.findings[-1].message


def test_a_table_with_unknown_names_of_sensors_is_refused(tmp_path):
    path = made(tmp_path, of_sensors("acc_log", column="type", words=(1, 4)))
    with pytest.raises(imucal.FormatError, match=r"one of 2 sensors, named in the column 'type' \(1, 4\)"):
        imucal.read(path, accel_unit="m/s^2")


@pytest.mark.parametrize("units", [("left", "right"), (1, 2)])
def test_a_table_with_the_rows_of_two_units_one_after_the_other_is_refused(tmp_path, units):
    long = [[at / 100, *row[1:], unit] for unit in units for at, row in enumerate(BOTH * 10)]
    path = made(tmp_path, lambda database: filled(database, "imu", [*WIDE, "device_id"], long))
    with pytest.raises(imucal.FormatError, match="one of 2 units, named in the column 'device_id'"):
        imucal.read(path)


def test_texts_and_line_breaks_beside_the_numbers(tmp_path):
    texts = [f"text{i}" for i in range(9)]
    rows = [[*row, *texts[:8], "face up,\nflat" if at < 90 else None] for at, row in enumerate(BOTH)]
    path = made(tmp_path, lambda database: filled(database, "imu", [*WIDE, *texts], rows))
    recording = imucal.read(path)
    check(recording)
    assert not recording.findings
    whole = [dict(zip([*WIDE, *texts], row, strict=True)) for row in rows]
    (tmp_path / "run.json").write_text(json.dumps(whole))
    check(imucal.read(tmp_path / "run.json"))


def test_a_view_is_read_if_no_table_has_samples(tmp_path):
    names = [f"c{i}" for i in range(7)]
    view = "CREATE VIEW imu AS SELECT " + ", ".join(f"{a} AS {b}" for a, b in zip(names, WIDE, strict=True))
    path = made(
        tmp_path,
        lambda database: filled(database, "stored", names, BOTH),
        lambda database: database.execute(f"{view} FROM stored"),
    )
    check(imucal.read(path))
    with closing(sqlite3.connect(path)) as database, database:
        filled(database, "samples", WIDE, BOTH)
    check(imucal.read(path))


def test_tables_that_cannot_be_read_are_named_and_the_others_are_read(tmp_path):
    virtual = (
        "INSERT INTO sqlite_master (type, name, tbl_name, rootpage, sql) VALUES "
        "('table', 'places', 'places', 0, 'CREATE VIRTUAL TABLE places USING unknown_module()')"
    )
    path = made(
        tmp_path,
        of_two_tables,
        lambda database: filled(database, "log", ["m"], []),
        lambda database: database.execute("INSERT INTO log VALUES (CAST(x'ff41fe' AS TEXT))"),
        lambda database: database.execute("PRAGMA writable_schema = 1"),
        lambda database: database.execute(virtual),
    )
    recording = imucal.read(path, **UNIT)
    check(recording)
    assert "the table 'places' was left out" in recording.findings[-1].message


def test_blobs_are_not_read(tmp_path):
    rows = [[*row, b"\0\xff" * 25_000] for row in BOTH]
    path = made(tmp_path, lambda database: filled(database, "imu", [*WIDE, "photo"], rows))
    tracemalloc.start()
    recording = imucal.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    check(recording)
    assert not recording.findings
    assert peak < path.stat().st_size / 2


def test_a_damaged_database_is_no_bag(tmp_path):
    path = made(tmp_path, of_two_tables)
    cut = tmp_path / "cut.db"
    for size in (100, 20_000):
        cut.write_bytes(path.read_bytes()[:size])
        with pytest.raises(imucal.FormatError, match="cannot be read as an SQLite database"):
            imucal.read(cut)


def test_tables_with_the_names_of_those_of_a_bag(tmp_path):
    path = made(
        tmp_path,
        of_two_tables,
        lambda database: filled(database, "topics", ["id"], []),
        lambda database: filled(database, "messages", ["id"], []),
    )
    check(imucal.read(path, **UNIT))


def test_a_database_in_write_ahead_mode_is_left_as_it_is(tmp_path):
    folder, copied = tmp_path / "app", tmp_path / "copied"
    folder.mkdir()
    copied.mkdir()
    with closing(sqlite3.connect(folder / "run.db")) as database:
        database.execute("PRAGMA journal_mode = WAL")
        of_two_tables(database)
        database.commit()
        before = sorted(folder.iterdir())
        assert len(before) == 3
        check(imucal.read(folder / "run.db", **UNIT))
        assert sorted(folder.iterdir()) == before
        shutil.copy(folder / "run.db", copied / "alone.db")
        for ending in ("", "-wal"):
            shutil.copy(folder / f"run.db{ending}", copied)
    before = sorted(copied.iterdir())
    check(imucal.read(copied / "run.db", **UNIT))
    with pytest.raises(imucal.FormatError, match=r"if there was a file alone\.db-wal, .*: copy both files"):
        imucal.read(copied / "alone.db", **UNIT)
    assert sorted(copied.iterdir()) == before
    assert [own.name for own in folder.iterdir()] == ["run.db"]
    check(imucal.read(folder / "run.db", **UNIT))
    assert [own.name for own in folder.iterdir()] == ["run.db"]
