"""The command's frame: exit codes, messages without traceback, JSON for scripts.

The application object is searched for its commands, and functions are replaced by failing ones, because no
input makes them fail.
"""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import imucal
from children import HANGS_S
from imucal.cli import main
from imucal.cli.app import TASKS, app
from imucal.cli.working import working
from imucal.effects.disturbance import disturbances

HEADER = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"


def commands(group=app, words=()):
    """The words of every command."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if hasattr(command, "list_commands"):
            yield from commands(command, (*words, name))
        else:
            yield (*words, name)


COMMANDS = [" ".join(words) for words in commands()]


@pytest.fixture
def run_csv(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADER + "\n" + "".join(f"{i / 100},0,0,1,0,0,180\n" for i in range(5000)))
    return path


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f" {command.split()[0]} " in shown for command in COMMANDS)
    assert "--install-completion" in shown


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_has_an_example_and_json(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"Example: imucal {command}" in shown
    # `imucal help` has no result.
    assert "--json" in shown or command == "help"


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
        (["calibrate", "none.mat", "--format", "imu_tk"], "needs 2 for each recording"),
        (["evaluate", "none.json", "none.csv"], "none.json: there is no such file"),
        (["apply", "none.json", "none.csv", "-o", "y.csv"], "none.json: there is no such file"),
        (["noise", "none.csv", "--report", "n.html"], "none.csv: there is no such file"),
        (["simulate", "none.json", "-o", "y.csv"], "none.json: there is no such file"),
        (["simulate", "random", "--unit", "bogus", "-o", "y.csv"], "the unit 'bogus' is not known"),
        (["simulate", "random", "--seed", "-1", "-o", "y.csv"], "seed is -1"),
        (["demo", "--seed", "7", "gap"], "options of `imucal demo gap` must follow gap"),
        (["effects", "gyro_g_sens"], "no effect 'gyro_g_sens': is it gyro_g_sensitivity"),
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


def test_json_of_a_command_without_a_result_says_why(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("last.json").write_text('{"verdict": "good"}')
    assert main(["calibrate", "none.csv", "--json", "last.json"]) == 1
    document = json.loads(Path("last.json").read_text())
    assert (document["schema"], document["verdict"]) == ("imucal.error/1", "no_result")
    assert document["error"] == "InputError"
    assert "none.csv: there is no such file" in document["reasons"][0]
    assert document["reasons"][0] in capsys.readouterr().err

    rows = (f"{i / 100},0,0,1,0,0,{'nan' if i == 7 else 180}\n" for i in range(5000))
    Path("nan.csv").write_text(HEADER + "\n" + "".join(rows))
    assert main(["calibrate", "nan.csv", "--json", "-"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert "non_finite" in [finding["code"] for finding in document["findings"]]

    # A disk that is full must not hide what is wrong.
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("imucal.document.temporary.TemporaryFile.replace", full)
    assert main(["inspect", "none.csv", "--json", "x.json"]) == 1
    assert "none.csv: there is no such file" in capsys.readouterr().err


def interrupted_in_a_class():
    """As Python 3.11 raises it for an interrupt while a module with a class is imported."""
    error = RuntimeError("Error calling __set_name__ on 'Field' instance 'references' in 'Calibration'")
    error.__cause__ = KeyboardInterrupt()
    return error


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (interrupted_in_a_class(), 130, "interrupted"),
        (ZeroDivisionError("by zero"), 1, "this is a bug of imucal"),
        (MemoryError(), 1, "not enough memory"),
        (OSError(28, "No space left on device", "cal.json"), 1, "cal.json: No space left on device"),
    ],
)
def test_json_never_holds_the_last_runs_verdict(error, code, said, run_csv, monkeypatch, capsys):
    def broken(*_, **__):
        raise error

    monkeypatch.chdir(run_csv.parent)
    Path("last.json").write_text('{"verdict": "good"}')
    monkeypatch.setattr("imucal.inspect", broken)
    assert main(["inspect", "run.csv", "--json", "last.json"]) == code
    document = json.loads(Path("last.json").read_text())
    assert (document["schema"], document["verdict"]) == ("imucal.error/1", "no_result")
    assert document["error"] == ("KeyboardInterrupt" if code == 130 else type(error).__name__)
    assert said in document["reasons"][0]
    assert said in capsys.readouterr().err


def test_json_keeps_the_result_when_the_summary_is_interrupted(run_csv, monkeypatch, capsys):
    def broken(*_):
        raise KeyboardInterrupt

    monkeypatch.chdir(run_csv.parent)
    monkeypatch.setattr("imucal.cli.output.Output.line", broken)
    for path in ("new.json", "-"):
        assert main(["inspect", "run.csv", "--json", path]) == 130
    for text in (Path("new.json").read_text(), capsys.readouterr().out):
        assert list(json.loads(text)) == ["recordings"]


@pytest.mark.slow
@pytest.mark.parametrize("command", [["demo"], ["demo", "gap"]])
def test_a_demonstration_writes_over_none_but_its_own(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("of a real unit")
    assert main([*command, "-o", "."]) == 1
    assert "run.csv exists" in capsys.readouterr().err
    assert Path("run.csv").read_text() == "of a real unit"
    for _ in range(2):
        assert main([*command, "-o", "new"]) == 0


def test_json_of_a_group_that_is_a_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("demo").write_text("no folder")
    assert main(["demo", "--json", "why.json"]) == 1
    assert "demo cannot be created" in json.loads(Path("why.json").read_text())["reasons"][0]


@pytest.mark.parametrize("json_option", [["--json", "last.json"], ["--json=last.json"]])
@pytest.mark.parametrize("there", ['{"verdict": "good"}', None])
def test_json_of_a_command_line_that_is_refused(json_option, there, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if there is not None:
        Path("last.json").write_text(there)
    assert main(["calibrate", "run.csv", *json_option, "--gravity", "heavy"]) == 1
    document = json.loads(Path("last.json").read_text())
    assert document["verdict"] == "no_result"
    assert "--gravity" in document["reasons"][0]
    assert document["reasons"][0] in capsys.readouterr().err


@pytest.mark.parametrize("data", ['{"schema": "imucal.calibration/1"}', "time_s\n", "{", "[1]"])
def test_data_in_the_place_of_a_forgotten_json_value_are_kept(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("data").write_text(data)
    assert main(["inspect", "--json", "data"]) == 1
    assert main(["evaluate", "data", "--json=data"]) == 1
    assert Path("data").read_text() == data
    assert list(tmp_path.iterdir()) == [Path("data").resolve()]


def test_a_journal_is_not_taken_for_the_last_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv.journal").write_text("samples")
    assert main(["stand", "run", "random", "-o", "run.csv", "--json", "run.csv.journal"]) == 1
    assert Path("run.csv.journal").read_text() == "samples"


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
    assert main(["convert", str(path), *options]) == 0
    assert "1 lines of text (the first: 'some header')" in capsys.readouterr().out
    assert main(["convert", str(path), *options, "--skip-rows", "2"]) == 0
    assert "left out" not in capsys.readouterr().out
    assert imucal.read(tmp_path / "run.csv").specific_force.tolist() == [[2, 3, 4]]


def test_interrupt_ends_with_130(run_csv, tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", interrupted)
    assert main(["convert", str(run_csv), "-o", str(tmp_path / "out.csv")]) == 130
    assert capsys.readouterr().err.strip() == "imucal: interrupted, no file is incomplete"
    assert list(tmp_path.iterdir()) == [run_csv]


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_a_narrow_terminal_cuts_off_no_digits(tmp_path):
    import pty

    calibration = imucal.calibrate(imucal.simulate("random", seed=1, rate_hz=50).recording).calibration
    calibration.save(tmp_path / "unit.json")
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "imucal.cli", "diff", tmp_path / "unit.json", tmp_path / "unit.json"]
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "40"}
    with subprocess.Popen(command, stdout=slave, stderr=subprocess.DEVNULL, env=environment) as child:
        os.close(slave)
        shown = b""
        # A terminal whose other end is closed ends with an error.
        with contextlib.suppress(OSError):
            while piece := os.read(master, 65536):
                shown += piece
    os.close(master)
    assert child.returncode == 0
    assert "accel_sensitivity_xx" in shown.decode()
    assert "…" not in shown.decode()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pipes are POSIX")
def test_standard_output_may_be_named_as_a_file(run_csv, tmp_path):
    command = (
        f"{sys.executable} -m imucal.cli convert {run_csv} -o {tmp_path}/out.csv --json /dev/stdout | cat"
    )
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert '"samples"' in done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pipes are POSIX")
def test_reader_that_goes_away_is_no_traceback(run_csv, tmp_path):
    command = f"{sys.executable} -m imucal.cli convert {run_csv} -o {tmp_path}/out.csv --json - | true"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_full_standard_output_is_no_traceback(run_csv, tmp_path):
    with Path("/dev/full").open("w") as full:
        command = [
            sys.executable,
            "-m",
            "imucal.cli",
            "convert",
            run_csv,
            "-o",
            tmp_path / "out.csv",
            "--json",
            "-",
        ]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert (
        done.stderr.splitlines()[-1] == "imucal: standard output cannot be written: No space left on device"
    )
    assert "Traceback" not in done.stderr


class Panic(BaseException):
    """As the compiled library's: no Exception."""


