"""docs/independent.md: each row names files that use the reference and contain the stated figures."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/independent.md"
TEXT = PAGE.read_text(encoding="utf-8")
KINDS = {"other program", "published", "own model"}
LINK = re.compile(r"\]\(([^)#]+)\)")
CODE = re.compile(r"`([^`]+)`")
NUMBER = re.compile(r"(?<![\w.])[0-9]+(?:\.[0-9]+)?(?:e-?[0-9]+)?")
# Libraries of other authors that are references of tests or benchmarks.
LIBRARIES = {
    *("ahrs", "allantools", "dynamixel_sdk", "h5py", "imufusion", "mcap", "mcap_ros2", "numpy"),
    *("pandas", "polars", "pyarrow", "pymavlink", "pysindy", "pyulog", "rosbags", "scipy", "sklearn"),
}
IMPORT = re.compile(r"^ *(?:import|from) (\w+)|importorskip\(\"(\w+)", re.MULTILINE)


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


ROWS = [cells(line) for line in TEXT.splitlines() if line.startswith("|")]
ROWS = [row for row in ROWS if row[0] != "result" and set(row[0]) != {"-"}]


def imported(text):
    return {name or needed for name, needed in IMPORT.findall(text)}


def contains_number(text, number):
    """A part of another number does not count: 1e-1 is not in 1e-10, 0.01 is not in 0.015."""
    return re.search(rf"(?<![\w.]){re.escape(number)}(?![\w.]*[0-9])", text) is not None


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]}: {row[2][:30]}")
def test_the_files_of_a_row_have_its_reference_and_its_figures(row):
    _, kind, reference, agreement, where = row
    assert kind in KINDS
    texts = [(PAGE.parent / path).read_text(encoding="utf-8") for path in LINK.findall(where)]
    assert texts
    for name in CODE.findall(reference):
        assert any(name in (imported(text) if name in LIBRARIES else text) for text in texts), name
    for number in NUMBER.findall(agreement):
        is_found = any(contains_number(text, number) for text in texts)
        assert is_found, f"{number} has changed in {where}: write the new figure into docs/independent.md"


def test_a_number_is_not_found_in_another_one():
    for text in ("rtol=1e-10", "0.015", "x1e-1", "10.01"):
        assert not contains_number(text, "1e-1") and not contains_number(text, "0.01"), text
    assert contains_number("abs=0.01)", "0.01") and contains_number("within 0.01.", "0.01")
    assert NUMBER.findall("1e-3 of 0.018 mg; 39/40") == ["1e-3", "0.018", "39", "40"]


def test_the_page_names_every_library_that_is_a_reference():
    files = [path for folder in ("tests", "benches") for path in (ROOT / folder).rglob("*.py")]
    used = set().union(*(imported(path.read_text(encoding="utf-8")) for path in files))
    assert used >= LIBRARIES
    assert LIBRARIES - set(CODE.findall(TEXT)) == set()
