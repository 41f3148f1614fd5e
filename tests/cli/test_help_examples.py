"""The examples in the help of the commands run as they are printed.

The application object gives the help of all commands; `limits_from` and `Journal` write files that the
examples read.
"""

import contextlib
import io
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.cli.app import app
from imucal.fleet.measurements import Measurements
from imucal.io.vocabulary import column_names
from imucal.limits.template import limits_from
from imucal.stand.journal import Journal
from stored_fleet import stored

MANIFEST = "serial,date,station,files,control\n0042,2026-11-02,north,run.csv,control.csv\n"
# It goes on where a line ends with a backslash.
EXAMPLE = re.compile(r"^ *Example: (imucal (?:.*\\\n)*.*)$", re.MULTILINE)


def helped(command=app, words=()):
    """The words of every command, and of every group."""
    yield words
    if hasattr(command, "list_commands"):
        for name in command.list_commands(None):
            yield from helped(command.get_command(None, name), (*words, name))


def help_of(words):
    """The help of a command on a terminal of 80 columns."""
    shown = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(shown):
        patch.setenv("COLUMNS", "80")
        assert main([*words, "--help"]) == 0
    return shown.getvalue()


def examples():
    """Every example as the help shows it, each once."""
    return list(dict.fromkeys(found for words in helped() for found in EXAMPLE.findall(help_of(words))))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What the examples are given: recordings, calibrations, limits, an imu_tk pair, and a Kalibr file."""
    folder = tmp_path_factory.mktemp("examples")
    for name, seed in (("run", 1), ("control", 2)):
        imucal.write(imucal.simulate("random", seed=seed, rate_hz=100.0).recording, folder / f"{name}.csv")
    still = imucal.simulate(imucal.Static(duration_s=200.0), unit="bmi088", rate_hz=100.0, seed=3)
    imucal.write(still.recording, folder / "still.csv")
    sweep = imucal.simulate(
        imucal.Static(duration_s=600.0), rate_hz=10.0, seed=4, temperature="cycle:10:50:300"
    )
    imucal.write(sweep.recording, folder / "sweep.csv")
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
    limits_from([imucal.Calibration.load(folder / f"good-{n}.json") for n in (1, 2)], deviations=4.0).save(
        folder / "limits.json"
    )
    after = imucal.calibrate(imucal.Calibration.load(folder / "unit-0042.json").apply_recording(control))
    after.calibration.save(folder / "second.json")
    (folder / "manifest.csv").write_text(MANIFEST)
    fleet_store(folder)
    (folder / "imu.yaml").write_text("imu0: {model: calibrated, accelerometer_noise_density: 0.002}\n")
    with Journal(folder / "broken-off.csv.journal", [name for name, _ in column_names(run)], {}) as journal:
        journal.samples(np.column_stack([values for _, values in column_names(run)]), 0.0)
    return folder


def fleet_store(folder):
    """A store of fifty units: of one station on two dates, and of a gauge study."""
    limits = imucal.Limits.load(folder / "limits.json").parameters
    units, repeats = 50, 6
    unit = np.concatenate([np.tile(np.arange(units), 2), np.repeat(np.arange(5), repeats)])
    random = np.random.default_rng(1)
    centres, halves = (
        np.array([[(limit.low + limit.high) / 2 for limit in limits]]),
        np.array([[(limit.high - limit.low) / 2 for limit in limits]]),
    )
    true = centres + halves / 12 * random.normal(size=(units, len(limits)))
    sigmas = np.repeat(halves / 200, len(unit), axis=0)
    days = np.concatenate([np.arange(2 * units), np.full(5 * repeats, 90)])
    is_study = days == 90
    measurements = Measurements(
        np.array([f"{42 + k:04}" for k in unit]),
        np.datetime64("2026-11-01T08:00:00") + (days * 3600 * 6).astype("timedelta64[s]"),
        np.where(is_study, "", "north"),
        np.where(is_study, np.array(["ann", "bob"])[np.arange(len(unit)) % 2], ""),
        np.full(len(unit), "2026-11"),
        np.where(is_study, "grr", "production"),
        np.full(len(unit), "good"),
        tuple(limit.name for limit in limits),
        tuple(limit.unit for limit in limits),
        true[unit] + sigmas * random.normal(size=sigmas.shape),
        sigmas,
    )
    stored(folder / "units.sqlite", measurements, files=[folder / "run.csv"] * len(unit))


def words(example):
    """The words that a shell makes of it, with * filled in."""
    shell = ["sh", "-c", f"set -- {example}\nprintf '%s\\0' \"$@\""]
    done = subprocess.run(shell, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split("\0")[:-1]


@pytest.mark.slow
def test_examples_are_as_wide_as_the_help():
    broken = [example for example in examples() if "\\\n" in example]
    assert broken
    for example in broken:
        first, *others = example.split("\n")
        assert max(len(f"  Example: {first}"), *map(len, others)) <= 80


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there is no sh")
@pytest.mark.parametrize("example", examples())
def test_example_runs_as_printed(example, files, tmp_path, monkeypatch, capsys):
    if "/dev/tty" in example or "stand resume" in example:
        pytest.skip("it drives a stand")
    if example.startswith("imucal capture"):
        pytest.skip("it needs a person with a unit")
    if "--watch" in example:
        pytest.skip("it runs until it is stopped")
    folder = tmp_path / "here"
    shutil.copytree(files, folder)
    monkeypatch.chdir(folder)
    name, *given = words(example)
    assert name == "imucal"
    code = main(given)
    shown = capsys.readouterr()
    assert code == 0, f"{shown.out}{shown.err}"