@pytest.mark.parametrize(
    "bug", [ZeroDivisionError("float division by zero"), Panic("index\n9 of 3"), OSError("the port is gone")]
)
def test_a_bug_is_one_screen_and_says_how_to_see_more(bug, run_csv, tmp_path, monkeypatch, capsys):
    def broken(*_, **__):
        raise bug

    monkeypatch.setattr("imucal.io.write_pieces", broken)
    arguments = ["convert", str(run_csv), "-o", str(tmp_path / "out.csv")]
    assert main(arguments) == 1
    shown = capsys.readouterr().err
    assert f"imucal: this is a bug of imucal, not an error in your data: {type(bug).__name__}: " in shown
    assert " ".join(str(bug).split()) in shown
    assert "in broken, test_cli.py, line " in shown
    assert "IMUCAL_TRACEBACK=1" in shown
    assert len(shown.splitlines()) == 3
    monkeypatch.setenv("IMUCAL_TRACEBACK", "1")
    with pytest.raises(type(bug)):
        main(arguments)


def test_a_file_that_fails_is_not_called_standard_output(run_csv, tmp_path, monkeypatch, capsys):
    def broken(*_, **__):
        raise PermissionError(13, "Permission denied", "unit.json")

    monkeypatch.setattr("imucal.io.write_pieces", broken)
    assert main(["convert", str(run_csv), "-o", str(tmp_path / "out.csv")]) == 1
    assert capsys.readouterr().err == "imucal: unit.json: Permission denied\n"


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"imucal {imucal.__version__}\n"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("imucal ga", ["gap"]),
        (
            "imucal calibrate --effect gyro_bias_temperature_l",
            [f"gyro_bias_temperature_lag{form}" for form in ("", ":6", ":full")],
        ),
        ("imucal calibrate --effect encoder_", []),
        ("imucal gap --effect gyro_scale_c", ["gyro_scale_cubic"]),
        ("imucal gap --explain earth", ["earth_rate"]),
        ("imucal effects rest_", ["rest_not_still"]),
        ("imucal convert --format par", ["parquet"]),
        ("imucal simulate tu", ["tumble"]),
        ("imucal simulate random --unit bm", ["bmi088"]),
        ("imucal simulate random --effect gyro_scale_c", ["gyro_scale_cubic=typical"]),
        ("imucal limits ch", ["check"]),
    ],
)
def test_shell_completion(typed, offered, monkeypatch, capsys):
    monkeypatch.setenv("_IMUCAL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == 0
    # Each line has the kind of the value before a comma.
    assert [line.partition(",")[2] for line in capsys.readouterr().out.split()] == offered


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_stage_is_shown_on_a_terminal_when_it_takes_long(monkeypatch):
    import os
    import pty

    terminal, stderr = pty.openpty()
    shown = ""

    def wait_for(text):
        nonlocal shown
        while text not in shown:
            shown += os.read(terminal, 100_000).decode()

    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(stderr, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setattr("imucal.cli.working.DELAY_S", HANGS_S)
        with working("soon done"):
            pass
        monkeypatch.setattr("imucal.cli.working.DELAY_S", 0.0)
        with working("reading", 3) as stage:
            wait_for("reading")
            stage.step()
            wait_for("1/3")
            stage("judging")
            wait_for("judging")
            wait_for("left")
        monkeypatch.undo()
    assert "soon done" not in shown


@pytest.mark.slow
def test_nothing_is_shown_in_a_pipe(stand_runs, command, tmp_path):
    done = command("calibrate", stand_runs / "run.parquet", "-o", tmp_path / "cal.json")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "\x1b" not in done.stdout


@pytest.mark.slow
def test_verbose_says_each_decision(stand_runs, tmp_path, capsys):
    cal, output = tmp_path / "cal.json", tmp_path / "result.json"
    run, control = str(stand_runs / "run.parquet"), str(stand_runs / "control.parquet")
    assert main(["calibrate", run, "-o", str(cal), "--json", str(output), "-v"]) == 0
    shown = capsys.readouterr().out
    result = json.loads(output.read_text())
    threshold = result["fit"]["rest_thresholds"][0]
    assert f"below {threshold['factor']:.3g} times the noise variance" in shown
    assert f"joint fit: converged after {result['fit']['joint']['iterations']} iterations" in shown
    lines = shown.splitlines()
    assert sum(line.endswith(" used") for line in lines) == len(result["rests"]) + len(result["moves"])
    assert main(["evaluate", str(cal), control, "-v"]) == 0
    assert "45 to 46" not in (judged := capsys.readouterr().out) and "44 to 45" in judged
    assert main(["gap", run, "--control", control, "-v", "--effect", "gyro_scale_cubic"]) == 0
    assert "log Bayes factor" in capsys.readouterr().out
    still = imucal.simulate(imucal.Static(duration_s=60.0), unit="bmi088", rate_hz=100.0, seed=1)
    imucal.write(still.recording, tmp_path / "still.csv")
    assert main(["noise", str(tmp_path / "still.csv"), "-v"]) == 0
    assert "periods from s" in capsys.readouterr().out


@pytest.fixture(scope="module")
def stand_runs(tmp_path_factory):
    """A calibration and a control run of the paper's unit, a run of an ideal unit, each with its truth."""
    folder = tmp_path_factory.mktemp("runs")
    for name, seed, unit in (("run", "1", "paper"), ("control", "2", "paper"), ("other", "3", "ideal")):
        truth = ["--truth", str(folder / f"{name}.json")]
        options = ["--seed", seed, "--unit", unit, "--rate-hz", "100", *truth]
        assert main(["simulate", "random", "-o", str(folder / f"{name}.parquet"), *options]) == 0
    return folder


def test_calibrate_json_has_the_contracts_fields(stand_runs, tmp_path):
    options = ["--control", str(stand_runs / "control.parquet"), "--folds", "3", "--serial-number", "42"]
    written = ["-o", str(tmp_path / "cal.json"), "--json", str(tmp_path / "result.json")]
    assert main(["calibrate", str(stand_runs / "run.parquet"), *options, *written]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    truth = json.loads((stand_runs / "run.json").read_text())
    assert set(result["accelerometer"]) == {"T", "bias", "frame"}
    assert set(result["gyroscope"]) == {"T", "bias"}
    assert len(result["rests"]) == 46
    assert len(result["moves"]) == 45
    assert len(result["held_out"]["direction_error_deg"]) == 45
    for name in ("calibration_set", "control_set"):
        assert {"chi2_per_dof", "gravity_norm_rms_mps2", "gravity_direction_rms_deg"} <= set(result[name])
    for found, true in zip(result["parameters"], truth["parameters"], strict=True):
        assert (found["name"], found["unit"]) == (true["name"], true["unit"])
        assert abs(found["value"] - true["value"]) < 5 * found["std"]
    calibration = imucal.Calibration.load(tmp_path / "cal.json")
    assert calibration.accelerometer.sensitivity.tolist() == result["accelerometer"]["T"]
    assert calibration.serial_number == "42"
    assert calibration.provenance.imucal_version == imucal.__version__
    assert [source.path for source in calibration.provenance.files] == [str(stand_runs / "run.parquet")]


def test_a_calibration_of_another_unit_is_a_poor_verdict(stand_runs, tmp_path, capsys):
    cal, output = tmp_path / "cal.json", tmp_path / "judged.json"
    assert main(["calibrate", str(stand_runs / "run.parquet"), "-o", str(cal)]) == 0
    assert main(["evaluate", str(cal), str(stand_runs / "control.parquet")]) == 0
    assert "verdict: good" in capsys.readouterr().out
    assert main(["evaluate", str(cal), str(stand_runs / "other.parquet"), "--json", str(output)]) == 2
    assert "verdict: poor; control set: residuals are" in capsys.readouterr().out
    judged = json.loads(output.read_text())
    assert judged["control_set"]["after"]["chi2_per_dof"] > judged["control_set"]["before"]["chi2_per_dof"]


def test_applied_recording_reads_gravity_at_rest(stand_runs, tmp_path):
    cal, output = tmp_path / "cal.json", tmp_path / "corrected.csv"
    assert main(["calibrate", str(stand_runs / "run.parquet"), "-o", str(cal)]) == 0
    assert main(["apply", str(cal), str(stand_runs / "control.parquet"), "-o", str(output)]) == 0
    corrected = imucal.read(output).between(0.5, 4.5)
    # Five sigmas of a mean of 4 s at 126 ug/sqrt(Hz) and 0.025 deg/s/sqrt(Hz); the biases are 100 times it.
    assert corrected.specific_force.mean(axis=0) == pytest.approx([0, 0, 9.80665], abs=3.1e-3)
    assert corrected.angular_rate.mean(axis=0) == pytest.approx([0, 0, 0], abs=1.1e-3)


def test_refused_recording_names_the_fault(stand_runs, tmp_path, capsys):
    recording = imucal.read(stand_runs / "run.parquet")
    force = recording.specific_force.copy()
    force[100] = float("nan")
    imucal.write(imucal.Recording(recording.time_s, force, recording.angular_rate), tmp_path / "nan.csv")
    output = tmp_path / "cal.json"
    assert main(["calibrate", str(tmp_path / "nan.csv"), "-o", str(output)]) == 1
    assert "[non_finite]" in capsys.readouterr().err
    assert not output.exists()
    assert main(["inspect", str(tmp_path / "nan.csv")]) == 2
    assert "[non_finite]" in capsys.readouterr().out


@pytest.mark.slow
def test_effects_lists_all_and_shows_one(capsys):
    assert main(["effects"]) == 0
    listed = capsys.readouterr().out
    names = [row.name for row in (*imucal.effects.catalogue(), *disturbances())]
    assert all(f"\n{name} " in listed for name in names)
    for name in names:
        assert main(["effects", name]) == 0
        shown = capsys.readouterr().out
        assert shown.startswith(f"{name}: ") and ("observable in: " in shown or "appears as: " in shown)
    assert main(["effects", "gyro_bias_temperature"]) == 0
    shown = capsys.readouterr().out
    for text in (
        "k_i dT + q_i dT^2 + c_i dT^3, on the gyroscope",
        "x            0.000262 rad/s/K",
        "the plain form has the first 3",
        "depends on temperature: the column temp_degc, relative to 25 degC",
        "similar to gyro_bias_drift; distinguished by a run that heats and cools again",
        "--effect gyro_bias_temperature=typical --temperature cycle:10:40:320 -o run.csv",
        "imucal calibrate run.csv --effect gyro_bias_temperature\n",
        "with the first 6 parameters: imucal calibrate run.csv --effect gyro_bias_temperature:6\n",
        "imucal calibrate run.csv --effect gyro_bias_temperature:full\n",
    ):
        assert text in shown


def test_effects_as_json(capsys):
    assert main(["effects", "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in document["effects"]] == [row.name for row in imucal.effects.catalogue()]
    assert {row["kind"] for row in document["noise_and_faults"]} == {"noise", "fault"}
    assert main(["effects", "accel_bias_warmup", "--json", "-"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["shape"] == {"name": "tau", "unit": "s", "typical": 100.0}
    assert row["aliases"][0]["name"] == "accel_bias_temperature"


def test_apply_says_which_effects_it_took_away(tmp_path, capsys):
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    effects = (
        imucal.EffectValues("gyro_scale_cubic", [1.0, 0.0, 0.0]),
        imucal.EffectValues("earth_rate", [7e-5, 0.0, 0.0]),
    )
    imucal.Calibration(triad, triad, effects=effects).save(tmp_path / "cal.json")
    rate = np.zeros((10, 3))
    rate[4:6, 0] = 3.0
    imucal.write(imucal.Recording(np.arange(10) / 100, np.ones((10, 3)), rate), tmp_path / "run.csv")
    arguments = [
        "apply",
        str(tmp_path / "cal.json"),
        str(tmp_path / "run.csv"),
        "-o",
        str(tmp_path / "y.csv"),
    ]
    assert main([*arguments, "--json", str(tmp_path / "out.json")]) == 0
    shown = capsys.readouterr().out
    assert "effects compensated: gyro_scale_cubic\n" in shown
    assert "not compensated, as they are no sensor errors: earth_rate\n" in shown
    assert "2 samples are empty, first sample 4: the effects are too large" in shown
    said = json.loads((tmp_path / "out.json").read_text())
    assert (said["effects"], said["left_in_data"]) == (["gyro_scale_cubic"], ["earth_rate"])
    assert said["samples_lost"] == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("calibrate run.csv -o run.csv", "--output run.csv would overwrite a file"),
        ("calibrate run.csv --control control.csv --json ./control.csv", "--json ./control.csv would"),
        ("calibrate run.csv -o cal.json --json cal.json", "--output and --json are both cal.json"),
        ("calibrate run.csv --limits cal.json -o cal.json", "--output cal.json would"),
        ("gap run.csv --calibration cal.json -o link.json", "--output link.json would"),
        ("gap run.csv -o new.json --next new.json", "--output and --next are both new.json"),
        ("evaluate cal.json run.csv --json cal.json", "--json cal.json would"),
        ("evaluate cal.json run.csv --report run.csv", "--report run.csv would"),
        ("inspect run.csv --json run.csv", "--json run.csv would"),
        ("noise run.csv --kalibr run.csv", "--kalibr run.csv would"),
        ("plan cal.json -o cal.json", "--output cal.json would"),
        ("simulate static -o new.csv --truth new.csv", "--output and --truth are both new.csv"),
        ("simulate cal.json -o new.csv --truth cal.json", "--truth cal.json would"),
        ("apply cal.json run.csv -o run.csv", "--output run.csv would"),
        ("convert run.csv -o run.csv", "--output run.csv would"),
        ("export cal.json --to c-header -o cal.json", "--output cal.json would"),
        ("export cal.json --to c-header -o new.h --json cal.json", "--json cal.json would"),
        ("export cal.json --to c-header -o new.h --json new.h", "--output and --json are both new.h"),
        ("export cal.json --to px4 --control run.csv -o run.csv", "--output run.csv would"),
        ("export cal.json --to kalibr --noise run.csv -o run.csv", "--output run.csv would"),
        ("diff cal.json link.json --json cal.json", "--json cal.json would"),
        ("limits template cal.json -o cal.json", "--output cal.json would"),
        ("limits check control.csv cal.json --csv cal.json", "--csv cal.json would"),
        ("limits check cal.json run.csv --json cal.json", "--json cal.json would"),
        ("effects --markdown new.md --json new.md", "--markdown and --json are both new.md"),
        ("stand run cal.json -o new.csv --json cal.json", "--json cal.json would"),
        ("stand run random --packet run.csv -o run.csv --force", "--output run.csv would"),
        ("stand run random -o new.csv --json new.csv", "--output and --json are both new.csv"),
        ("stand run random -o new.csv --json new.csv.journal", "the journal and --json are both"),
        ("stand calibrate --limits cal.json --json cal.json -o new", "--json cal.json would"),
        ("stand calibrate --program cal.json --json cal.json -o new", "--json cal.json would"),
        ("stand calibrate --control-program cal.json --json cal.json -o new", "--json cal.json would"),
        ("stand calibrate --stand cal.json --json cal.json -o new", "--json cal.json would"),
        ("stand gcode cal.json -o cal.json", "--output cal.json would"),
        ("stand recover run.csv -o new.csv --json run.csv", "--json run.csv would"),
    ],
)
def test_what_is_read_is_not_overwritten(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("run.csv", "control.csv", "cal.json"):
        Path(name).write_text(name)
    Path("link.json").symlink_to("cal.json")
    assert main(arguments.split()) == 1
    assert words in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cal.json",
        "control.csv",
        "link.json",
        "run.csv",
    ]
    assert all(Path(name).read_text() == name for name in ("run.csv", "control.csv", "cal.json"))


@pytest.mark.parametrize(
    "arguments",
    [
        "apply cal.json run.csv -o PLACE",
        "calibrate run.csv -o PLACE",
        "calibrate run.csv --report PLACE",
        "convert run.csv -o PLACE",
        "diff cal.json cal.json --json PLACE",
        "effects --markdown PLACE",
        "evaluate cal.json run.csv --json PLACE",
        "export cal.json --to c-header -o PLACE",
        "gap run.csv -o PLACE",
        "gap run.csv --next PLACE",
        "inspect run.csv --json PLACE",
        "limits check run.csv cal.json --csv PLACE",
        "limits template cal.json -o PLACE",
        "noise run.csv --kalibr PLACE",
        "plan random -o PLACE",
        "simulate random -o PLACE",
        "stand calibrate -o units --json PLACE",
        "stand gcode random -o PLACE",
        "stand recover run.csv -o PLACE",
        "stand run random --json PLACE -o new.csv",
    ],
)
def test_a_place_that_is_none_is_said_before_the_work(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    # Reading them would be an error of its own.
    for name in ("run.csv", "cal.json"):
        Path(name).write_text(name)
    for place, words in (
        ("none/new.csv", "cannot be written: there is no folder none: create it first"),
        ("folder", "folder cannot be written: it is a folder"),
    ):
        assert main(arguments.replace("PLACE", place).split()) == 1
        assert words in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cal.json", "folder", "run.csv"]


def test_two_outputs_may_go_to_one_device(run_csv):
    assert main(["convert", str(run_csv), "-o", str(run_csv.with_name("y.csv")), "--json", os.devnull]) == 0
    assert main(["simulate", "static", "-o", str(run_csv), "--truth", os.devnull, "--json", os.devnull]) == 0


def test_the_list_of_commands_has_the_first_sentences_of_their_help():
    for name, summary in ((name, summary) for task in TASKS.values() for name, summary in task.items()):
        assert app.get_command(None, name).get_short_help_str(1000) == summary


@pytest.mark.parametrize(
    ("shell", "script", "started_by"),
    [
        ("bash", ".bash_completions/imucal.sh", ".bashrc"),
        ("zsh", ".zfunc/_imucal", ".zshrc"),
        ("fish", ".config/fish/completions/imucal.fish", None),
    ],
)
def test_completion_is_installed_once(shell, script, started_by, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SHELL", f"/bin/{shell}")
    monkeypatch.setattr("pathlib.Path.home", lambda: tmp_path)
    if started_by is not None:
        (tmp_path / started_by).write_text("alias ll='ls -l'")
    for _ in range(2):
        assert main(["--install-completion"]) == 0
    assert script in capsys.readouterr().out
    assert main(["--show-completion"]) == 0
    assert "_IMUCAL_COMPLETE" in (shown := capsys.readouterr().out)
    assert (tmp_path / script).read_text().strip() == shown.strip()
    if started_by is not None:
        first, *added = (tmp_path / started_by).read_text().splitlines()
        assert first == "alias ll='ls -l'"
        assert len(added) == 1


def test_completion_of_an_unknown_shell_is_refused(monkeypatch, capsys):
    monkeypatch.setenv("SHELL", "/bin/csh")
    assert main(["--install-completion"]) == 1
    assert "csh: it works in bash, zsh, fish" in capsys.readouterr().err
