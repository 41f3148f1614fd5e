"""`imucal apply` on recordings whose units or time stamps look wrong: it warns, and still corrects them."""

import json

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.io import read_pieces
from imucal.io.table import ROWS_AT_ONCE

G = 9.80665


@pytest.fixture(scope="module")
def run():
    """A simulated run on a stand at 100 Hz."""
    program = imucal.Program.random(seed=1, moves=6, hold_s=1.5)
    return imucal.simulate(program, unit="paper", rate_hz=100, seed=1).recording


def applied(folder, recording, ending=".csv"):
    """The warnings of `imucal apply`, which writes all samples."""
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    imucal.Calibration(triad, triad).save(folder / "unit.json")
    imucal.write(recording, folder / f"run{ending}")
    paths = [str(folder / name) for name in ("unit.json", f"run{ending}")]
    output, document = str(folder / f"out{ending}"), str(folder / "out.json")
    assert main(["apply", *paths, "-o", output, "--json", document]) == 0
    assert len(imucal.read(output)) == len(recording)
    return json.loads((folder / "out.json").read_text())["warnings"]


def of(recording, *, time_s=None, force=1.0, rate=1.0):
    return imucal.Recording(
        recording.time_s if time_s is None else time_s,
        recording.specific_force * force,
        recording.angular_rate * rate,
    )


def test_units_and_time_stamps_that_look_wrong_are_warnings(run, tmp_path, capsys):
    assert applied(tmp_path, run) == []
    capsys.readouterr()
    half = len(run) // 2
    back_s = np.concatenate([run.time_s[:half], run.time_s[:-half]])
    for wrong, code, advice in (
        (of(run, force=1 / G), "accel_units", "name the columns accel_x_g"),
        (of(run, rate=180 / np.pi * 3), "gyro_units", "name the columns gyro_x_dps"),
        (of(run, time_s=back_s), "time_not_increasing", f"(sample {half})"),
        (of(run, time_s=run.time_s / 1000), "clock_rate", "1000 times too short"),
    ):
        (warning,) = applied(tmp_path, wrong)
        assert f"[{code}]" in warning and advice in warning
        assert f"warning: {warning}" in capsys.readouterr().out


def test_time_that_goes_back_between_two_pieces_of_a_file_is_reported(run, tmp_path):
    """Every piece by itself is in order."""
    repeats = -(-2 * ROWS_AT_ONCE // len(run))
    rows = np.tile(np.arange(len(run)), repeats)[: 2 * ROWS_AT_ONCE]
    time_s = np.tile(np.arange(ROWS_AT_ONCE) / 100, 2)
    long = imucal.Recording(time_s, run.specific_force[rows], run.angular_rate[rows])
    (warning,) = applied(tmp_path, long, ".parquet")
    pieces = list(read_pieces(tmp_path / "run.parquet"))
    assert len(pieces) > 1 and all((np.diff(piece.time_s) > 0).all() for piece in pieces)
    assert f"run.parquet, from sample {len(pieces[0]) - 1}: time goes back once" in warning
    assert "[time_not_increasing]" in warning
