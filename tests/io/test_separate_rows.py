"""Tables in which each row holds the sample of one sensor: named in a column, or with empty cells."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv as pa_csv, parquet

import imucal
from export_files import FORCE, NS, RATE, ROWS, TIME_S, lines, write
from imucal.cli import main

EMPTY = [",,"] * ROWS
HEADER = "time_s," + ",".join([f"accel_{a}_mps2" for a in "xyz"] + [f"gyro_{a}_radps" for a in "xyz"])
HALF = ROWS // 2


def named_rows(force=FORCE, rate=RATE, names=("ACC", "GYRO"), late_ns=0):
    rows = [f"{ns},{names[0]},{row}" for ns, row in zip(NS, lines(force), strict=True)]
    return rows + [f"{ns + late_ns},{names[1]},{row}" for ns, row in zip(NS, lines(rate), strict=True)]


def interleaved(rows):
    return [row for pair in zip(rows[:ROWS], rows[ROWS:], strict=True) for row in pair]


@pytest.mark.parametrize("order", [list, interleaved])
@pytest.mark.parametrize(
    "names", [("ACC", "GYRO"), ("accelerometer", "gyroscope"), ("Acceleration", "Rotation rate")]
)
def test_rows_with_the_name_of_their_sensor(tmp_path, order, names):
    rows = [*order(named_rows(names=names)), "", f"{NS[0]},magnetometer,1.0,2.0,3.0"]
    path = write(tmp_path, "gyro run.csv", "timestamp,sensor,x,y,z", rows)
    recording = imucal.read(path, gyro_unit="rad/s")
    check(recording)
    with pytest.raises(imucal.FormatError, match="gives no unit"):
        imucal.read(path)


def test_rows_without_a_name_are_counted_and_the_unit_of_one_sensor_in_the_header_is_not_that_of_the_other(
    tmp_path,
):
    rows = [";".join(row.split(",")) for row in named_rows()]
    for header in ("timestamp;sensor;x;y;z", "timestamp;sensor;x (m/s^2);y (m/s^2);z (m/s^2)"):
        path = write(tmp_path, "run.csv", "a line before", header, [*rows, "1;;2;3;4"])
        recording = imucal.read(path, gyro_unit="rad/s")
        check(recording)
        said = " ".join(own.message for own in recording.findings)
        assert "1 rows without the name of a sensor" in said


def test_rows_of_two_units_in_one_file_are_refused(tmp_path):
    rows = [
        f"{unit},{row}"
        for pair in zip(named_rows(), named_rows(FORCE + 2.0, RATE + 1.0), strict=True)
        for unit, row in zip(("left", "right"), pair, strict=True)
    ]
    with pytest.raises(
        imucal.FormatError, match=r"one of 2 units, named in the column 'device' \(left, right\)"
    ):
        imucal.read(write(tmp_path, "run.csv", "device,timestamp,sensor,x,y,z", rows), gyro_unit="rad/s")


@pytest.mark.parametrize("name", ["device", "meta.deviceId", "IMU no", "ble_mac"])
@pytest.mark.parametrize("times", [1, 20])
def test_two_units_one_after_the_other_are_refused(tmp_path, name, times):
    """With 20 times as many rows, the first rows have those of one unit only."""
    rows = lines(np.resize(FORCE, (ROWS * times, 3)), np.resize(RATE, (ROWS * times, 3)))
    rows = [f"{at / 100},{row}" for at, row in enumerate(rows)]
    path = write(
        tmp_path,
        "run.csv",
        f"{HEADER},{name}",
        [f"{row},{unit}" for unit in ("left", "right") for row in rows],
    )
    message = f"one of 2 units, named in the column '{name}' .left, right.: write the rows of each unit to"
    with pytest.raises(imucal.FormatError, match=message):
        imucal.read(path)
    assert main(["convert", str(path), "-o", str(tmp_path / "out.csv")]) == 1
    one = write(tmp_path, "one.csv", f"{HEADER},{name}", [f"{row},left" for row in rows])
    assert len(imucal.read(one)) == len(rows)


def test_units_that_are_written_in_packets_are_refused_whatever_the_name_of_their_column(tmp_path):
    rows = [f"{t},{row}" for t, row in zip(TIME_S, lines(FORCE, RATE), strict=True)]
    packets = [
        f"{row},{who}" for at in range(0, ROWS, 50) for who in ("a", "b") for row in rows[at : at + 50]
    ]
    with pytest.raises(imucal.FormatError, match=r"one of 2 units, named in the column 'who' \(a, b\)"):
        imucal.read(write(tmp_path, "run.csv", f"{HEADER},who", packets))
    poses = [f"{row},{'ab'[at // 50 % 2]}" for at, row in enumerate(rows)]
    assert len(imucal.read(write(tmp_path, "run.csv", f"{HEADER},pose", poses))) == ROWS


def test_a_column_that_does_not_name_known_sensors_is_refused(tmp_path):
    rows = [row.replace("ACC", "1").replace("GYRO", "4") for row in named_rows()]
    path = write(tmp_path, "accel.csv", "timestamp,type,ax (m/s^2),ay (m/s^2),az (m/s^2)", rows)
    with pytest.raises(imucal.FormatError, match=r"one of 2 sensors, named in the column 'type' \(1, 4\)"):
        imucal.read(path)


@pytest.mark.parametrize("cut", [4, 25, 40])
def test_a_last_row_that_was_cut_off_is_left_out(tmp_path, cut):
    rows = [
        f"{ns},{sensor},{x:.6f},{y:.6f},{z:.6f}"
        for ns, *both in zip(NS, FORCE, RATE, strict=True)
        for sensor, (x, y, z) in zip(("accelerometer", "gyroscope"), both, strict=True)
    ]
    path = write(tmp_path, "run.csv", "timestamp,sensor,x,y,z", rows)
    path.write_bytes(path.read_bytes()[: -1 - cut])
    recording = imucal.read(path, gyro_unit="rad/s")
    np.testing.assert_allclose(recording.time_s, TIME_S[:-1], atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE[:-1], atol=1e-6)
    assert any("an incomplete last line" in own.message for own in recording.findings)


def outer_join(late_s=0.0, step=1, gyro=RATE):
    """A table with the samples of both sensors; only every `step`-th accelerometer sample was written."""
    rows = [(t, f"{row},,,") for t, row in list(zip(TIME_S, lines(FORCE), strict=True))[::step]]
    rows += [(t + late_s, f",,,{row}") for t, row in zip(TIME_S, lines(gyro), strict=True)]
    return [f"{t:.6f},{cells}" for t, cells in sorted(rows)]


@pytest.mark.parametrize("step", [1, 2])
def test_an_outer_join_is_resampled_to_one_clock(tmp_path, step):
    recording = imucal.read(write(tmp_path, "run.csv", HEADER, outer_join(0.004, step)))
    (resampled,) = [own for own in recording.findings if own.code == "resampled"]
    assert resampled.message.startswith(
        "the accelerometer (100 Hz) was" if step == 1 else "the gyroscope (100 Hz) was"
    )
    pair = (
        write(
            tmp_path,
            "accel.csv",
            "time_s,x (m/s^2),y (m/s^2),z (m/s^2)",
            lines(TIME_S[::step], FORCE[::step]),
        ),
        write(
            tmp_path,
            "gyro.csv",
            "time_s,x (rad/s),y (rad/s),z (rad/s)",
            lines(np.round(TIME_S + 0.004, 6), RATE),
        ),
    )
    expected = imucal.read(*pair)
    assert len(recording) == len(expected)
    np.testing.assert_allclose(recording.specific_force, expected.specific_force, atol=1e-6)
    np.testing.assert_allclose(recording.angular_rate, expected.angular_rate, atol=1e-6)


def test_one_sensor_at_a_lower_rate_in_some_of_the_rows(tmp_path):
    force = [row if at % 2 == 0 else ",," for at, row in enumerate(lines(FORCE))]
    rows = [f"{t},{f},{w}" for t, f, w in zip(TIME_S, force, lines(RATE), strict=True)]
    recording = imucal.read(write(tmp_path, "run.csv", HEADER, rows))
    assert HALF - 2 <= len(recording) <= HALF
    assert np.isfinite(recording.specific_force).all() and np.isfinite(recording.angular_rate).all()


@pytest.mark.parametrize("kind", ["lost samples", "failure of a sensor", "one axis empty"])
def test_other_empty_cells_stay_and_are_refused(tmp_path, kind):
    force = lines(FORCE)
    if kind == "lost samples":
        force = [",," if at in (5, 40, 41) else row for at, row in enumerate(force)]
    elif kind == "failure of a sensor":
        force = [",," if 3 < at < HALF else row for at, row in enumerate(force)]
    else:
        force = [",".join((*row.split(",")[:2], "")) if at % 2 else row for at, row in enumerate(force)]
    rows = [f"{t},{f},{w}" for t, f, w in zip(TIME_S, force, lines(RATE), strict=True)]
    recording = imucal.read(write(tmp_path, "run.csv", HEADER, rows))
    assert len(recording) == ROWS and np.isnan(recording.specific_force).any()
    with pytest.raises(imucal.InputError, match="non_finite"):
        imucal.calibrate(recording)


def test_convert_counts_the_samples_that_lack_a_sensor(tmp_path, capsys):
    rate = [row if at % 25 == 0 else ",," for at, row in enumerate(lines(RATE))]
    rows = [f"{t},{f},{w}" for t, f, w in zip(TIME_S, lines(FORCE), rate, strict=True)]
    path, output = write(tmp_path, "run.csv", HEADER, rows), tmp_path / "out.csv"
    assert main(["convert", str(path), "-o", str(output)]) == 0
    expected = f"{ROWS - ROWS // 25} of {ROWS} samples lack a number for the force or the rate [non_finite]"
    assert expected in capsys.readouterr().out


def check(recording):
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def test_columns_without_a_sensor_that_an_outer_join_loses_are_named(tmp_path):
    for late_s in (0.0, 0.004):
        rows = [f"{row},1013.2,7" for row in outer_join(late_s)]
        recording = imucal.read(write(tmp_path, "run.csv", f"{HEADER},pressure_hpa,state", rows))
        assert not recording.auxiliary
        said = [own.message for own in recording.findings]
        assert any(own.startswith("the columns pressure_hpa, state were left out") for own in said)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("complete", [0, 60, 1500])
def test_an_outer_join_in_a_large_file_is_resampled_by_the_commands_too(tmp_path, ending, complete):
    """The first rows may be complete, so that only a later piece shows the separate rows."""
    count = 2_000 if ending == ".csv" else 70_000
    time_s = np.arange(count) / 100.0
    force, rate = np.resize(FORCE, (count, 3)), np.resize(RATE, (count, 3))
    rows = np.full((2 * count, 7), np.nan)
    rows[::2, 0], rows[1::2, 0] = time_s, time_s + 0.004
    rows[::2, 1:4], rows[1::2, 4:] = force, rate
    rows[: 2 * complete : 2, 4:] = rate[:complete]
    rows = np.delete(rows, np.s_[1 : 2 * complete : 2], axis=0)
    path, output = tmp_path / f"run{ending}", tmp_path / "out.parquet"
    table = pa.table(list(rows.T), names=HEADER.split(","))
    if ending == ".csv":
        pa_csv.write_csv(table, path)
        path.write_text(path.read_text().replace("nan", ""))
        assert path.stat().st_size > 1 << 16
    else:
        parquet.write_table(table, path)
    whole = imucal.read(path)
    assert whole.findings[-1].code == "resampled" and count - 2 <= len(whole) <= count
    assert main(["convert", str(path), "-o", str(output)]) == 0
    # Separate rows in the output would only be joined when it is read.
    assert parquet.read_metadata(output).num_rows == len(whole)
    converted = imucal.read(output)
    np.testing.assert_array_equal(converted.time_s, whole.time_s)
    np.testing.assert_array_equal(converted.specific_force, whole.specific_force)
    np.testing.assert_array_equal(converted.angular_rate, whole.angular_rate)
