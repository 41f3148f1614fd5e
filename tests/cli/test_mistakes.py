"""The ten most likely mistakes of a newcomer: one screen each, which names the mistake and the next step."""

import functools
import sys

import numpy as np
import pytest

import imucal
from imucal.cli import main

ROWS, COLUMNS = 24, 100
STILL = np.array([0.3, -0.2, 9.8])


@functools.cache
def run(seed=1, unit="paper"):
    program = imucal.Program.random(seed=seed, moves=30, hold_s=2.0)
    return imucal.simulate(program, unit=unit, rate_hz=100.0, seed=seed).recording


def changed(force=lambda f: f, rate=lambda w: w, until_s=None):
    """Our run as somebody recorded it."""
    part = run().between(0.0, until_s)
    return imucal.Recording(part.time_s, force(part.specific_force), rate(part.angular_rate))


def turning():
    """Half a minute in the hand without a pause."""
    time_s = np.arange(3000) / 100
    rate = np.stack([np.sin(time_s), np.cos(0.7 * time_s), 0.5 + 0 * time_s], axis=1)
    force = np.stack([np.sin(time_s), np.cos(time_s), 0.3 * np.sin(0.3 * time_s)], axis=1)
    force *= 9.8 / np.linalg.norm(force, axis=1)[:, None]
    noise = np.random.default_rng(1).normal(size=(2, 3000, 3)) * [[[1e-3]], [[1e-2]]]
    return imucal.Recording(time_s, force + noise[1], rate + noise[0])


def on_one_face():
    noise = np.random.default_rng(1).normal(size=(2, 3000, 3)) * [[[1e-3]], [[1e-2]]]
    return imucal.Recording(np.arange(3000) / 100, STILL + noise[1], noise[0])


RECORDINGS = {
    "in_g": lambda: changed(force=lambda f: f / 9.80665),
    "in_dps": lambda: changed(rate=np.degrees),
    "turning": turning,
    "one_face": on_one_face,
    "swapped": lambda: changed(rate=lambda w: w[:, [1, 0, 2]]),
    "clipped": lambda: changed(rate=lambda w: np.clip(w, -1, 1)),
    "short": lambda: changed(until_s=6.0),
    "downwards": lambda: changed(force=np.negative),
    "run": run,
    "control": lambda: run(2),
    "others": lambda: run(3, "random:bmi088:4"),
}
CALIBRATE = "calibrate {}.csv -o new.json"
# Command, exit code, the mistake, the next step.
MISTAKES = {
    "wrong unit of the accelerometer": (
        CALIBRATE.format("in_g"),
        1,
        "looks like g",
        "name the columns accel_x_g",
    ),
    "wrong unit of the gyroscope": (
        CALIBRATE.format("in_dps"),
        1,
        "looks like deg/s",
        "name the columns gyro_x_dps",
    ),
    "no rest": (CALIBRATE.format("turning"), 1, "no rest of 1 s or more", "hold the unit still in each pose"),
    "one face": (
        CALIBRATE.format("one_face"),
        1,
        "1 rest does not determine",
        "add rests with x up and with x down",
    ),
    "wrong columns": (
        CALIBRATE.format("swapped"),
        1,
        "axes are left-handed",
        "are exchanged: pass --axes gyro=",
    ),
    "names that say no unit": (
        CALIBRATE.format("nameless"),
        1,
        "the header does not give every unit: t, ax, ay, az",
        "--columns",
    ),
    "clipped": (CALIBRATE.format("clipped"), 1, "[gyro_saturation]", "exclude"),
    "too short": (
        CALIBRATE.format("short"),
        1,
        "2 rests do not determine",
        "at least 5 between different poses",
    ),
    "mixed-up files": ("evaluate run.csv unit.json", 1, "run.csv is not JSON", "give a JSON file here"),
    "control run of another unit": (
        "calibrate run.csv --control others.csv",
        2,
        "control set: residuals are",
        "the calibration is another unit's",
    ),
    "the same run as control": (
        "calibrate run.csv --control run.csv",
        1,
        "has all 12200 samples of run.csv",
        "give another recording",
    ),
    "wrong sign of gravity": (CALIBRATE.format("downwards"), 0, "reads -1.00 g", "--axes frd"),
    "other unit's calibration": (
        "evaluate unit.json others.csv",
        2,
        "verdict: poor",
        "the calibration is another unit's",
    ),
    "missing extra": (
        "calibrate run.csv --control control.csv --report page.html",
        1,
        "plotly, which is not installed",
        'pip install "imucal-rs[report]"',
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mistakes")
    for name, make in RECORDINGS.items():
        imucal.write(make(), folder / f"{name}.csv")
    (folder / "nameless.csv").write_text("t,ax,ay,az,gx,gy,gz\n" + "0.01,0,0,9.8,0,0,0\n" * 9)
    imucal.calibrate(run()).calibration.save(folder / "unit.json")
    return folder


@pytest.mark.parametrize("mistake", MISTAKES)
def test_one_screen_names_the_mistake_and_the_next_step(mistake, folder, monkeypatch, capsys):
    arguments, code, named, next_step = MISTAKES[mistake]
    monkeypatch.chdir(folder)
    if mistake == "missing extra":
        monkeypatch.setitem(sys.modules, "plotly", None)
    assert main(arguments.split()) == code
    shown = capsys.readouterr()
    # The table of parameters of a fit that came to its end stands above what is wrong with it.
    screen = shown.err or shown.out[shown.out.index("rests") :]
    assert sum(1 + len(line) // COLUMNS for line in screen.splitlines()) <= ROWS, screen
    assert "Traceback" not in screen
    assert named in screen
    assert next_step in screen
