"""The frame of the commands: what is shown first, help, words that people try, groups of options, colours."""

import io
import re

import pytest

from imucal.calibration.parameter_text import parameter_row
from imucal.calibration.triad import Parameter
from imucal.cli import main
from imucal.cli.app import OTHER_WORDS, TASKS, app
from imucal.cli.output import Output
from imucal.units import datasheet, si


def test_the_command_alone_says_what_to_do_first(capsys):
    assert main([]) == 1
    shown = capsys.readouterr().err
    first, last = shown.index("imucal demo"), shown.index("imucal help calibrate")
    assert first < shown.index("imucal calibrate run.csv") < shown.index("imucal export") < last


def test_help_is_that_of_the_option(capsys):
    for words in ([], ["calibrate"], ["fleet", "run"]):
        assert main(["help", *words]) == 0
        by_command = capsys.readouterr().out
        assert main([*words, "--help"]) == 0
        assert capsys.readouterr().out == by_command


def test_help_of_an_unknown_command_is_an_error(capsys):
    assert main(["help", "fleet", "fly"]) == 1
    assert "imucal fleet has no command 'fly'" in capsys.readouterr().err


@pytest.mark.parametrize("word", OTHER_WORDS)
def test_a_word_that_people_try_names_the_command(word, capsys):
    assert main([word, "x.csv"]) == 1
    [offered] = re.findall(r"use `imucal (.+)`", capsys.readouterr().err)
    group = app
    for name in offered.split(" --")[0].split():
        group = group.get_command(None, name)
    assert group is not None


def test_batch_is_fleet_run(capsys):
    main(["batch"])
    assert "use `imucal fleet run`" in capsys.readouterr().err


def test_commands_are_grouped_by_task(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert [line[:-1] for line in shown.splitlines() if line[:-1] in TASKS] == list(TASKS)


def test_options_are_grouped_and_those_of_many_commands_are_last(capsys):
    assert main(["calibrate", "--help"]) == 0
    shown = capsys.readouterr().out
    headings = re.findall(r"^(\w.+):$", shown, re.MULTILINE)
    assert headings[:2] == ["Arguments", "Options"]
    assert headings[-2:] == ["Output", "Files of other programs"]
    gravity = shown[shown.index("Gravity and clock:") : shown.index("Model and start values:")]
    assert "--latitude" in gravity
    assert "--effect" not in gravity


def test_the_help_is_as_wide_as_the_terminal_within_limits(capsys, monkeypatch):
    for columns, widest in ((60, 60), (100, 100), (300, 110)):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert main(["calibrate", "--help"]) == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if "Example" not in line]
        assert widest - 15 < max(map(len, lines)) <= max(widest, 76)


def test_metavars_are_in_capitals(capsys):
    for command in ("calibrate", "plan", "simulate", "noise", "fleet run"):
        assert main([*command.split(), "--help"]) == 0
        shown = re.findall(r"^  (?:-\w, )?--[\w-]+ (\S+)", capsys.readouterr().out, re.MULTILINE)
        assert shown
        assert [word for word in shown if "[" not in word and word in ("FLOAT", "INTEGER")] == []


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "no_color", "coloured"),
    [(Terminal, "", True), (Terminal, "1", False), (io.StringIO, "", False)],
)
def test_verdicts_are_coloured_in_a_terminal_only(stream, no_color, coloured, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", no_color)
    written = stream()
    monkeypatch.setattr("sys.stdout", written)
    Output(None).verdict("good", [])
    assert written.getvalue() == ("verdict: \x1b[1;32mgood\x1b[0m\n" if coloured else "verdict: good\n")


@pytest.mark.parametrize(
    ("parameter", "shown"),
    [
        (("accel_bias_x", -0.4189456, 1.24e-4, "m/s^2"), ("accel_bias_x", "-42.721", "0.013", "mg")),
        (("gyro_bias_x", -0.03500514, 1.98e-5, "rad/s"), ("gyro_bias_x", "-2.0056", "0.0011", "deg/s")),
        (
            ("accel_sensitivity_xx", 0.980372, 1.62e-5, "1"),
            ("accel_sensitivity_xx - 1", "-19628", "16", "ppm"),
        ),
        (
            ("gyro_sensitivity_xy", 0.0096848, 7.76e-5, "1"),
            ("gyro_sensitivity_xy", "9.685", "0.078", "mrad"),
        ),
        (
            ("accel_sensitivity_xx", 414.4379, 0.0346, "lsb/(m/s^2)"),
            ("accel_sensitivity_xx", "4064.25", "0.34", "lsb/g"),
        ),
        (("accel_bias_x", 33123.91, 0.312, "lsb"), ("accel_bias_x", "33123.91", "0.31", "lsb")),
        (("gyro_bias_x", 0.0349066, None, "rad/s"), ("gyro_bias_x", "2.000001", "-", "deg/s")),
        (("accel_bias_x", 1.0, 0.0, "m/s^2"), ("accel_bias_x", "101.9716", "0.0e+00", "mg")),
    ],
)
def test_parameters_are_shown_in_datasheet_units(parameter, shown):
    assert parameter_row(Parameter(*parameter), datasheet) == shown


def test_parameters_are_shown_in_si_units():
    parameter = Parameter("accel_sensitivity_xx", 0.980372, 1.62e-5, "1")
    assert parameter_row(parameter, si) == ("accel_sensitivity_xx", "0.980372", "0.000016", "1")
