"""The tests of one deliberate error: those that reach it, cheap ones first, until one fails."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from imucal.fleet.local import ONE_THREAD
from mutants.sites import MOST, REACHED, REACHED_IN, SWITCH

__all__ = ["Answer", "PythonTest", "Trial", "python_run", "reached_by", "runs_of"]

ROOT = Path(__file__).resolve().parents[2]
# Largest time of the Python tests of one error, s, by the time that they take without an error.
LONGEST_S = 120.0
# Times after which a run of tests ends and the next begins, s: a run takes seconds to start.
RUNS_S = (4.0, 30.0, LONGEST_S)
# Exit codes of pytest if a test is not there, or none is.
NOT_FOUND = (4, 5)
PR_SET_PDEATHSIG = 1
# A run of tests hangs if it takes this time and ten times its own, s.
HANGS_S = 120.0


@dataclass(frozen=True)
class PythonTest:
    """A test that has ended: its name, its time, s, the errors that it reached, and whether it failed."""

    test: str
    seconds: float
    reached: Sequence[int]
    failed: bool


@dataclass(frozen=True)
class Answer:
    """The test that found an error, or None, and the time that the tests took, s."""

    test: str | None
    seconds: float


@dataclass(frozen=True)
class Trial:
    """Looks for a test that finds an error.

    package   the copy of the package
    folder    for files of the runs
    programs  tests in Rust, and the errors that each program reaches
    runs      names and time of the Python tests of each run, by error
    modules   the module of each error in Rust, whose tests are the first
    """

    package: Path
    folder: Path
    programs: Mapping[Path, frozenset[int]]
    runs: Mapping[int, Sequence[tuple[Sequence[str], float]]]
    modules: Mapping[int, str]

    def __call__(self, number: int) -> Answer:
        start_s = time.monotonic()
        found = self._rust_test(number) or self._python_test(number)
        return Answer(found, time.monotonic() - start_s)

    def _rust_test(self, number: int) -> str | None:
        for program, reached in self.programs.items():
            if number in reached:
                module = f"{self.modules[number]}::"
                for selection in ([module], ["--skip", module]):
                    command = [str(program), "--test-threads", "1", *selection]
                    output = self.folder / f"{number}.txt"
                    code = _exit_code(command, {SWITCH: str(number)}, output, 10 * HANGS_S)
                    if code != 0:
                        lines = output.read_text(errors="replace").splitlines()
                        failed = [line for line in lines if line.endswith(" ... FAILED")]
                        return failed[0] if failed else _ending(code)
        return None

    def _python_test(self, number: int) -> str | None:
        for tests, seconds in self.runs[number]:
            longest_s = HANGS_S + 10 * seconds
            code, done = self._run(number, ["-x", *tests], longest_s)
            if code in NOT_FOUND:
                # The error changes the names of tests.
                files = sorted({test.partition("::")[0] for test in tests})
                code, done = self._run(number, ["-x", *files], longest_s)
            failed = next((each.test for each in done if each.failed), None)
            if failed is not None and self._run(0, [failed], longest_s)[0] == 0:
                return failed
            if failed is None and code != 0 and self._run(0, tests, longest_s)[0] == 0:
                # The tests cannot be imported, pytest itself ends, or a test hangs.
                return _ending(code)
        return None

    def _run(
        self, number: int, arguments: Sequence[str], longest_s: float
    ) -> tuple[int | None, list[PythonTest]]:
        name = str(number) if number else f"without-{os.getpid()}"
        return python_run(self.package, self.folder / name, number, arguments, longest_s)


def python_run(
    package: Path, folder: Path, number: int, arguments: Sequence[str], longest_s: float
) -> tuple[int | None, list[PythonTest]]:
    """The exit code of pytest with an error, None if it hangs, and the tests that have ended."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "arguments.txt").write_text("\n".join(arguments))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "mutants.reached"]
    command.append(f"@{folder / 'arguments.txt'}")
    paths = os.pathsep.join([str(package.parent), str(ROOT / "benches")])
    variables = {"PYTHONPATH": paths, REACHED_IN: str(folder), SWITCH: str(number)}
    code = _exit_code(command, variables, folder / "output.txt", longest_s)
    lines = [line for path in folder.glob("*.jsonl") for line in path.read_text().splitlines()]
    return code, [PythonTest(**json.loads(line)) for line in lines]


def reached_by(program: Path, folder: Path) -> frozenset[int]:
    """The errors that the tests of a program in Rust reach."""
    reached = folder / f"{program.name}.bytes"
    reached.write_bytes(bytes(MOST))
    output = folder / f"{program.name}.txt"
    if _exit_code([str(program)], {REACHED: str(reached)}, output, 3600.0) != 0:
        raise SystemExit(f"{program} fails without an error: {output}")
    return frozenset(number for number, byte in enumerate(reached.read_bytes()) if byte)


def runs_of(number: int, tests: Sequence[PythonTest]) -> list[tuple[list[str], float]]:
    """Names and time of the tests of each run: those that reach the error, then others of the same files."""
    own = {each.test: number in each.reached for each in tests}
    files = {each.test.partition("::")[0] for each in tests if number in each.reached}
    near = [each for each in tests if each.test.partition("::")[0] in files]
    near.sort(key=lambda each: (not own[each.test], each.seconds))
    runs: list[tuple[list[str], float]] = [([], 0.0) for _ in RUNS_S]
    total_s = 0.0
    for each in near:
        total_s += each.seconds
        at = next((k for k, end_s in enumerate(RUNS_S) if total_s <= end_s), None)
        if at is None:
            break
        runs[at] = ([*runs[at][0], each.test], runs[at][1] + each.seconds)
    return [run for run in runs if run[0]]


def _exit_code(
    command: Sequence[str], variables: Mapping[str, str], output: Path, longest_s: float
) -> int | None:
    """The exit code of a program, or None after `longest_s`; what it started ends with it."""
    with output.open("w") as file:
        child = subprocess.Popen(
            command,
            # As without an error: all processors, and libraries choose their threads.
            env={name: value for name, value in os.environ.items() if name not in ONE_THREAD}
            | dict(variables),
            preexec_fn=_free,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
            start_new_session=True,
        )
    try:
        code = child.wait(longest_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    if code == -signal.SIGKILL:
        raise RuntimeError(f"{command} was killed, perhaps for lack of memory")
    return code


def _free() -> None:
    """In a new process: let it use all processors, and end it with its parent."""
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def _ending(code: int | None) -> str:
    return "no end" if code is None else f"exit code {code}"
