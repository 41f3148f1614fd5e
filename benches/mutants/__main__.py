"""Tests against deliberate errors: `make mutants`.

A sample of operators and constants of the sources is changed, one at a time, and a test should fail. All
tests run once without an error, which shows the errors that each of them reaches. Then the tests that reach
an error run with it, cheap ones first: for an error in Rust those in Rust before those in Python. The page
docs/results/mutants.md lists the errors that no test finds. A killed run goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
from dataclasses import asdict
from pathlib import Path

from engine import Engine, add_arguments, engine_of
from mutants.page import write_language
from mutants.python_copy import PythonCopy, installed_copy
from mutants.rust_copy import RustCopy
from mutants.trial import PythonTest, Trial, python_run, reached_by, runs_of

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "target" / "mutants"


def main() -> None:
    parser = argparse.ArgumentParser(description="Tests against deliberate errors in the sources.")
    parser.add_argument("--language", choices=("python", "rust"), help="only errors in one language")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=120, help="errors of each language")
    add_arguments(parser)
    given = parser.parse_args()
    with engine_of(given, "mutants") as engine:
        for language, copied in {"python": python_copy, "rust": rust_copy}.items():
            if given.language in (None, language):
                judge(engine, language, given, *copied(given.seed, given.count))


def python_copy(seed: int, count: int) -> tuple[PythonCopy, list[Path]]:
    """A copy of the package with errors in Python; no programs in Rust run with them."""
    copy = PythonCopy(FOLDER / "python")
    copy.write(seed, count)
    return copy, []


def rust_copy(seed: int, count: int) -> tuple[RustCopy, list[Path]]:
    """A copy of the package with errors in Rust, and the programs of the tests in Rust."""
    copy = RustCopy(ROOT, FOLDER / "rust", installed_copy(FOLDER / "extension"))
    copy.compile(seed, count)
    shutil.copy(copy.extension(), next(copy.package.glob("_core*.so")))
    return copy, copy.test_programs()


def judge(
    engine: Engine,
    language: str,
    given: argparse.Namespace,
    copy: PythonCopy | RustCopy,
    programs: list[Path],
) -> None:
    """Look for a test of each error, and write the section of the language."""
    state, folder = _hash(copy), FOLDER / "runs" / language
    tests = _tests(copy.package, folder / state, given.processes)
    sound = [each for each in tests if not each.failed]
    (folder / "programs").mkdir(exist_ok=True)
    trial = Trial(
        copy.package,
        folder,
        {each: reached_by(each, folder / "programs") for each in programs},
        {number: runs_of(number, sound) for number in copy.sites},
        {number: Path(site.path).with_suffix("").parts[3] for number, site in copy.sites.items()}
        if programs
        else {},
    )
    numbers = sorted(copy.sites)
    answers = engine.map(trial, numbers, name=f"{language} {state}", per_task=1)
    found = []
    for number, answer in zip(numbers, answers, strict=True):
        print(f"{len(found) + 1} of {len(numbers)}: {answer.test or 'not found'}", flush=True)
        found.append((copy.sites[number], answer))
    write_language(language, given.seed, found, [each.test for each in tests if each.failed])


def _tests(package: Path, folder: Path, processes: int) -> list[PythonTest]:
    """All Python tests without an error, which run once and are kept in the folder."""
    kept = folder / "tests.json"
    if not kept.exists():
        print("all Python tests without an error, which takes as long as `make test`", flush=True)
        arguments = ["--numprocesses", str(processes), "--dist", "loadfile", str(ROOT / "tests")]
        code, tests = python_run(package, folder, 0, arguments, 7200.0)
        output = (folder / "output.txt").read_text(errors="replace")
        if code not in (0, 1) or "crashed while running" in output:
            raise SystemExit(f"the tests without an error end with {code}:\n{output[-2000:]}")
        kept.write_text(json.dumps([asdict(each) for each in tests]))
    return [PythonTest(**each) for each in json.loads(kept.read_text())]


def _hash(copy: PythonCopy | RustCopy) -> str:
    """Of the errors, the sources around them, and the tests."""
    digest = hashlib.sha256(repr(sorted(copy.sites.items())).encode())
    for folder in ("python", "rust", "tests", "docs", "benches/mutants"):
        for path in sorted((ROOT / folder).rglob("*")):
            # Tests write sources into folders `target`, and this program writes a page of results.
            is_output = {"target", "results"}.intersection(path.parts[len(ROOT.parts) :])
            if path.suffix in (".py", ".rs", ".md") and not is_output:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    main()
