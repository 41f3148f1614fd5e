"""The command's frame: exit codes, messages without traceback, JSON for scripts."""

import json
import subprocess
import sys

import pytest

import imucal
from imucal.cli import main

HEADER = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"
COMMANDS = ("demo", "convert", "inspect", "calibrate", "evaluate", "apply", "simulate")


@pytest.fixture
def run_csv(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADER + "\n" + "".join(f"{i / 100},0,0,1,0,0,180\n" for i in range(5000)))
    return path


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(command in shown for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_has_an_example_and_json(command, capsys):
    assert main([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"Example: imucal {command}" in shown
    assert "--json" in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bogus"], "No such command 'bogus'"),
        (["convert"], "Missing argument"),
        (["convert", "x.csv"], "Missing option"),
        (["convert", "x.csv", "-o", "y.csv", "--rate-hz", "fast"], "--rate-hz"),
        (["convert", "x.csv", "-o", "y.csv", "--bogus"], "No such option"),
        (["convert", "none.csv", "-o", "y.csv"], "none.csv: there is no such file"),
        (["inspect", "none.csv"], "none.csv: there is no such file"),
        (["calibrate", "none.csv"], "none.csv: there is no such file"),
        (["calibrate", "none.csv", "--report", "page.html"], "give one with --control"),
        (["calibrate", "none.mat", "--format", "imu_tk"], "needs 2 for each recording"),
        (["evaluate", "none.json", "none.csv"], "none.json: there is no such file"),
        (["apply", "none.json", "none.csv", "-o", "y.csv"], "none.json: there is no such file"),
        (["simulate", "none.json", "-o", "y.csv"], "none.json: there is no such file"),
        (["simulate", "random", "--unit", "bogus", "-o", "y.csv"], "the unit 'bogus' is not known"),
        (["simulate", "random", "--seed", "-1", "-o", "y.csv"], "seed is -1"),
    ],
)
def test_bad_input_ends_with_1_and_a_message(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("imucal: ")
    assert message in shown.err
    assert "Traceback" not in shown.err
    assert list(tmp_path.iterdir()) == []


def test_convert_with_json_file_and_stdout(run_csv, tmp_path, capsys):
    output = tmp_path / "out.parquet"
    assert main(["convert", str(run_csv), "-o", str(output), "--json", str(tmp_path / "out.json")]) == 0
    assert "5000 samples, 49.990 s, 100 Hz" in capsys.readouterr().out
    document = json.loads((tmp_path / "out.json").read_text())
    assert (document["samples"], document["accel_unit"]) == (5000, "m/s^2")
    assert imucal.read(output).specific_force[0].tolist() == [0, 0, 9.80665]

    assert main(["convert", str(run_csv), "-o", str(output), "--json", "-"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out) == document
    assert "5000 samples" in shown.err


def test_reading_options_reach_the_reader(tmp_path, capsys):
    path = tmp_path / "raw.txt"
    path.write_text("some header\n1 2 3 4 5 6 7\n" * 2)
    columns = "-,accel_x_lsb,accel_y_lsb,accel_z_lsb,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb"
    options = ["--columns", columns, "--rate-hz", "50", "-o", str(tmp_path / "run.csv")]
    assert main(["convert", str(path), *options]) == 1
    assert "line 3 has 2 values, 7 are needed" in capsys.readouterr().err
    assert main(["convert", str(path), *options, "--skip-rows", "2"]) == 0
    assert imucal.read(tmp_path / "run.csv").specific_force.tolist() == [[2, 3, 4]]


def test_interrupt_ends_with_130(run_csv, tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", interrupted)
    assert main(["convert", str(run_csv), "-o", str(tmp_path / "out.csv")]) == 130
    assert capsys.readouterr().err == "imucal: interrupted, no file is half written\n"
    assert list(tmp_path.iterdir()) == [run_csv]


@pytest.mark.skipif(sys.platform == "win32", reason="pipes are POSIX")
def test_reader_that_goes_away_is_no_traceback(run_csv, tmp_path):
    command = f"{sys.executable} -m imucal.cli convert {run_csv} -o {tmp_path}/out.csv --json - | true"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


def test_a_bug_is_not_hidden(run_csv, tmp_path, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("imucal.io.write", broken)
    with pytest.raises(ZeroDivisionError):
        main(["convert", str(run_csv), "-o", str(tmp_path / "out.csv")])
