"""The examples in the help of the commands run as they are printed."""

import inspect
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.cli.app import app
from imucal.io.vocabulary import column_names
from imucal.limits_template import limits_from
from imucal.stand.journal import Journal

EXAMPLE = re.compile(r"^Example: imucal (.*)$", re.MULTILINE)


def examples(application=app):
    """Every line `Example: imucal ...` of the commands and their groups."""
    for command in application.registered_commands:
        yield from EXAMPLE.findall(inspect.getdoc(command.callback))
    for group in application.registered_groups:
        callback = group.typer_instance.registered_callback
        if callback is not None:
            yield from EXAMPLE.findall(inspect.getdoc(callback.callback))
        yield from examples(group.typer_instance)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What the examples are given: recordings, calibrations, limits, and an imu_tk pair."""
    folder = tmp_path_factory.mktemp("examples")
    for name, seed in (("run", 1), ("control", 2)):
        imucal.write(imucal.simulate("random", seed=seed, rate_hz=100.0).recording, folder / f"{name}.csv")
    still = imucal.simulate(imucal.Static(duration_s=200.0), unit="bmi088", rate_hz=100.0, seed=3)
    imucal.write(still.recording, folder / "still.csv")
    run, control = (imucal.read(folder / f"{name}.csv") for name in ("run", "control"))
    for recording, judge, names in (
        (run, control, ("unit-0042", "unit-0042-may", "good-1")),
        (control, run, ("unit-0042-june", "good-2")),
    ):
        calibration = imucal.calibrate(recording, control=judge).calibration
        for name in names:
            calibration.save(folder / f"{name}.json")
    for name, columns in (("acc", run.specific_force), ("gyro", run.angular_rate)):
        rows = zip(run.time_s[:1000], columns[:1000], strict=True)
        text = "".join(f"{time_s} {x:.0f} {y:.0f} {z:.0f}\n" for time_s, (x, y, z) in rows)
        (folder / f"xsens_{name}.mat").write_text(text)
    limits_from([imucal.Calibration.load(folder / f"good-{n}.json") for n in (1, 2)], 4.0).save(
        folder / "limits.json"
    )
    with Journal(folder / "broken-off.csv.journal", [name for name, _ in column_names(run)], {}) as journal:
        journal.samples(np.column_stack([values for _, values in column_names(run)]), 0.0)
    return folder


def words(example):
    """The words as a shell would give them, with * filled in."""
    for word in shlex.split(example):
        yield from sorted(map(str, Path().glob(word))) if "*" in word else [word]


@pytest.mark.parametrize("example", list(examples()))
def test_example_runs_as_printed(example, files, tmp_path, monkeypatch, capsys):
    if "/dev/tty" in example:
        pytest.skip("it drives a stand")
    folder = tmp_path / "here"
    shutil.copytree(files, folder)
    monkeypatch.chdir(folder)
    code = main(list(words(example)))
    shown = capsys.readouterr()
    assert code == 0, f"{shown.out}{shown.err}"
