"""Properties of the readers of text and of options, for texts and values that Hypothesis finds."""

import contextlib

import numpy as np
import pytest

import imucal
from imucal.io import FORMATS
from imucal.io.names import triad_part

pytest.importorskip("hypothesis", reason="hypothesis belongs to the development group")

from hypothesis import HealthCheck, given, settings, strategies as st

NAMES = ["time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz")]
# Seeded, so that `make test` does the same each time; a fixture with a folder is as good for every example.
SETTINGS = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)
CELLS = st.one_of(
    NUMBERS.map(repr),
    st.sampled_from(["", "nan", "inf", "-0", "1e999", '"1.5"', " 2 ", "1,5", "x", "0x10", "1_000", "٣"]),
    st.text(max_size=4),
)
OPTIONS = {
    "columns": st.one_of(st.text(max_size=20), st.lists(st.sampled_from([*NAMES, "-", "x=y"]), max_size=9)),
    "rate_hz": st.floats() | st.just(100.0),
    "skip_rows": st.integers(-3, 50),
    "topic": st.text(max_size=5),
    "group": st.text(max_size=5),
    "instance": st.integers(-2, 3),
    "time_unit": st.sampled_from(["s", "ms", "us", "ns", "h", ""]),
    "format": st.sampled_from([*FORMATS, "other"]),
}


@SETTINGS
@given(st.lists(st.lists(NUMBERS, min_size=7, max_size=7), min_size=1, max_size=20))
def test_numbers_written_as_csv_are_read_bit_for_bit(tmp_path, rows):
    table = np.array(rows)
    path = tmp_path / "run.csv"
    imucal.write(imucal.Recording(table[:, 0], table[:, 1:4], table[:, 4:]), path)
    # A row that repeats the time stamp of another is a copy, which the reader leaves out.
    if len(np.unique(table[:, 0])) == len(table):
        found = imucal.read(path, format="csv")
        np.testing.assert_array_equal(found.time_s, table[:, 0])
        np.testing.assert_array_equal(found.specific_force, table[:, 1:4])
        np.testing.assert_array_equal(found.angular_rate, table[:, 4:])


@SETTINGS
@given(
    st.lists(st.lists(CELLS, min_size=1, max_size=9), max_size=12),
    st.sampled_from([",", ";", "\t", " "]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["utf-8", "utf-16", "latin-1"]),
)
def test_any_table_of_text_is_read_or_refused(tmp_path, rows, separator, end, encoding):
    lines = [separator.join(row) for row in [NAMES, *rows]]
    path = tmp_path / "run.csv"
    path.write_bytes(end.join(lines).encode(encoding, "replace"))
    with contextlib.suppress(imucal.ImucalError):
        recording = imucal.read(path)
        assert len(recording) <= len(rows) * 3


@SETTINGS
@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(tmp_path, content):
    path = tmp_path / "run.txt"
    path.write_bytes(content)
    for format in (None, "csv", "columns", "euroc", "numpy", "parquet", "labels"):
        options = {"columns": ",".join(NAMES)} if format == "columns" else {}
        with contextlib.suppress(imucal.ImucalError):
            imucal.read(path, format=format, **options)


@SETTINGS
@given(
    st.dictionaries(st.sampled_from(sorted(OPTIONS)), st.none(), max_size=3).flatmap(
        lambda names: st.fixed_dictionaries({name: OPTIONS[name] for name in names})
    )
)
def test_any_options_are_used_or_refused(tmp_path, options):
    path = tmp_path / "run.csv"
    if not path.exists():
        path.write_text(",".join(NAMES) + "\n" + "".join(f"{i},0,0,9.8,0,0,0\n" for i in range(20)))
    with contextlib.suppress(imucal.ImucalError):
        imucal.read(path, **options)


@SETTINGS
@given(st.text(max_size=20))
def test_a_column_name_is_canonical_only_as_it_is_written(name):
    part = triad_part(name)
    assert part is None or "_".join(part) == name
