"""A short round of damaged files; `make fuzz` goes on with other random numbers."""

import json
import sys

import pytest

if sys.platform != "linux":
    pytest.skip("the cases are limited with means of Linux", allow_module_level=True)

from imucal.io import FORMATS
from mutations import mutated
from runner import CONTAINED, FAULT, READ, REFUSED, case, preload
from seeds import CORPUS, seeds

# Cases of each seed; together they take a few seconds.
CASES = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def written(folder):
    preload()
    return seeds(folder)


def test_every_format_has_a_seed(written):
    assert set(FORMATS) <= {seed.kind for seed in written}


def test_seeds_are_valid(written, folder):
    fresh = [seed for seed in written if seed.path.parent != CORPUS]
    outcomes = {seed.name: case(seed, folder, None) for seed in fresh}
    assert {name: outcome.reason for name, outcome in outcomes.items() if outcome.result != READ} == {}


def test_damage_is_read_or_refused(written, folder):
    counts = {READ: 0, REFUSED: 0, CONTAINED: 0}
    for number in range(CASES):
        for seed in written:
            outcome = case(seed, folder, number)
            assert outcome.result != FAULT, f"{seed.name} {number}: {outcome.reason}"
            counts[outcome.result] += 1
    # Damage that is never read, or never refused, would test nothing.
    assert counts[READ] > 20 and counts[REFUSED] > 40, counts


def test_files_that_once_crashed_are_refused(written, folder):
    for seed in written:
        if seed.path.parent == CORPUS:
            outcome = case(seed, folder, None)
            assert outcome.result in (READ, REFUSED, CONTAINED), f"{seed.name}: {outcome.reason}"


def test_the_same_number_gives_the_same_damage():
    content = json.dumps({"a": [1.0, 2.0], "b": {"c": None}}).encode()
    for kind in ({}, {"is_text": True}, {"is_json": True}):
        damaged = [mutated(content, "run 7", **kind) for _ in range(2)]
        assert damaged[0] == damaged[1] != content
