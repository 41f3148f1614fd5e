"""Time stamps of ROS in two columns, as text, in data frames and in Parquet files."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import imucal
from export_files import (
    FORCE,
    NS,
    OF_FORCE,
    OF_RATE,
    RATE,
    RATE_HZ,
    ROWS,
    STAMP,
    START_NS,
    TIME_S,
    lines,
    write,
)


@pytest.mark.parametrize(
    "stamp",
    [
        ("header.stamp.secs", "header.stamp.nsecs"),
        ("header.stamp.sec", "header.stamp.nanosec"),
        ("/imu/header/stamp/sec", "/imu/header/stamp/nanosec"),
        ("header_stamp_sec", "header_stamp_nanosec"),
        ("sec", "nanosec"),
    ],
)
def test_seconds_and_nanoseconds_of_a_stamp_are_one_time(tmp_path, stamp):
    # The rows have the time of receipt as well, which is later and has jitter.
    names = ["Time", *stamp, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    jitter_s = np.random.default_rng(1).uniform(0.0, 5e-3, ROWS)
    rows = lines(NS / 1e9 + 0.02 + jitter_s, NS // 10**9, NS % 10**9, RATE, FORCE)
    recording = imucal.read(write(tmp_path, "a.csv", ",".join(names), rows))
    np.testing.assert_array_equal(recording.time_s, (NS - NS[0]) / 1e9)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    assert f"time_ns={stamp[0]} and {stamp[1]}" in recording.findings[0].message
    assert not recording.auxiliary


def test_stamps_that_the_driver_does_not_set_are_not_read(tmp_path):
    names = ["Time", *STAMP, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    none = np.zeros(ROWS, int)
    recording = imucal.read(
        write(tmp_path, "a.csv", ",".join(names), lines(NS / 1e9 + 0.001, none, none, RATE, FORCE))
    )
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert "time_s=Time" in recording.findings[0].message


def test_a_stamp_that_is_not_a_whole_number_is_refused_with_its_line(tmp_path):
    names = [*STAMP, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    nanoseconds = (NS % 10**9).astype(float)
    nanoseconds[7] += 0.5
    path = write(tmp_path, "a.csv", ",".join(names), lines(NS // 10**9, nanoseconds, RATE, FORCE))
    with pytest.raises(imucal.FormatError, match="line 9: the seconds and nanoseconds"):
        imucal.read(path)


def imu_messages(nanoseconds, rows=ROWS):
    """The columns of `rows` messages of ROS, whose samples are those above, again and again."""
    columns = {STAMP[0]: nanoseconds // 10**9, STAMP[1]: nanoseconds % 10**9}
    for what, values in ((OF_RATE, RATE), (OF_FORCE, FORCE)):
        columns |= {f"{what}.{axis}": np.resize(values[:, i], rows) for i, axis in enumerate("xyz")}
    return columns


def test_stamp_in_two_columns_of_a_data_frame_and_of_a_parquet_file(tmp_path):
    frame = pa.table(imu_messages(NS))
    pq.write_table(frame, tmp_path / "a.parquet")
    for given in (frame, tmp_path / "a.parquet"):
        recording = imucal.read(given)
        np.testing.assert_array_equal(recording.time_s, (NS - NS[0]) / 1e9)
        np.testing.assert_array_equal(recording.specific_force, FORCE)
        np.testing.assert_array_equal(recording.angular_rate, RATE)
        assert f"time_ns={STAMP[0]} and {STAMP[1]}" in recording.findings[0].message
        assert not recording.auxiliary


def test_stamps_of_a_parquet_file_are_joined_in_every_part(tmp_path):
    # A Parquet file is read in parts of 65,536 rows.
    rows = 70_000
    stamps = START_NS + 2_500_000 * np.arange(rows)
    columns = imu_messages(stamps, rows)
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    pieces = list(imucal.io.read_pieces(tmp_path / "a.parquet"))
    assert len(pieces) > 1
    times = [imucal.read(tmp_path / "a.parquet").time_s, np.concatenate([piece.time_s for piece in pieces])]
    for time_s in times:
        np.testing.assert_array_equal(time_s, (stamps - stamps[0]) / 1e9)
    columns[STAMP[1]] = columns[STAMP[1]].astype(float)
    columns[STAMP[1]][rows - 1] += 0.5
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(imucal.FormatError, match=f"row {rows}: the seconds and nanoseconds"):
        imucal.read(tmp_path / "a.parquet")


def test_thousands_separators_are_no_decimal_commas(tmp_path):
    """In a table of a spreadsheet the commas are in quotes, and other numbers have a decimal point."""
    names = [*(f"Acc {a} (m/s^2)" for a in "xyz"), *(f"Gyro {a} (rad/s)" for a in "xyz")]
    stamps = [f'"{10 * row:,}"' for row in range(ROWS)]
    path = write(tmp_path, "run.csv", ",".join(["Time (ms)", *names]), lines(stamps, FORCE, RATE))
    with pytest.raises(imucal.FormatError, match=r"comma between thousands \('\d,\d00'\): export"):
        imucal.read(path)
    # Decimal commas with three digits are no thousands separators.
    numbers = np.column_stack([TIME_S, FORCE, RATE]).tolist()
    rows = [",".join(f'"{number:.3f}"'.replace(".", ",") for number in row) for row in numbers]
    recording = imucal.read(write(tmp_path, "comma.csv", ",".join(["Time (s)", *names]), rows))
    np.testing.assert_allclose(recording.specific_force, FORCE.round(3), atol=1e-9)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
