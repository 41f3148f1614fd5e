"""The tests of one deliberate error: near ones first, and the first that fails ends them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mutants.sites import SWITCH

__all__ = ["ALL", "NEAR_PYTHON", "NEAR_RUST", "Answer", "python_answer", "rust_answer", "stop"]

ROOT = Path(__file__).resolve().parents[2]
# Largest time of one run of tests, s; an error that takes longer, as by a loop without end, is found.
LONGEST_S = 1200.0
# All tests that are not slow, after those of the folders.
ALL: Final = ""
# Exit code of pytest if no test is selected.
NO_TESTS = 5
# Folders of tests of each folder of the package, near ones first.
NEAR_PYTHON = {
    "calibration": ("calibration", "estimation", "cli", "export", "importing"),
    "cli": ("cli", "docs/test_codes.py", "cases", "document", "advice"),
    "document": ("document", "calibration", "stand", "cli"),
    "effects": ("effects", "export", "gap"),
    "estimation": ("estimation", "advice", "cases", "cli"),
    "exporting": ("export", "importing", "effects"),
    "fleet": ("fleet",),
    "gap": ("gap", "advice"),
    "importing": ("importing", "export"),
    "limits": ("limits", "fleet", "stand"),
    "noise_analysis": ("noise", "cli"),
    "planning": ("planning", "stand"),
    "recording": ("recording", "io", "estimation"),
}
# Folders of Python tests of each module of the crate `imucal`, and of `imucal-core`.
NEAR_RUST = {
    "gap": ("gap",),
    "noise": ("noise",),
    "plan": ("planning",),
    "number_columns": ("io",),
    "check": ("advice", "estimation", "cases"),
    "imucal-core": ("effects", "export", "estimation"),
}
NEAR_FIT = ("estimation", "calibration", "advice")


# Running tests, and whether they are to end.
RUNNING: Final[set[subprocess.Popen]] = set()
STOPPED: Final = threading.Event()


class Stopped(Exception):
    """The tests have no answer, because the program ends."""


def stop() -> None:
    """End all running tests, and begin no others."""
    STOPPED.set()
    for child in list(RUNNING):
        _kill(child)


@dataclass(frozen=True)
class Answer:
    """The test that found an error, or None, and the time that it took, s."""

    test: str | None
    seconds: float


def rust_answer(programs: Sequence[Path], number: int, path: str) -> Answer:
    """Unit tests: first those of the module of `path`, then all others."""
    start_s = time.monotonic()
    parts = Path(path).parts
    module = parts[3].removesuffix(".rs")
    for program in programs:
        for selection in ([f"{module}::"], ["--skip", f"{module}::"]):
            command = [str(program), "--test-threads", "1", *selection]
            found = _failing(command, number, {}, lambda line: line.endswith(" ... FAILED"))
            if found:
                return Answer(found, time.monotonic() - start_s)
    return Answer(None, time.monotonic() - start_s)


def python_answer(package: Path, number: int, folders: Sequence[str], tests: Path) -> Answer:
    """Python tests of `folders` on the copy of the package, fast ones first."""
    start_s = time.monotonic()
    environment = {"PYTHONPATH": str(package.parent)}
    for folder in folders:
        for marks in ("not slow", "slow") if folder != ALL else ("not slow",):
            command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", marks]
            command.append(str(tests / folder))
            found = _failing(command, number, environment, lambda line: line.startswith(("FAILED", "ERROR")))
            if found:
                return Answer(found, time.monotonic() - start_s)
    return Answer(None, time.monotonic() - start_s)


def _failing(
    command: list[str], number: int, environment: dict[str, str], is_failure: Callable[[str], bool]
) -> str | None:
    """The first line of the output that names a failing test, or how else the tests fail."""
    if STOPPED.is_set():
        raise Stopped
    variables = {**os.environ, **environment, SWITCH: str(number)}
    child = subprocess.Popen(
        command,
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        cwd=ROOT,
        start_new_session=True,
    )
    RUNNING.add(child)
    is_late = threading.Event()

    def end_late() -> None:
        is_late.set()
        _kill(child)

    timer = threading.Timer(LONGEST_S, end_late)
    timer.start()
    try:
        for line in child.stdout or ():
            if is_failure(line.rstrip()):
                return line.strip()
        code = child.wait()
    finally:
        timer.cancel()
        _kill(child)
        RUNNING.discard(child)
    if STOPPED.is_set():
        raise Stopped
    if is_late.is_set():
        return f"no end within {LONGEST_S:.0f} s"
    if code == -signal.SIGKILL:
        raise RuntimeError(f"{' '.join(command)} was killed, perhaps for lack of memory")
    return None if code in (0, NO_TESTS) else f"exit code {code}"


def _kill(child: subprocess.Popen) -> None:
    """End a program and those that it started."""
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()
