"""Tests against deliberate errors: `make mutants`.

A sample of operators and constants of the sources is changed, one at a time, and the tests should fail. The
Python tests run with each error in Python. The unit tests run with each error in Rust, and then, if they
pass, Python tests of the same subject. The page docs/results/mutants.md lists the errors that these tests do
not find. Each answer is kept in target/benches as soon as it is there, so a killed run goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from rich.progress import track

from mutants.page import Trial, write_language
from mutants.python_copy import PythonCopy, installed_copy
from mutants.rust_copy import RustCopy
from mutants.trial import ALL, NEAR_FIT, NEAR_PYTHON, NEAR_RUST, Answer, python_answer, rust_answer, stop

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "target" / "mutants"
TESTS = ROOT / "tests"


def main() -> None:
    parser = argparse.ArgumentParser(description="Tests against deliberate errors in the sources.")
    parser.add_argument("--language", choices=("python", "rust"), help="only errors in one language")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=120, help="errors of each language")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for language, run in {"python": in_python, "rust": in_rust}.items():
        if given.language in (None, language):
            trials = run(given.seed, given.count, given.processes)
            write_language(language, given.seed, trials)


def in_python(seed: int, count: int, processes: int) -> list[Trial]:
    """The answers to errors in Python."""
    copy = PythonCopy(FOLDER / "python")
    copy.write(seed, count)

    def answer(number: int) -> Answer:
        area = Path(copy.sites[number].path).parts[1]
        return python_answer(copy.package, number, [*NEAR_PYTHON[area], ALL], TESTS)

    areas = {Path(site.path).parts[1] for site in copy.sites.values()}
    folders = sorted({folder for area in areas for folder in NEAR_PYTHON[area]})
    without = [
        lambda folder=folder: python_answer(copy.package, 0, [folder], TESTS) for folder in [*folders, ALL]
    ]
    return _trials("python", copy, answer, without, processes)


def in_rust(seed: int, count: int, processes: int) -> list[Trial]:
    """The answers to errors in Rust."""
    copy = RustCopy(ROOT, FOLDER / "rust")
    copy.compile(seed, count)
    programs = copy.test_programs()
    package = installed_copy(FOLDER / "extension")
    shutil.copy(copy.extension(), next(package.glob("_core*.so")))

    def folders(path: str) -> Sequence[str]:
        parts = Path(path).parts
        return NEAR_RUST.get(parts[1] if parts[1] in NEAR_RUST else Path(parts[3]).stem, NEAR_FIT)

    def answer(number: int) -> Answer:
        path = copy.sites[number].path
        found = rust_answer(programs, number, path)
        if found.test is not None:
            return found
        near = python_answer(package, number, folders(path), TESTS)
        return Answer(near.test, found.seconds + near.seconds)

    names = sorted({folder for site in copy.sites.values() for folder in folders(site.path)})
    without = [lambda: rust_answer(programs, 0, "rust/imucal/src/gap.rs")]
    without += [lambda name=name: python_answer(package, 0, [name], TESTS) for name in names]
    return _trials("rust", copy, answer, without, processes)


def _trials(
    language: str,
    copy: PythonCopy | RustCopy,
    answer: Callable[[int], Answer],
    without: Sequence[Callable[[], Answer]],
    processes: int,
) -> list[Trial]:
    """Answers of all errors of a copy, after the same tests passed without an error."""
    log = ROOT / "target" / "benches" / f"mutants-{language}-{_hash(copy)}.jsonl"
    log.parent.mkdir(parents=True, exist_ok=True)
    known = {}
    for line in log.read_text().splitlines() if log.exists() else ():
        entry = json.loads(line)
        known[entry["number"]] = Answer(entry["test"], entry["seconds"])

    def kept(number: int) -> Answer:
        if number not in known:
            found = answer(number) if number > 0 else without[-number]()
            if number <= 0 and found.test is not None:
                raise SystemExit(f"without an error: {found.test}")
            with log.open("a") as file:
                file.write(json.dumps({"number": number, **asdict(found)}) + "\n")
            known[number] = found
        return known[number]

    with ThreadPoolExecutor(processes) as pool, stopped_at_the_end():
        clean = [-n for n in range(len(without))]
        for _ in track(pool.map(kept, clean), f"{language}, without an error", len(clean)):
            pass
        numbers = sorted(copy.sites)
        answers = track(pool.map(kept, numbers), f"{language}, errors", len(numbers))
        return [
            Trial(copy.sites[n], found.test, found.seconds) for n, found in zip(numbers, answers, strict=True)
        ]


@contextmanager
def stopped_at_the_end() -> Iterator[None]:
    """End the tests that still run if the program is interrupted or fails."""
    try:
        yield
    except BaseException:
        stop()
        raise


def _hash(copy: PythonCopy | RustCopy) -> str:
    """Of the errors, the sources around them, and the tests."""
    digest = hashlib.sha256(repr(sorted(copy.sites.items())).encode())
    for folder in ("python", "rust", "tests", "docs", "benches/mutants"):
        for path in sorted((ROOT / folder).rglob("*")):
            # Tests write sources into folders `target`.
            if path.suffix in (".py", ".rs", ".md") and "target" not in path.parts[len(ROOT.parts) :]:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    main()
