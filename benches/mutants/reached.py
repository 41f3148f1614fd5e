"""A plugin of pytest: which deliberate errors each test reaches, how long it takes, and whether it fails.

Each error sets a byte of a file when its place in the sources is reached, also in programs that a test
starts, because the environment names the file. Each process of pytest has such a file, and a file of lines in
JSON, one for each test.
"""

from __future__ import annotations

import json
import mmap
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from mutants.sites import MOST, REACHED, REACHED_IN

PLACE: Final = Path(os.environ[REACHED_IN])
BYTES: Final = PLACE / f"{os.getpid()}.bytes"
BYTES.write_bytes(bytes(MOST))
# Before any test imports the package.
os.environ[REACHED] = str(BYTES)
with BYTES.open("r+b") as file:
    MAP: Final = mmap.mmap(file.fileno(), 0)
TESTS: Final = str(Path(__file__).resolve().parents[2] / "tests")
# Errors that a fixture reaches, which its later tests do not reach again.
OF_FIXTURES: Final[dict[Any, set[int]]] = {}
FAILED: Final[set[str]] = set()


def taken() -> set[int]:
    """The errors that were reached since the last call."""
    found = {number for number, byte in enumerate(MAP[:]) if byte}
    MAP[:] = bytes(MOST)
    return found


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[Any]) -> None:
    """Tests run in the order in which they are given."""
    order = {name: place for place, name in enumerate(config.args)}
    items.sort(key=lambda item: order.get(item.nodeid, len(order)))


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[None]:
    before = taken()
    try:
        return (yield)
    finally:
        OF_FIXTURES[fixturedef] = taken()
        for number in before | OF_FIXTURES[fixturedef]:
            MAP[number] = 1


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any, nextitem: Any) -> Iterator[None]:
    taken()
    start_s = time.perf_counter()
    try:
        return (yield)
    finally:
        seconds = time.perf_counter() - start_s
        fixtures = [each for same in item._fixtureinfo.name2fixturedefs.values() for each in same]
        reached = taken().union(*(OF_FIXTURES.get(each, set()) for each in fixtures))
        failed = item.nodeid in FAILED
        entry = {"test": item.nodeid, "seconds": seconds, "reached": sorted(reached), "failed": failed}
        with (PLACE / f"{os.getpid()}.jsonl").open("a") as file:
            file.write(json.dumps(entry) + "\n")
        if nextitem is None or nextitem.path != item.path:
            forget()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        FAILED.add(report.nodeid)


def forget() -> None:
    """Forget what functions of the tests keep (`functools.cache`), because each file of tests needs it."""
    for module in list(sys.modules.values()):
        if str(getattr(module, "__file__", None) or "").startswith(TESTS):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()
