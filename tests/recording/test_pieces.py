"""Recordings that are read, corrected and written piece by piece: the same numbers as of the whole.

`hold_temperature` and the readers of pieces are called directly, because the public API gives whole
recordings only.
"""

import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from pyarrow import parquet

import imucal
from imucal.cli import main
from imucal.io import NotInPartsError, read_pieces, write_pieces
from imucal.io.held import hold_temperature

pytestmark = pytest.mark.slow

# More than a piece of either kind of file.
ROWS = 80_000
NAMES = [
    *(f"accel_{axis}_lsb" for axis in "xyz"),
    *(f"gyro_{axis}_dps" for axis in "xyz"),
    "temp_degc",
    "motor",
]


def columns_of(rows):
    random = np.random.default_rng(3)
    force = random.integers(-8000, 8000, (rows, 3))
    rate = random.normal(size=(rows, 3))
    time_ns = 1_700_000_000_123_456_789 + np.arange(rows) * 1_000_001
    values = [time_ns, *force.T, *rate.T, 20.0 + np.arange(rows) / rows, random.normal(size=rows)]
    return dict(zip(["time_ns", *NAMES], values, strict=True))


def written(folder, ending, columns):
    path = folder / f"run{ending}"
    if ending == ".parquet":
        parquet.write_table(pa.table(columns), path)
    else:
        pa.csv.write_csv(pa.table(columns), path)
    return path


@pytest.fixture
def unit(tmp_path):
    triad = imucal.Triad(np.diag([800.0, 810.0, 790.0]), np.array([30.0, -20.0, 10.0]))
    effects = (
        imucal.EffectValues("gyro_bias_drift", (1e-6, 2e-6, -3e-6)),
        imucal.EffectValues("gyro_bias_temperature", (1e-4, -2e-4, 3e-4)),
    )
    gyro = imucal.Triad(np.eye(3), np.zeros(3))
    calibration = imucal.Calibration(triad, gyro, accel_unit="lsb", effects=effects)
    calibration.save(tmp_path / "unit.json")
    return calibration


