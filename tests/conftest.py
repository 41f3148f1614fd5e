"""What several tests share: the real recordings, the installed command, a recording made from truth."""

import os
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import imucal

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_file():
    """Path of a real recording; skips without the folder, fails if the file alone is missing."""

    def find(name):
        if not DATA.is_dir():
            pytest.skip(f"the real recordings are not here: no folder {DATA}")
        path = DATA / name
        if not path.is_file():
            pytest.fail(f"{DATA} has no {name}")
        return path

    return find


@pytest.fixture(scope="session")
def command():
    """Run the installed `imucal`; returns the finished process with its output as text."""
    program = Path(sysconfig.get_path("scripts")) / ("imucal.exe" if os.name == "nt" else "imucal")
    assert program.is_file(), f"{program} is missing: install the package"

    def run(*arguments):
        return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=120)

    return run


@pytest.fixture(scope="session")
def measured():
    """Make the recording that a unit (a calibration) gives of a true motion: T true + bias + white noise.

    sigma   standard deviation of one sample, (rad/s, m/s^2)
    """

    def make(unit, time_s, rate, force, *, sigma=(0.0, 0.0), seed=0, name="made"):
        random = np.random.default_rng(seed)
        triads = (unit.gyroscope, unit.accelerometer)
        gyro, accel = (
            true @ triad.sensitivity.T + triad.bias + random.normal(scale=std, size=true.shape)
            for true, triad, std in zip((rate, force), triads, sigma, strict=True)
        )
        return imucal.Recording(time_s, accel, gyro, name=name)

    return make
