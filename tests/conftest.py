"""Fixtures of several tests: real recordings, the installed command, a recording made from a true motion."""

import shlex
import shutil
import subprocess
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import imucal
from children import HANGS_S
from prepared_python import prepared

# Folder beside the clone with real recordings (`data`) and small files of known faults (`cases`).
SHARED = Path(__file__).resolve().parents[2] / "shared"


def group_of(item):
    """The group that a test is marked with, or its file if it uses a fixture of its module, or None."""
    marked = item.get_closest_marker("xdist_group")
    if marked is not None:
        return marked.args[0]
    fixtures = [fixture for (*_, fixture) in item._fixtureinfo.name2fixturedefs.values()]
    # Fixtures of the whole session cost little, so each process makes its own.
    return item.nodeid.partition("::")[0] if any(each.scope == "module" for each in fixtures) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests of a group run in one process, all others in any (`--dist loadgroup`); slow tests begin."""
    groups = {item: group_of(item) for item in items}
    slow = {group or item for item, group in groups.items() if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (groups[item] or item) not in slow)
    for item, group in groups.items():
        if group is not None and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(group))


def shared_file(folder, name):
    """Path of a shared file or folder; skips without `folder`, fails if the file alone is missing."""
    if not (SHARED / folder).is_dir():
        pytest.skip(f"the shared files are not here: no folder {SHARED / folder}")
    path = SHARED / folder / name
    if not path.exists():
        pytest.fail(f"{SHARED / folder} has no {name}")
    return path


@pytest.fixture(scope="session")
def data_file():
    """Path of a real recording."""
    return partial(shared_file, "data")


@pytest.fixture(scope="session")
def case_file():
    """Path of a file on which a fault of the program was found."""
    return partial(shared_file, "cases")


@pytest.fixture(scope="session")
def programs(tmp_path_factory):
    """The folder of the programs `imucal` and `python`, which start fast."""
    with prepared(tmp_path_factory.mktemp("programs")) as folder:
        yield folder


@pytest.fixture(scope="session")
def command(programs):
    """Run the installed `imucal`; returns the finished process with its output as text."""

    def run(*arguments):
        words = [shutil.which("imucal", path=programs), *map(str, arguments)]
        return subprocess.run(words, capture_output=True, text=True, timeout=HANGS_S)

    return run


@pytest.fixture(scope="session")
def known():
    """The data that tests of readers write: a unit at rest, 8 s at 50 Hz, exact in float32."""
    random, rows = np.random.default_rng(11), 400
    force = np.array([0.5, -0.25, 9.75]) + random.normal(scale=0.02, size=(rows, 3))
    rate = np.array([0.01, -0.02, 0.03]) + random.normal(scale=0.002, size=(rows, 3))
    return SimpleNamespace(
        time_ns=1_700_000_000_123_456_000
        + np.arange(rows) * 20_000_000
        + random.integers(0, 1000, rows) * 1000,
        accel=force.astype(np.float32).astype(np.float64),
        gyro=rate.astype(np.float32).astype(np.float64),
        temperature=(25 + 0.001 * np.arange(rows)).astype(np.float32).astype(np.float64),
    )


@pytest.fixture
def example_of(command, tmp_path, monkeypatch):
    """Run the example of a format, on the file in `tmp_path` that it names; returns what it wrote."""

    def run(format):
        from imucal.io import FORMATS

        monkeypatch.chdir(tmp_path)
        given = shlex.split(FORMATS[format].example)
        done = command("convert", *given, "--format", format, "-o", "rec.csv")
        assert done.returncode == 0, done.stderr
        recording = imucal.read("rec.csv")
        done = command("inspect", *given)
        # A unit at rest does not determine a calibration, so the verdict is poor.
        assert done.returncode in (0, 2), done.stdout + done.stderr
        assert f"{len(recording)} samples" in done.stdout
        return recording

    return run


@pytest.fixture(scope="session")
def measured():
    """Make the recording of a true motion by a unit with a given calibration: T true + bias + white noise.

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
