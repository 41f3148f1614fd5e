"""Plain tables are parsed by the compiled library: the same recordings as by Arrow, bit for bit.

The parser is switched off for the comparison, because no input would do so without changing the recording.
"""

import hashlib

import numpy as np
import pytest

import imucal
import imucal.io.text as text

NAMES = ("time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz"), "count")
ROWS = 40
CELLS = {
    "floats": lambda chance: repr(float(chance.normal() * 10.0 ** chance.integers(-12, 12))),
    "fixed": lambda chance: f"{chance.normal():.{chance.integers(0, 20)}f}",
    "short": lambda chance: f"{chance.normal():.3g}",
    "integers": lambda chance: str(chance.integers(-(10**6), 10**6)),
    "zeros": lambda chance: str(chance.choice(["-0", "0", "0.0", "-0.0", "00", ".5", "7."])),
    "mixed": lambda chance: str(chance.choice(["1", "-2", "1e3", "2.5E-3", "9007199254740993", "3"])),
}


def table(cell, separator, end="\n", decimal=".", seed=1):
    chance = np.random.default_rng(seed)
    rows = [separator.join(NAMES)]
    for row in range(ROWS):
        cells = [f"{row / 100}", *(CELLS[cell](chance) for _ in range(6)), str(row)]
        rows.append(separator.join(field.replace(".", decimal) for field in cells))
    return end.join(rows) + end


def both(path, monkeypatch, **options):
    """The recording by the parser, and the one by Arrow."""
    called = []
    parsed = text._parsed
    with monkeypatch.context() as patch:
        patch.setattr(text, "_parsed", lambda *given: called.append(parsed(*given)) or called[-1])
        fast = imucal.read(path, **options)
    assert called
    assert called[-1] is not None
    with monkeypatch.context() as patch:
        patch.setattr(text, "_parsed", lambda *_: None)
        return fast, imucal.read(path, **options)


def assert_same(one, other):
    for array, known in (
        (one.time_s, other.time_s),
        (one.specific_force, other.specific_force),
        (one.angular_rate, other.angular_rate),
        (one.auxiliary["count"], other.auxiliary["count"]),
    ):
        assert array.dtype == known.dtype
        np.testing.assert_array_equal(array.view(np.int64), known.view(np.int64))
    assert (one.sources, one.name, one.findings) == (other.sources, other.name, other.findings)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(
    ("separator", "end", "decimal"), [(",", "\n", "."), (";", "\r\n", ","), ("\t", "\n", ".")]
)
def test_numbers_are_those_of_arrow(cell, separator, end, decimal, tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_bytes(table(cell, separator, end, decimal).encode())
    fast, slow = both(path, monkeypatch)
    assert_same(fast, slow)
    assert fast.sources[0].sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_columns_separated_by_spaces(tmp_path, monkeypatch):
    path = tmp_path / "run.txt"
    lines = table("floats", "   ").splitlines()[1:]
    path.write_text("\n".join(f" {line} " for line in lines))
    assert_same(*both(path, monkeypatch, columns=",".join(NAMES)))


def test_a_file_of_many_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(text, "BLOCK", 1 << 10)
    path = tmp_path / "run.csv"
    path.write_text(
        table("floats", ",") + "".join(table("mixed", ",", seed=s).partition("\n")[2] for s in (2, 3))
    )
    fast, slow = both(path, monkeypatch)
    assert len(fast) == 3 * ROWS
    assert_same(fast, slow)


@pytest.mark.parametrize(
    "last", ["0.4,1,2,3,4,5,6", "0.4,1,2,3,4,5,6,", "boot: reset", '0.4,1,2,3,4,5,"6",7', ""]
)
def test_what_is_not_plain_is_left_to_the_other_readers(last, tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text(table("floats", ",") + last)
    with monkeypatch.context() as patch:
        patch.setattr(text, "_parsed", lambda *_: None)
        slow = imucal.read(path)
    assert_same(imucal.read(path), slow)
