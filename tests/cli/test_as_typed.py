"""Messages of commands have the options as they are typed; those of the library have the arguments."""

import json

import pytest

import imucal
from imucal.cli import main
from imucal.cli.as_typed import as_typed


@pytest.mark.parametrize(
    ("library", "typed"),
    [
        (
            "hold each pose for 1 s, or pass min_rest_s=0.45",
            "hold each pose for 1 s, or pass --min-rest-s 0.45",
        ),
        ("pass axes='frd', which", "pass --axes frd, which"),
        ("pass axes='accel=-x,y,z gyro=x,y,z'", "pass --axes 'accel=-x,y,z gyro=x,y,z'"),
        (
            "(columns='-,accel_x_mps2,...') and pass rate_hz=100.5",
            "(--columns -,accel_x_mps2,...) and pass --rate-hz 100.5",
        ),
        ("pass exclude_saturated=True to", "pass --exclude-saturated to"),
        ("gravity_mps2 = 1: on Earth", "--gravity = 1: on Earth"),
        ("give rate_hz=RATE.", "give --rate-hz RATE."),
        # Not options: a value to choose, part of another word, and a column.
        ("(columns=..., --columns)", "(columns=..., --columns)"),
        ("limits.json: min_rest_s must be a number", "limits.json: min_rest_s must be a number"),
        ("my_axes=3", "my_axes=3"),
    ],
)
def test_options(library, typed):
    assert as_typed(library) == typed


def test_output_and_document_of_a_command(tmp_path, capsys):
    run = imucal.simulate(imucal.Program.random(seed=2, moves=18, hold_s=1.5), rate_hz=100, seed=2)
    imucal.write(run.recording.with_axes("gyro=-x,-y,-z"), tmp_path / "run.csv")
    seen = tmp_path / "seen.json"
    assert main(["calibrate", str(tmp_path / "run.csv"), "--json", str(seen)]) == 1
    assert "pass --axes gyro=-x,-y,-z" in capsys.readouterr().err
    with pytest.raises(imucal.InputError, match="pass axes='gyro=-x,-y,-z'"):
        imucal.calibrate(imucal.read(tmp_path / "run.csv"))
    assert any("pass --axes gyro=-x,-y,-z" in reason for reason in json.loads(seen.read_text())["reasons"])


def test_recommended_axes_replace_the_option_that_was_given(tmp_path, capsys):
    """Columns with z down; the gyroscope is mounted turned by 180 deg about z."""
    run = imucal.simulate(imucal.Program.random(seed=2, moves=18, hold_s=1.5), rate_hz=100, seed=2).recording
    imucal.write(run.with_axes("accel=x,-y,-z gyro=-x,y,-z"), tmp_path / "run.csv")
    command = ["calibrate", str(tmp_path / "run.csv"), "--axes"]
    assert main([*command, "frd"]) == 1
    advised = "accel=x,-y,-z gyro=-x,y,-z"
    assert f"--axes '{advised}'" in capsys.readouterr().err
    assert main([*command, advised]) == 0
    # Columns that were right are advised to be read without a change.
    imucal.write(run, tmp_path / "run.csv")
    assert main([*command, "gyro=-x,-y,-z"]) == 1
    assert "--axes x,y,z" in capsys.readouterr().err
