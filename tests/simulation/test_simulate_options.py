"""Options of `imucal simulate` that cannot be: one line, with the way out, and no file."""

import re

import pytest

import imucal
from imucal.cli import main
from imucal.document.json_document import write_json


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--effect gyro_bias", "'gyro_bias' has no name and numbers: give NAME=VALUE"),
        ("--effect gyro_g_sensitivty=1", "no effect 'gyro_g_sensitivty': is it gyro_g_sensitivity"),
        ("--effect gyro_g_sensitivity=1,2", "gyro_g_sensitivity has 9 parameters: 2 were given"),
        ("--effect gyro_g_sensitivity=1@5", "gyro_g_sensitivity has no shape: 5.0 was given"),
        ("--effect gyro_bias_warmup=1@-5", "shape of gyro_bias_warmup is -5.0: a positive number"),
        ("--effect gyro_bias_drift=a", "could not convert string to float: 'a': give NAME=VALUE"),
        ("--effect gyro_bias_drift=nan", "gyro_bias_drift contain nan: finite numbers are needed"),
        (
            "--effect samples_missing=0.1,0.2",
            "samples_missing has 1 numbers and no shape: 2 numbers were given",
        ),
        ("--effect gyro_bias_drift=1 --effect gyro_bias_drift=2", "gyro_bias_drift is given twice"),
        ("--effect samples_missing=2", "missing_share is 2"),
        ("--effect gyro_saturation=-1", "the range of a sensor is -1.0: a positive number"),
        ("--temperature warm", "the temperature 'warm' is not understood: give DEGC, warmup:"),
        ("--temperature warmup:1:2", "the temperature 'warmup:1:2' is not understood"),
        ("--temperature warmup:1:2:0", "time constant of the warm-up is 0.0 s"),
        ("--temperature=-300", "not a possible temperature: give degC"),
        ("--temperature bad.csv", "bad.csv: 'temp_degc': a CSV file with the columns time_s,temp_degc"),
        ("--temperature back.csv", "back.csv: time_s of the temperature must increase"),
        ("--latitude 91", "latitude_deg is 91.0: from -90"),
        ("--height 100", "height_m without latitude_deg"),
        ("--gravity 0", "gravity_mps2 is 0"),
        ("--stand none.json", "none.json: there is no such file"),
        ("--stand stand.json", r"\$.mount_deg is no field of a stand"),
        ("--filter datasheet", "datasheet of the accelerometer of paper gives no bandwidth"),
        ("--filter wide", "filter_hz is 'wide': give a bandwidth in Hz, or datasheet"),
        ("--filter=-1", "bandwidth of -1"),
        ("--poses 3", "poses is an option of tumble: leave it out, or give that motion"),
        ("--moves -1", "moves is -1: a whole number"),
        ("--clock-error -2", "clock_rate_error is -2"),
    ],
)
def test_a_bad_option_is_one_line_with_the_way_out(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("time_s,temp_c\n0,1\n")
    (tmp_path / "back.csv").write_text("time_s,temp_degc\n1,1\n0,1\n")
    (tmp_path / "stand.json").write_text('{"schema": "imucal.stand/1", "mount_deg": [1, 2, 3]}')
    assert main(["simulate", "random", "-o", "run.csv", *arguments.split()]) == 1
    shown = capsys.readouterr()
    assert re.search(message, shown.err), shown.err
    assert shown.err.count("\n") == 1
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("tumble --stand cheap", "a stand needs a program"),
        ("static --effect rest_not_still=0.001", "give another motion than static"),
        ("static --effect mount_slip=0.001", "mount_slip needs a stand"),
        ("tumble --poses 0", "poses is 0: a whole number"),
        ("static --duration-s -1", "rests for -1 s: give a positive time"),
        ("static --moves 3", "moves is an option of random: leave it out"),
        ("static --unit random:bmi99:3", "the unit 'bmi99' is not known: give one of .*bmi088"),
        ("truth.json --unit ideal", "--unit .* the truth file already states this setting"),
        ("truth.json --hold-s 1", "--hold-s .* the truth file already states this setting"),
    ],
)
def test_options_that_do_not_fit_the_motion(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = imucal.simulate(imucal.Static(duration_s=1.0), unit="ideal", seed=1)
    write_json(run.truth.to_dict(), tmp_path / "truth.json")
    assert main(["simulate", *arguments.split(), "-o", "run.csv"]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "run.csv").exists()
