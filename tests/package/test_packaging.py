"""The installed package: what it holds, what it says of itself, and what it leaves alone."""

import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import imucal

ROOT = Path(__file__).resolve().parents[2]
FILES = {str(path) for path in metadata.files("imucal-rs") or []}


def test_tests_run_against_the_installed_package():
    assert ROOT / "python" not in Path(imucal.__file__).parents


def test_package_is_typed_licensed_and_complete():
    assert {"imucal/py.typed", "imucal/_core.pyi"} <= FILES
    assert {Path(name).name for name in FILES} >= {"LICENSE-MIT", "LICENSE-APACHE"}
    installed = {name.removeprefix("imucal/") for name in FILES if name.startswith("imucal/")}
    package = ROOT / "python" / "imucal"
    sources = {
        str(path.relative_to(package))
        for path in package.rglob("*")
        if path.suffix in {".py", ".pyi", ".json"}
    }
    assert sources - installed == set()


def test_wheel_serves_every_python_from_3_10_on():
    wheel = metadata.distribution("imucal-rs").read_text("WHEEL")
    assert re.search(r"^Tag: cp310-abi3-", wheel, re.MULTILINE)
    assert metadata.metadata("imucal-rs")["Requires-Python"] == ">=3.10"


def test_versions_agree():
    manifest = (ROOT / "Cargo.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"$', manifest, re.MULTILINE)[1]
    assert metadata.version("imucal-rs") == imucal.__version__ == version


def test_plots_and_their_like_are_imported_only_when_used():
    program = (
        "import sys, imucal, imucal.cli; "
        "print([name for name in ('plotly', 'scipy', 'pandas', 'matplotlib') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_command_is_installed():
    command = Path(sys.executable).with_name("imucal")
    done = subprocess.run([command, "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    for name in ("demo", "convert", "inspect", "calibrate", "evaluate", "apply", "simulate"):
        assert name in done.stdout


@pytest.mark.slow
def test_every_benchmark_can_be_imported():
    """Those that `make test` does not run, too: they take minutes, and what they import may have moved."""
    modules = sorted(path.stem for path in (ROOT / "benches").glob("*.py"))
    assert len(modules) > 8
    code = "; ".join(f"import {module}" for module in modules)
    # As in the Makefile: one of them asks the rows of the table of traps.
    paths = os.pathsep.join(str(ROOT / folder) for folder in ("benches", "tests/traps", "tests/fixtures"))
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
