"""Pages of results are those of this code: some of the answers behind each page are computed again.

The calls are drawn with a seed of their own. The test of a page whose numbers the code no longer gives names
the command that makes it again.
"""

import importlib
import random

import numpy as np
import pytest

import gap.__main__ as gap_benchmark
from answers import DATA, KeptAnswer, differs, plain, publish, read
from sections import write_section

ROWS_PER_PAGE = 2
# One case of these takes seconds.
SEARCHES = ("gap", "laws", "thermal", "units")
# The program of each file of answers.
MODULES = {
    "accuracy": "accuracy.__main__",
    "copies": "copies",
    "faces": "faces",
    "gap": "gap.__main__",
    "laws": "gap.laws",
    "noise-accuracy": "noise_accuracy",
    "noise-steps": "noise_steps",
    "one-sensor": "one_sensor",
    "plan": "plan.__main__",
    "rounding": "rounding",
    "six-positions": "six_positions",
    "stand": "stand_line",
    "thermal": "gap.thermal",
    "traps": "traps",
    "units": "gap.units",
}
KEPT = sorted(path.name.partition(".")[0] for path in DATA.glob("*.jsonl.xz"))


def test_each_file_of_answers_has_a_program():
    assert KEPT and set(KEPT) <= set(MODULES)


@pytest.mark.slow
@pytest.mark.parametrize("name", KEPT)
def test_the_answers_of_a_page_are_those_of_this_code(name):
    origin, rows = read(name)
    functions = importlib.import_module(MODULES[name]).calls()
    known = [row for row in rows if row.name in functions]
    for row in random.Random(f"{name} {len(known)}").sample(known, 1 if name in SEARCHES else ROWS_PER_PAGE):
        found = differs(row.answer, plain(functions[row.name](row.argument)))
        assert found is None, f"{row.name}, {row.argument}: {found}; make the page again: {origin['command']}"


@pytest.mark.slow
def test_the_page_of_the_gap_is_what_its_answers_give(tmp_path):
    gap_benchmark.write_again(tmp_path / "gap.md")
    assert (tmp_path / "gap.md").read_text() == gap_benchmark.REPORT.read_text()


def test_a_page_says_where_its_answers_are(tmp_path, monkeypatch):
    monkeypatch.setattr("answers.DATA", tmp_path / "data")
    page = tmp_path / "page.md"
    page.write_text("# Page\n\nText.\n")
    answer = {"angle": np.array([1.0, 2.0 / 3.0]), "name": "x", "none": None, "nan": float("nan")}
    publish(page, "first", [KeptAnswer("a", 1, plain(answer))], "abc")
    publish(page, "second", [KeptAnswer("b", [1, True], plain((1, 2.5)))], "def")
    write_section(page, "Page", "Last", "* [no answers](elsewhere)")
    publish(page, "first", [KeptAnswer("a", 2, plain(answer))], "abc with changes")
    origin, rows = read("first")
    assert list(rows) == [
        KeptAnswer("a", 2, {"angle": [1.0, 0.666667], "name": "x", "none": None, "nan": "nan"})
    ]
    text = page.read_text()
    assert text.startswith("# Page\n\nText.\n\n## Origin\n\n* [first](data/first.jsonl.xz): 1 answers.")
    assert text.count("[first]") == 1 and "* [second](data/second.jsonl.xz)" in text
    assert origin["commit"] == "abc with changes" and "at commit abc with changes, " in text
    assert origin["machine"] in text and text.count("elsewhere") == 1


def test_what_differs_is_found():
    kept = plain({"std": np.array([1.0, 2.0, 1e-9]), "verdict": "good", "seconds": 3.0, "count": 7})
    now = plain({"std": np.array([1.0, 2.0001, 2e-9]), "verdict": "good", "seconds": 9.0, "count": 7})
    assert differs(kept, now) is None
    assert differs(kept, kept | {"std": [1.0, 2.1, 1e-9]}) == "std: 2.0, not 2.1"
    assert differs(kept, kept | {"verdict": "poor"}) == "verdict: 'good', not 'poor'"
    assert differs(kept, kept | {"count": 8}) == "count: 7, not 8"
    assert differs(kept, kept | {"std": [1.0, 2.0]}) == "std: 3 items, not 2"
    assert differs([None, 1.0], [2.0, 1.0]) == "None, not 2.0"
    assert differs({"a": 1}, {"b": 1}) == "fields ['a', 'b']"
