"""Manifests, serial numbers from paths, the tables of a store, and what a store refuses."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.fleet.job import Job, Options, as_date
from imucal.fleet.manifest import jobs_of_manifest, shard, shard_of
from imucal.fleet.naming import naming_of
from imucal.fleet.schema import MIGRATIONS, connect_writing
from planted_fleet import planted_fleet
from stored_fleet import stored


def manifest(path, text):
    path.write_text(text)
    return list(jobs_of_manifest(path))


def test_rows_of_a_manifest_are_jobs(tmp_path):
    jobs = manifest(
        tmp_path / "day.csv",
        "serial,date,station,operator,batch,files,control,role\n"
        "7,2026-11-26T10:00:00+01:00,north,ann,b1,acc.csv; gyro.csv,c.csv,\n"
        '"A,8",2026-11-26,,,,/data/run.csv,,grr\n',
    )
    files = tuple(str(tmp_path / name) for name in ("acc.csv", "gyro.csv"))
    assert jobs[0] == Job("7", files, (str(tmp_path / "c.csv"),), "2026-11-26T09:00:00", "north", "ann", "b1")
    assert jobs[1] == Job("A,8", ("/data/run.csv",), date="2026-11-26", role="grr")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("serial,file\n7,a.csv\n", "'file' is unknown"),
        ("serial,date\n7,2026-01-01\n", "a column is missing"),
        ("serial,files\n7,a.csv\n,b.csv\n", "line 3: serial is empty"),
        ("serial,files\n7,\n", "line 2: files is empty"),
        ("serial,files\n7\n", "line 2: the row has not the 2 cells"),
        ("serial,files,date\n7,a.csv,26.11.2026\n", "line 2: unit 7: date is '26.11.2026'"),
    ],
)
def test_a_wrong_manifest_names_the_line(tmp_path, text, said):
    with pytest.raises(imucal.FormatError, match=said):
        manifest(tmp_path / "day.csv", text)


@pytest.mark.parametrize(
    ("pattern", "files", "expected"),
    [
        (None, ["d/run-0007.csv", "d/control-0007.csv"], [("0007", 1, 1)]),
        (None, ["0007/run.csv", "0007/control.csv", "0008/run.csv"], [("0007", 1, 1), ("0008", 1, 0)]),
        (None, ["d/A-17_acc.csv", "d/A-17_gyro.csv"], [("A-17", 2, 0)]),
        (None, ["mon/9.csv", "tue/9.csv"], [("9", 1, 0), ("9", 1, 0)]),
        ("{serial}/*-{role}.csv", ["x/7/a-run.csv", "x/7/a-control.csv"], [("7", 1, 1)]),
    ],
)
def test_serial_numbers_follow_from_paths(pattern, files, expected):
    jobs = naming_of(pattern).jobs(files)
    assert [(job.serial, len(job.files), len(job.control)) for job in jobs] == expected


def test_a_pattern_gives_the_columns_of_a_manifest():
    (job,) = naming_of("{station}/{date}/{serial}.csv").jobs(["/data/north/2026-11-26/0007.csv"])
    assert (job.station, job.date, job.serial) == ("north", "2026-11-26", "0007")
    for wrong in ("{date}.csv", "{serial}-{serial}.csv", "{serial}-{unit}.csv"):
        with pytest.raises(imucal.InputError, match="--names"):
            naming_of(wrong)
    with pytest.raises(imucal.InputError, match="does not end like"):
        naming_of("{serial}.npz").jobs(["0007.csv"])
    with pytest.raises(imucal.InputError, match="is a control recording"):
        naming_of(None).jobs(["control-0007.csv"])


def test_parts_have_each_job_once():
    jobs = [Job(str(number), ("x.csv",)) for number in range(10)]
    parts = [list(shard(jobs, shard_of(f"{part}/3"))) for part in (1, 2, 3)]
    assert sorted(job.serial for part in parts for job in part) == [job.serial for job in jobs]
    for wrong in ("0/3", "4/3", "3", "a/b"):
        with pytest.raises(imucal.InputError, match="give I/N"):
            shard_of(wrong)


def test_dates_sort_as_times_do():
    assert as_date("2026-11-26", "date") < as_date("2026-11-26T00:00:01Z", "date")
    assert as_date("2026-11-26T01:00+02:00", "date") == "2026-11-25T23:00:00"


def test_options_are_compared_as_text():
    assert (
        Options(calibrate={"min_rest_s": 1.0}).text
        == Options(calibrate={"min_rest_s": 1.0, "hold": None}).text
    )
    assert json.loads(Options(calibrate={"unit": "bmi088"}).text)["calibrate"]["unit"]["name"]
    with pytest.raises(imucal.InputError, match="plain values"):
        Options(calibrate={"effects": [lambda: 0]})
    with pytest.raises(imucal.InputError, match="control is no option"):
        Options(calibrate={"control": []})


def test_an_older_store_is_brought_to_this_version(tmp_path):
    path = tmp_path / "units.sqlite"
    connect_writing(path).close()

    def second(connection):
        connection.execute("ALTER TABLE jobs ADD COLUMN line TEXT")

    with closing(connect_writing(path, (*MIGRATIONS, second))) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (len(MIGRATIONS) + 1,)
        assert connection.execute("SELECT line FROM jobs").fetchall() == []
    # This version does not read or change the newer store.
    for use in (imucal.Fleet(path).count, lambda: connect_writing(path)):
        with pytest.raises(imucal.FormatError, match="install a newer imucal"):
            use()


def test_the_figures_of_a_store_of_version_1_are_kept(tmp_path):
    planted = planted_fleet(units=6, dates=2, drifting=0, odd=0).measurements
    figures = {"rests": np.arange(12.0), "noise_ratio": np.linspace(1.0, 2.0, 12)}
    fleet = stored(tmp_path / "units.sqlite", replace(planted, figures=figures))
    new = fleet.measurements()
    with closing(sqlite3.connect(fleet.path)) as connection:
        # What version 2 has added.
        for column in ("figure_names", "figure_values"):
            connection.execute(f"ALTER TABLE results DROP COLUMN {column}")
        connection.execute("PRAGMA user_version = 1")
    old = fleet.measurements()
    assert old.figures.keys() == new.figures.keys()
    assert {"rests", "noise_ratio", "temperature_degc"} <= old.figures.keys()
    for name, figure in old.figures.items():
        np.testing.assert_array_equal(figure, new.figures[name])
    assert np.isnan(old.figures["temperature_degc"]).all()
    assert sorted(old.figures["noise_ratio"]) == figures["noise_ratio"].tolist()


def test_a_failing_migration_changes_nothing(tmp_path):
    path = tmp_path / "units.sqlite"
    connect_writing(path).close()

    def broken(connection):
        connection.execute("ALTER TABLE jobs ADD COLUMN line TEXT")
        raise sqlite3.OperationalError("database or disk is full")

    with pytest.raises(imucal.InputError, match="free space on its disk"):
        connect_writing(path, (*MIGRATIONS, broken))
    assert imucal.Fleet(path).count() == {}


def test_other_files_are_no_stores(tmp_path):
    other = tmp_path / "other.sqlite"
    with closing(sqlite3.connect(other)) as connection:
        connection.execute("CREATE TABLE t (x)")
    (tmp_path / "text.sqlite").write_text("serial,files\n" * 100)
    with pytest.raises(imucal.FormatError, match="database of another program"):
        imucal.Fleet(other).merge(other.with_name("x"))
    with pytest.raises(imucal.InputError, match="it is no store, or is damaged"):
        imucal.Fleet(tmp_path / "text.sqlite").count()
    with pytest.raises(imucal.InputError, match="there is no such store"):
        imucal.Fleet(tmp_path / "none.sqlite").count()
    assert not (tmp_path / "none.sqlite").exists()


@pytest.mark.parametrize(
    "sql",
    ["DELETE FROM jobs", "ATTACH 'x.sqlite' AS x", "SELECT 1; SELECT 2", "SELEC", "PRAGMA user_version = 9"],
)
def test_a_query_only_reads(tmp_path, sql):
    path = tmp_path / "units.sqlite"
    connect_writing(path).close()
    before = Path(path).read_bytes()
    with pytest.raises(imucal.InputError):
        imucal.Fleet(path).query(sql)
    assert Path(path).read_bytes() == before
    assert imucal.Fleet(path).query("SELECT 1 AS one") == (["one"], [(1,)])


def test_an_empty_store_has_empty_tables(tmp_path):
    path = tmp_path / "units.sqlite"
    connect_writing(path).close()
    fleet = imucal.Fleet(path)
    assert fleet.to_arrow().num_rows == fleet.write_parquet(tmp_path / "units.parquet") == 0
    assert len(fleet.measurements(covariances=True)) == 0
    with pytest.raises(imucal.InputError, match="no calibration of unit '7'"):
        fleet.calibration("7")