def assert_same(one, other):
    for name in ("time_s", "specific_force", "angular_rate", "temperature_degc"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name, values in other.auxiliary.items():
        np.testing.assert_array_equal(one.auxiliary[name], values)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_recording_corrected_by_pieces_is_the_whole_corrected(tmp_path, command, unit, ending):
    path, output = written(tmp_path, ending, columns_of(ROWS)), tmp_path / f"out{ending}"
    assert sum(1 for _ in read_pieces(path)) > 1
    done = command("apply", tmp_path / "unit.json", path, "-o", output)
    assert done.returncode == 0, done.stderr
    assert f"Recording('run{ending}': {ROWS} samples, {(ROWS - 1) * 1_000_001e-9:.3f} s" in done.stdout
    assert_same(imucal.read(output), unit.apply_recording(imucal.read(path)))


@pytest.mark.parametrize(
    ("known", "added_degc", "said"),
    [
        ((20.0, 21.0), 0.0, None),
        ((20.04, 20.96), 0.0, None),
        (
            (20.1, 21.0),
            0.0,
            "the temperature is 20 to 21 degC, but the calibration covers 20.1 to 21 degC: outs",
        ),
        ((15.0, 20.5), 0.0, "outside this range, gyro_bias_temperature are extrapolated"),
        (
            (15.0, 40.0),
            100.0,
            "the temperature is 120 to 121 degC, but the calibration covers 15 to 40 degC: outs",
        ),
    ],
)
def test_temperatures_that_the_calibration_has_not_seen_are_said(
    tmp_path, capsys, unit, known, added_degc, said
):
    columns = columns_of(ROWS)
    columns["temp_degc"] = columns["temp_degc"] + added_degc
    path = written(tmp_path, ".parquet", columns)
    dataclasses.replace(unit, temperature_range_degc=known).save(tmp_path / "unit.json")
    files = [str(tmp_path / name) for name in ("unit.json", path.name, "out.parquet", "said.json")]
    assert main(["apply", *files[:2], "-o", files[2], "--json", files[3]]) == 0
    document = json.loads((tmp_path / "said.json").read_text())
    low, high = document["temperature_range_degc"]
    assert (low, high) == pytest.approx((20.0 + added_degc, 21.0 + added_degc), abs=1e-4)
    shown = capsys.readouterr().out
    assert [f"warning: {warning}" in shown for warning in document["warnings"]] == [True] * (said is not None)
    assert said is None or said in document["warnings"][0]


def test_temperatures_in_kelvin_are_refused_and_no_recording_is_written(tmp_path, capsys, unit):
    columns = columns_of(ROWS)
    columns["temp_degc"] = columns["temp_degc"] + 273.15
    path = written(tmp_path, ".parquet", columns)
    dataclasses.replace(unit, temperature_range_degc=(15.0, 40.0)).save(tmp_path / "unit.json")
    files = [str(tmp_path / name) for name in ("unit.json", path.name, "out.parquet", "said.json")]
    assert main(["apply", *files[:2], "-o", files[2], "--json", files[3]]) == 1
    said = capsys.readouterr().err
    assert "[temperature_implausible]: it looks like kelvin" in said
    assert "name the column temp_k" in said
    assert json.loads((tmp_path / "said.json").read_text())["verdict"] == "no_result"
    assert not (tmp_path / "out.parquet").exists()


def test_samples_that_the_recording_lacks_are_counted_with_the_reason(tmp_path, capsys, unit):
    columns = columns_of(ROWS)
    gyro, temperature = columns["gyro_y_dps"].copy(), columns["temp_degc"].copy()
    gyro[[70_000, 70_005]] = np.nan
    temperature[70_003:70_006] = np.nan
    path = written(tmp_path, ".parquet", {**columns, "gyro_y_dps": gyro, "temp_degc": temperature})
    files = [str(tmp_path / name) for name in ("unit.json", path.name, "out.parquet", "said.json")]
    assert main(["apply", *files[:2], "-o", files[2], "--json", files[3]]) == 0
    warnings = [
        "2 samples are empty, first sample 70000: the rate or the force is not a number",
        "2 samples are empty, first sample 70003: the temperature is not a number",
    ]
    said = json.loads((tmp_path / "said.json").read_text())
    assert said["warnings"] == warnings
    counts = [said[f"samples_{name}"] for name in ("lost", "without_temperature", "missing")]
    assert counts == [2, 2, 2]
    assert capsys.readouterr().out.endswith("".join(f"warning: {warning}\n" for warning in warnings))


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_sample_rate_counts_on_from_piece_to_piece(tmp_path, command, ending):
    columns = columns_of(ROWS)
    del columns["time_ns"]
    path, output = written(tmp_path, ending, columns), tmp_path / "out.parquet"
    done = command("convert", path, "--rate-hz", 400, "-o", output)
    assert done.returncode == 0, done.stderr
    assert_same(imucal.read(output), imucal.read(path, rate_hz=400.0))


def test_a_column_that_turns_to_fractions_after_the_first_piece_is_read_as_a_whole(tmp_path, command):
    columns = columns_of(ROWS)
    lines = written(tmp_path, ".csv", columns).read_text().splitlines()
    fields = lines[-1].split(",")
    lines[-1] = ",".join([fields[0], "0.5", *fields[2:]])
    (tmp_path / "run.csv").write_text("\n".join(lines))
    with pytest.raises(NotInPartsError, match="read it as a whole"):
        list(read_pieces(tmp_path / "run.csv"))
    done = command("convert", tmp_path / "run.csv", "-o", tmp_path / "out.parquet")
    assert done.returncode == 0, done.stderr
    assert_same(imucal.read(tmp_path / "out.parquet"), imucal.read(tmp_path / "run.csv"))


def broken(tmp_path, count):
    """A CSV file of which the last `count` lines but four have text in the column accel_y_lsb."""
    lines = written(tmp_path, ".csv", columns_of(ROWS)).read_text().splitlines()
    for line in range(ROWS - 4 - count, ROWS - 4):
        fields = lines[line].split(",")
        lines[line] = ",".join([*fields[:2], "broken", *fields[3:]])
    (tmp_path / "run.csv").write_text("\n".join(lines))
    return tmp_path / "run.csv"


def test_a_wrong_line_far_down_is_left_out_with_its_number(tmp_path, command):
    path, output = broken(tmp_path, 1), tmp_path / "out.csv"
    with pytest.raises(NotInPartsError, match="read it as a whole"):
        list(read_pieces(path))
    done = command("convert", path, "-o", output)
    assert done.returncode == 0, done.stderr
    assert f"left out: 1 lines with text among the numbers (the first: line {ROWS - 4})" in done.stdout
    assert "[lines_left_out]" in done.stdout
    kept = {name: np.delete(values, ROWS - 6) for name, values in columns_of(ROWS).items()}
    assert_same(imucal.read(output), imucal.read(written(tmp_path, ".parquet", kept)))


def test_what_is_wrong_far_down_is_said_with_its_line_and_nothing_is_written(tmp_path, command):
    count = ROWS // 50
    path = broken(tmp_path, count)
    done = command("convert", path, "-o", tmp_path / "out.csv")
    assert done.returncode == 1
    first = ROWS - 3 - count
    assert f"line {first}, column accel_y_lsb: 'broken' is not a number" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["run.csv"]


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_short_file_comes_in_one_piece(tmp_path, ending):
    path = written(tmp_path, ending, columns_of(20))
    (piece,) = read_pieces(path)
    assert_same(piece, imucal.read(path))
    later = dataclasses.replace(piece, time_s=piece.time_s + 1.0)
    write_pieces([piece, later], tmp_path / "both.csv")
    both = imucal.read(tmp_path / "both.csv")
    assert len(both) == 40
    assert both.findings == ()
    # The rows of a piece that is written twice are copies.
    write_pieces([piece, piece], tmp_path / "twice.csv")
    twice = imucal.read(tmp_path / "twice.csv")
    assert_same(twice, piece)
    assert [(finding.code, finding.count) for finding in twice.findings] == [("samples_duplicated", 20)]


def test_a_parquet_file_without_rows_is_an_empty_recording(tmp_path, command):
    path = written(tmp_path, ".parquet", columns_of(0))
    assert len(imucal.read(path)) == 0
    done = command("convert", path, "-o", tmp_path / "out.csv")
    assert done.returncode == 0, done.stderr
    assert len(imucal.read(tmp_path / "out.csv")) == 0


def test_a_derivative_by_time_takes_the_whole(unit, tmp_path, command):
    lever_arm = imucal.EffectValues("accel_lever_arm", (0.01, 0.02, 0.03))
    whole = imucal.Calibration(unit.accelerometer, unit.gyroscope, accel_unit="lsb", effects=(lever_arm,))
    assert unit.takes_pieces
    assert not whole.takes_pieces
    piece = imucal.Recording(np.arange(9.0), np.ones((9, 3)), np.ones((9, 3)))
    with pytest.raises(imucal.InputError, match="need the whole recording"):
        whole.apply_recording(piece, start_s=0.0)
    whole.save(tmp_path / "whole.json")
    path = written(tmp_path, ".parquet", columns_of(ROWS))
    done = command("apply", tmp_path / "whole.json", path, "-o", tmp_path / "out.parquet")
    assert done.returncode == 0, done.stderr
    assert_same(imucal.read(tmp_path / "out.parquet"), whole.apply_recording(imucal.read(path)))


def test_a_slow_temperature_is_held_and_an_old_one_is_not(tmp_path):
    read_degc = np.full(3000, np.nan)
    # Each second from the first half second on, and never again after 15 s.
    read_degc[50:1500:100] = np.arange(15.0)
    time_s, zeros = np.arange(3000) / 100.0, np.zeros((3000, 3))
    recording = imucal.Recording(time_s, zeros, zeros, temperature_degc=read_degc)
    (whole,) = hold_temperature([recording])
    expected = np.clip(np.floor(time_s - 0.5), 0, 14)
    expected[time_s > 14.5 + 10.0] = np.nan
    np.testing.assert_array_equal(whole.temperature_degc, expected)

    parts = [recording.between(start, start + 7) for start in range(0, 35, 7)]
    held = np.concatenate([piece.temperature_degc for piece in hold_temperature(parts)])
    np.testing.assert_array_equal(held, expected)

    imucal.write(recording, tmp_path / "slow.csv")
    output = tmp_path / "held.csv"
    assert main(["convert", str(tmp_path / "slow.csv"), "-o", str(output), "--hold-temperature"]) == 0
    np.testing.assert_array_equal(imucal.read(output).temperature_degc, expected)
