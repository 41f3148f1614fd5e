"""Calls of a benchmark on the processes of `imucal.fleet`, here or on a Dask cluster.

Each answer is kept in target/benches/NAME.sqlite as soon as it is there, so a killed benchmark goes on when
it is started again. The key of an answer contains a hash of all code, so changed code computes everything
again. `publish` keeps the answers behind a page.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import pickle
import sqlite3
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

import imucal
import imucal._core as _core
from answers import KeptAnswer, commit, plain, publish
from imucal.fleet.cluster import DaskPool
from imucal.fleet.local import Ended, LocalPool, Pool

__all__ = ["Engine", "add_arguments", "engine_of", "own_runs", "own_seeds"]

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "target" / "benches"
# Attempts of calls whose process ends without an answer, as when it is killed.
TRIES = 3
# Distance between the first seeds of two conditions.
SEEDS_BETWEEN = 10_000


@dataclass(frozen=True)
class Calls:
    """A function, pickled, and the arguments of its calls; the function may be one of the main program."""

    function: bytes
    arguments: tuple[Any, ...]
    keys: tuple[str, ...]
    tries: int = TRIES

    def run(self) -> list[bytes] | str:
        """The pickled answers, or the traceback of an exception."""
        try:
            function = pickle.loads(self.function)
            return [cloudpickle.dumps(function(argument)) for argument in self.arguments]
        except Exception:
            return traceback.format_exc()

    def is_stuck(self, answer: Any) -> bool:
        """Calls have no time limit."""
        return False


class Engine:
    """Runs calls and keeps their answers; use it in a `with` block."""

    def __init__(self, make_pool: Callable[[], Pool], log: Path | None) -> None:
        self._rows: list[KeptAnswer] = []
        self._commit = commit()
        self._make_pool, self._pool, self._name = make_pool, None, log.stem if log else ""
        self._code = _code_hash()
        self._waiting: deque[Calls] = deque()
        self._in_pool = 0
        self._found: dict[str, bytes] = {}
        self._log = None
        if log is not None:
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log = sqlite3.connect(log)
            self._log.execute("CREATE TABLE IF NOT EXISTS answers (key TEXT PRIMARY KEY, answer BLOB)")

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.close()
        if self._log is not None:
            self._log.close()

    def map(
        self, function: Callable[[Any], Any], arguments: Iterable[Any], *, name: str, per_task: int = 8
    ) -> Iterator[Any]:
        """The answers in the order of the arguments; all calls are begun at once.

        name      of these calls, with what the function holds besides its argument, such as that of a scene
        per_task  calls that a process does at a time; an exception of one of them ends the benchmark
        """
        given = list(arguments)
        keys = [f"{self._code} {name} {argument!r}" for argument in given]
        self._look_up(keys)
        payload = cloudpickle.dumps(function)
        new = [pair for pair in zip(keys, given, strict=True) if pair[0] not in self._found]
        for first in range(0, len(new), per_task):
            of_task = new[first : first + per_task]
            self._waiting.append(Calls(payload, tuple(v for _, v in of_task), tuple(k for k, _ in of_task)))
        self._fill()
        return (self._kept(name, argument, key) for argument, key in zip(given, keys, strict=True))

    def call(self, function: Callable[[], Any], *, name: str) -> Callable[[], Any]:
        """Begin one call; the returned function waits for its answer."""
        answers = self.map(_Alone(function), [name], name="call")
        return lambda: next(answers)

    def publish(self, page: Path) -> None:
        """Keep all answers that `map` gave, and say so on the page that shows them."""
        publish(page, self._name, self._rows, self._commit)

    def _kept(self, name: str, argument: Any, key: str) -> Any:
        answer = self._answer(key)
        self._rows.append(KeptAnswer(name, plain(argument), plain(answer)))
        return answer

    def _answer(self, key: str) -> Any:
        while key not in self._found:
            self._take()
            self._fill()
        return pickle.loads(self._found.pop(key))

    def _fill(self) -> None:
        while self._waiting:
            if self._pool is None:
                self._pool = self._make_pool()
            if self._in_pool >= self._pool.capacity:
                return
            self._pool.submit(self._waiting.popleft())
            self._in_pool += 1

    def _take(self) -> None:
        calls, answer = self._pool.next()
        self._in_pool -= 1
        if isinstance(answer, str):
            raise SystemExit(f"{calls.keys[0].partition(' ')[2]} and following:\n{answer}")
        if isinstance(answer, Ended):
            if calls.tries <= 1:
                raise SystemExit(f"{calls.keys}: the process ends {answer.how} without an answer")
            self._waiting.appendleft(Calls(calls.function, calls.arguments, calls.keys, calls.tries - 1))
            return
        answers = dict(zip(calls.keys, answer, strict=True))
        self._found |= answers
        if self._log is not None:
            with self._log:
                self._log.executemany("INSERT OR IGNORE INTO answers VALUES (?, ?)", answers.items())

    def _look_up(self, keys: list[str]) -> None:
        for key in keys if self._log is not None else ():
            row = self._log.execute("SELECT answer FROM answers WHERE key = ?", [key]).fetchone()
            if row is not None:
                self._found[key] = row[0]


@dataclass(frozen=True)
class _Alone:
    """A function without an argument as one with an argument, which names the call."""

    function: Callable[[], Any]

    def __call__(self, name: str) -> Any:
        return self.function()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `engine_of`."""
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--scheduler", help="address of a Dask scheduler, whose workers have this folder in PYTHONPATH"
    )
    parser.add_argument("--fresh", action="store_true", help="forget the answers of earlier runs")


def own_runs(text: str) -> int:
    """A number of runs from the command line, for conditions with seeds of their own."""
    runs = int(text)
    if runs > SEEDS_BETWEEN:
        raise argparse.ArgumentTypeError(
            f"{runs}: at most {SEEDS_BETWEEN}, or seeds of two conditions are the same"
        )
    return runs


def own_seeds(place: int, runs: int) -> range:
    """Seeds of the condition at this place (from 1), so that the errors of conditions are independent."""
    return range(SEEDS_BETWEEN * place, SEEDS_BETWEEN * place + runs)


def engine_of(given: argparse.Namespace, name: str) -> Engine:
    """The engine of a benchmark with this name."""
    log = FOLDER / f"{name}.sqlite"
    if given.fresh:
        log.unlink(missing_ok=True)

    def make_pool() -> Pool:
        if given.scheduler:
            return DaskPool(given.scheduler)
        # Bound to a processor each, because threads of one process would compete with the other processes.
        return LocalPool(given.processes, bound=True)

    return Engine(make_pool, log)


def _code_hash() -> str:
    """Of the compiled library, and sources and JSON files of package, benches and the tests they use."""
    digest = hashlib.sha256(Path(_core.__file__).read_bytes())
    package, benches, tests = Path(os.fspath(imucal.__file__)).parent, ROOT / "benches", ROOT / "tests"
    for folder in (package, benches, tests / "fixtures", tests / "traps"):
        for path in sorted((*folder.rglob("*.py"), *folder.rglob("*.json"))):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
