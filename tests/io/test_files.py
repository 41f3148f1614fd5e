"""Recordings: what the type takes, what the readers make of files, and what they say about bad ones."""

import hashlib
import os
import signal
import subprocess
import sys
import textwrap
from contextlib import contextmanager

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import imucal

HEADER = "time_s,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
IMU_COLUMNS = HEADER.removeprefix("time_s,")
ROW = "0,0,0,9.8,0,0,0"


def random_recording(rows=500, **more):
    numbers = np.random.default_rng(5)
    return imucal.Recording(
        np.arange(rows) * 0.01 + numbers.uniform(0, 1e-4, rows),
        numbers.normal(size=(rows, 3)) * np.array([1e-17, 1.0, 1e17]),
        numbers.normal(size=(rows, 3)),
        **more,
    )


def write_text(folder, text, name="run.csv"):
    path = folder / name
    path.write_text(text)
    return path


# The type


@pytest.mark.parametrize(
    "change",
    [
        np.asfortranarray,
        lambda a: np.repeat(a, 2, axis=0)[::2],
        lambda a: a.astype(np.int32),
        lambda a: a.tolist(),
        lambda a: np.ma.masked_array(a, mask=np.zeros_like(a, bool)),
        lambda a: np.ma.masked_array(a.astype(np.int16), mask=np.zeros_like(a, bool)),
        lambda a: a.astype(">f8"),
        lambda a: a.astype(">f4"),
    ],
    ids=[
        "fortran",
        "strided",
        "int32",
        "list",
        "masked",
        "masked counts",
        "big-endian",
        "big-endian float32",
    ],
)
def test_every_kind_of_array_gives_the_same_recording(change):
    force = np.arange(12.0).reshape(4, 3)
    recording = imucal.Recording(np.arange(4.0), change(force), change(force + 1))
    np.testing.assert_array_equal(recording.specific_force, force)
    np.testing.assert_array_equal(recording.angular_rate, force + 1)
    assert recording.specific_force.dtype == np.float64
    assert recording.specific_force.flags.c_contiguous
    assert not recording.specific_force.flags.writeable


def test_contiguous_float64_is_not_copied_and_stays_writable_for_its_owner():
    force = np.zeros((4, 3))
    recording = imucal.Recording(np.arange(4.0), force, force)
    assert np.shares_memory(recording.specific_force, force)
    force[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        recording.specific_force[0, 0] = 2.0


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16])
def test_masked_values_become_nan(kind):
    force = np.ma.masked_array(np.ones((2, 3), kind), mask=[[False, True, False], [False] * 3])
    recording = imucal.Recording([0, 1], force, np.zeros((2, 3)))
    np.testing.assert_array_equal(np.isnan(recording.specific_force), force.mask)


@pytest.mark.parametrize("kind", [np.float32, np.int16])
def test_samples_in_a_smaller_type_stay_so(tmp_path, kind):
    generator = np.random.default_rng(3)
    force, rate = (generator.normal(size=(50, 3)) * 1000).astype(kind), np.full((50, 3), -32768, kind)
    recording = imucal.Recording(np.arange(50) / 100, force, rate, accel_unit="lsb", gyro_unit="lsb")
    for values, given in ((recording.specific_force, force), (recording.angular_rate, rate)):
        assert np.shares_memory(values, given)
        assert not values.flags.writeable
    assert recording.between(0.1, 0.2).specific_force.dtype == kind
    for name, kept in (("run.csv", np.float64), ("run.parquet", np.float32)):
        imucal.write(recording, tmp_path / name)
        again = imucal.read(tmp_path / name)
        # float32 holds every count, and NaN for an empty cell.
        assert again.specific_force.dtype == again.angular_rate.dtype == kept
        np.testing.assert_array_equal(again.specific_force, force)
        np.testing.assert_array_equal(again.angular_rate, rate)


def test_a_column_of_a_file_that_float32_does_not_hold_makes_its_triad_float64(tmp_path):
    names = ["time_s", *(f"accel_{axis}_lsb" for axis in "xyz"), *(f"gyro_{axis}_dps" for axis in "xyz")]
    kinds = [np.float64, np.int16, np.int16, np.int32, *[np.float32] * 3]
    columns = [np.arange(5).astype(kind) for kind in kinds]
    parquet.write_table(pa.table(columns, names=names), tmp_path / "run.parquet")
    recording = imucal.read(tmp_path / "run.parquet")
    # The other triad is not in SI units.
    assert recording.specific_force.dtype == recording.angular_rate.dtype == np.float64


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 1], np.zeros((3, 3)), np.zeros((2, 3))), "specific_force has 3 rows but 2 are needed"),
        (([0, 1], np.zeros((2, 3)), np.zeros((2, 2))), r"angular_rate has the shape \(2, 2\)"),
        (([0, 1], np.zeros((3, 2)), np.zeros((2, 3))), "give its transpose"),
        (([0, 1], [["a"] * 3] * 2, np.zeros((2, 3))), "real numbers"),
        (([0, 1], [[1, 2, 3], [4, 5]], np.zeros((2, 3))), "cannot be made an array"),
        (([0, 1], np.zeros((2, 3), complex), np.zeros((2, 3))), "complex128"),
        ((np.zeros((2, 1)), np.zeros((2, 3)), np.zeros((2, 3))), "time_s has the shape"),
        ((3.0, np.zeros((2, 3)), np.zeros((2, 3))), "time_s has the shape"),
        ((None, np.zeros((2, 3)), np.zeros((2, 3))), "object"),
    ],
)
def test_wrong_columns_are_named(arguments, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.Recording(*arguments)


def test_unknown_unit_is_refused():
    with pytest.raises(imucal.InputError, match="accel_unit is 'g': give one of m/s"):
        random_recording(accel_unit="g")


def test_an_empty_recording_can_be_held():
    recording = imucal.Recording([], [], [])
    assert len(recording) == 0
    assert recording.duration_s == 0
    assert np.isnan(recording.rate_hz)


def test_rate_duration_and_part():
    recording = imucal.Recording(np.arange(1000) / 200, np.zeros((1000, 3)), np.zeros((1000, 3)))
    assert recording.rate_hz == pytest.approx(200, rel=1e-12)
    assert recording.duration_s == pytest.approx(4.995)
    part = recording.between(1.0, 2.0)
    assert (len(part), part.time_s[0], part.time_s[-1]) == (200, 1.0, 1.995)
    assert "1000 samples, 4.995 s, 200 Hz" in repr(recording)


# The canonical files


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_round_trip_is_bit_exact(tmp_path, ending):
    rows = 500
    numbers = np.random.default_rng(7)
    recording = random_recording(
        rows,
        temperature_degc=numbers.normal(25, 1, rows),
        stand_rad=numbers.normal(size=(rows, 3)),
        auxiliary={"pressure_pa": numbers.normal(1e5, 1, rows)},
        gyro_unit="lsb",
    )
    recording.auxiliary["pressure_pa"].base[3] = np.nan
    path = tmp_path / f"run.{ending}"
    imucal.write(recording, path)
    again = imucal.read(path)
    for column in ("time_s", "specific_force", "angular_rate", "temperature_degc", "stand_rad"):
        np.testing.assert_array_equal(getattr(again, column), getattr(recording, column), column)
    np.testing.assert_array_equal(again.auxiliary["pressure_pa"], recording.auxiliary["pressure_pa"])
    assert (again.accel_unit, again.gyro_unit, again.name) == ("m/s^2", "lsb", f"run.{ending}")
    assert again.sources == (imucal.Source(str(path), hashlib.sha256(path.read_bytes()).hexdigest()),)


def test_a_whole_number_is_written_as_a_float(tmp_path):
    # Other programs take a column for what its first rows are.
    numbers = [0.0, -0.0, 1.0, -12345.0, 12345678901.0, 1e22, 5e-324, 0.1, np.nan, np.inf, -np.inf]
    rows = len(numbers)
    whole = imucal.Recording(
        np.arange(rows) * 0.5,
        np.zeros((rows, 3)),
        np.full((rows, 3), 7.0),
        gyro_unit="lsb",
        auxiliary={"supply_v": np.array(numbers)},
    )
    imucal.write(whole, tmp_path / "whole.csv")
    _, first, *others = (tmp_path / "whole.csv").read_text().splitlines()
    assert first == "0.0,0.0,0.0,0.0,7,7,7,0.0"
    supply = " ".join(line.rpartition(",")[2] for line in others)
    assert supply == "-0.0 1.0 -12345.0 1.2345678901e+10 1e+22 5e-324 0.1 nan inf -inf"
    again = imucal.read(tmp_path / "whole.csv").auxiliary["supply_v"]
    assert again.tobytes() == np.array(numbers).tobytes()


def test_canonical_csv_has_the_contracts_header(tmp_path):
    path = tmp_path / "run.csv"
    imucal.write(imucal.Recording([0.5], [[1, 2, 3]], [[4, 5, 6]], temperature_degc=[21]), path)
    assert path.read_text() == f"{HEADER},temp_degc\n0.5,1.0,2.0,3.0,4.0,5.0,6.0,21.0\n"


@pytest.mark.parametrize(
    ("accel", "gyro", "force", "rate"),
    [
        ("g", "dps", 9.80665, np.pi / 180),
        ("mg", "mdps", 0.00980665, np.pi / 180000),
        ("mps2", "radps", 1.0, 1.0),
        ("lsb", "lsb", 1.0, 1.0),
    ],
)
def test_units_in_column_names(tmp_path, accel, gyro, force, rate):
    names = [
        "time_ms",
        *(f"accel_{a}_{accel}" for a in "xyz"),
        *(f"gyro_{a}_{gyro}" for a in "xyz"),
        "stand_1_deg",
    ]
    names += ["stand_2_deg", "stand_3_deg"]
    path = write_text(tmp_path, ",".join(names) + "\n5,1,2,3,4,5,6,180,0,90\n10,1,2,3,4,5,6,180,0,90\n")
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.time_s, [0, 0.005])
    np.testing.assert_allclose(recording.specific_force[0], np.array([1, 2, 3]) * force, rtol=3e-16)
    np.testing.assert_allclose(recording.angular_rate[0], np.array([4, 5, 6]) * rate, rtol=3e-16)
    np.testing.assert_allclose(recording.stand_rad[0], [np.pi, 0, np.pi / 2], rtol=3e-16)
    assert recording.accel_unit == ("lsb" if accel == "lsb" else "m/s^2")
    assert recording.gyro_unit == ("lsb" if gyro == "lsb" else "rad/s")


def test_large_nanosecond_stamps_lose_no_digit(tmp_path):
    start = 1_403_636_580_838_555_648
    rows = "".join(f"{start + i * 5_000_001},0,0,9.8,0,0,0\n" for i in range(1000))
    recording = imucal.read(write_text(tmp_path, HEADER.replace("time_s", "time_ns") + "\n" + rows))
    np.testing.assert_array_equal(recording.time_s, np.arange(1000) * 5_000_001 / 1e9)


def test_column_that_turns_to_fractions_late_is_read(tmp_path):
    rows = "".join(f"{i},0,0,9,0,0,0\n" for i in range(200_000)) + "200000,0.25,0,9,0,0,0\n"
    assert imucal.read(write_text(tmp_path, f"{HEADER}\n{rows}")).specific_force[-1, 0] == 0.25


def test_header_variants(tmp_path):
    plain = imucal.read(write_text(tmp_path, f"{HEADER}\n{ROW}\n"))
    quoted = ",".join(f'"{name}"' for name in HEADER.split(","))
    for text in (
        f"\ufeff{HEADER}\n{ROW}\n",
        f"{HEADER}\r\n{ROW}\r\n",
        f"{quoted}\n{ROW}",
        f"{HEADER.replace(',', ', ')}\n{ROW.replace(',', ', ')}\n",
        f"\n{HEADER}\n\n{ROW}\n\n",
        f"{HEADER.replace(',', ';')}\n{ROW.replace(',', ';')}\n",
    ):
        again = imucal.read(write_text(tmp_path, text))
        np.testing.assert_array_equal(again.specific_force, plain.specific_force, repr(text))
        assert len(again) == 1


def test_cells_without_a_number_are_nan_and_text_columns_are_left_out(tmp_path):
    recording = imucal.read(
        write_text(tmp_path, f"{HEADER},part,flow\n0,,0,nan,0,0,0,a,1\n1,0,0,0,0,0,0,b,2\n")
    )
    np.testing.assert_array_equal(np.isnan(recording.specific_force), [[True, False, True], [False] * 3])
    assert list(recording.auxiliary) == ["flow"]


def test_header_alone_is_an_empty_recording(tmp_path):
    assert len(imucal.read(write_text(tmp_path, f"{HEADER}\n"))) == 0


def test_sample_rate_instead_of_time(tmp_path):
    recording = imucal.read(write_text(tmp_path, f"{IMU_COLUMNS}\n1,2,3,4,5,6\n1,2,3,4,5,6\n"), rate_hz=50)
    np.testing.assert_array_equal(recording.time_s, [0, 0.02])


# Other people's files


def own_file(tmp_path, names, columns):
    path = tmp_path / "own.csv"
    rows = np.column_stack(columns).tolist()
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows)]))
    return path


def still_samples(rows=400):
    """An accelerometer and a gyroscope at rest, with the noise of MEMS sensors; SI units."""
    noise = np.random.default_rng(8)
    force = np.array([0.3, -0.2, 9.79]) + noise.normal(scale=0.02, size=(rows, 3))
    return np.arange(rows) * 0.01, force, noise.normal(scale=1e-3, size=(rows, 3))


@pytest.mark.parametrize(
    ("names", "scales"),
    [
        (["t", "ax", "ay", "az", "gx", "gy", "gz"], (1, 1, 1)),
        (["t", "ax", "ay", "az", "gx", "gy", "gz"], (1, 1, 180 / np.pi)),
        (["time", "accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ"], (1000, 1 / 9.80665, 180 / np.pi)),
        (["timestamp_us", "xAccel", "yAccel", "zAccel", "xGyro", "yGyro", "zGyro"], (1e6, 1000 / 9.80665, 1)),
        (["t", *IMU_COLUMNS.split(",")], (1, 1, 1)),
    ],
)
def test_the_unit_that_fits_the_data_is_suggested_as_an_option_that_reads_the_file(tmp_path, names, scales):
    time_s, force, rate = still_samples()
    time = time_s * scales[0]
    path = own_file(
        tmp_path, names, [time.round() if scales[0] > 1 else time, force * scales[1], rate * scales[2]]
    )
    with pytest.raises(imucal.FormatError, match="If these are the columns and their units: ") as caught:
        imucal.read(path)
    columns = str(caught.value).split("--columns '")[1].split("'")[0]
    read = imucal.read(path, columns=columns)
    np.testing.assert_allclose(read.specific_force, force, rtol=1e-12)
    np.testing.assert_allclose(read.angular_rate, rate, rtol=1e-12)
    np.testing.assert_allclose(read.time_s, time_s, atol=1e-3 if scales[0] > 1 else 0)


def test_a_unit_that_the_data_do_not_show_is_left_to_the_user(tmp_path):
    time_s, force, rate = still_samples()
    # Noise between that of a quiet sensor in rad/s and of a quieter one in deg/s.
    path = own_file(tmp_path, ["t", "ax", "ay", "az", "gx", "gy", "gz"], [time_s, force, rate * 7])
    with pytest.raises(
        imucal.FormatError, match=r"the data do not tell which.*Give the one that is right"
    ) as caught:
        imucal.read(path)
    assert "gyro_x_dps=gx" in str(caught.value)
    assert "gyro_x_radps=gx" in str(caught.value)


@pytest.mark.parametrize(
    ("theirs", "scale"),
    [
        ("GYRO_{}_RADPS", 1),
        ("Gyr {} [rad/s]", 1),
        ("gyro_{}_rad_per_s", 1),
        ("GYRO_{}_DPS", np.pi / 180),
        ("Gyr {} (°/s)", np.pi / 180),
        ("gyro {} mdps", np.pi / 180e3),
        ("G_{} [dps]", np.pi / 180),
        ("Angular velocity {}(deg/s)", np.pi / 180),
        ("rot.rate.{} (rad/sec)", 1),
    ],
)
def test_a_header_with_all_units_is_read(tmp_path, theirs, scale):
    time_s, force, rate = still_samples()
    names = ["Time (ms)", *(f"A_{axis} [mg]" for axis in "XYZ"), *(theirs.format(axis) for axis in "XYZ")]
    path = own_file(tmp_path, names, [time_s * 1000, force / 9.80665e-3, rate / scale])
    read = imucal.read(path)
    np.testing.assert_allclose(read.specific_force, force, rtol=1e-12)
    np.testing.assert_allclose(read.angular_rate, rate, rtol=1e-12)
    (finding,) = read.findings
    assert finding.code == "read_by_header"
    assert (
        f"gyro_x_{'radps' if scale == 1 else 'dps' if scale > 1e-3 else 'mdps'}={names[4]}" in finding.message
    )


@pytest.mark.parametrize(
    "names",
    [
        ["t", "ax", "ay", "az"],
        ["a", "b", "c", "d", "e", "f", "g"],
        ["t", "mag_x", "mag_y", "mag_z", "gx", "gy", "gz"],
    ],
)
def test_nothing_is_suggested_where_columns_are_not_known(tmp_path, names):
    path = own_file(tmp_path, names, [np.arange(20), *np.ones((len(names) - 1, 20))])
    with pytest.raises(imucal.FormatError) as caught:
        imucal.read(path)
    assert "--columns '" not in str(caught.value)


def test_dates_with_a_time_of_day_count_from_the_first(tmp_path):
    path = tmp_path / "dates.csv"
    stamps = ["2026-03-01T23:59:59.990000", "2026-03-02T00:00:00", "2026-03-02T00:00:00.010000"]
    path.write_text("\n".join([HEADER, *(f"{stamp},0,0,9.8,0,0,0" for stamp in stamps)]))
    np.testing.assert_allclose(imucal.read(path).time_s, [0, 0.01, 0.02], rtol=1e-12)
    (piece,) = imucal.io.read_pieces(path)
    np.testing.assert_array_equal(piece.time_s, imucal.read(path).time_s)


def test_euroc(tmp_path):
    header = (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    row = "-0.0991347015132779,0.1473844556,0.0277507343,8.1476917083,-0.3759291508,-2.4026292187"
    text = f"{header}\n1403636579758555392,{row}\n1403636579763555584,{row}\n"
    recording = imucal.read(write_text(tmp_path, text))
    np.testing.assert_array_equal(recording.time_s, [0, 0.005000192])
    np.testing.assert_array_equal(recording.angular_rate[0], [float(x) for x in row.split(",")[:3]])
    np.testing.assert_array_equal(recording.specific_force[1], [float(x) for x in row.split(",")[3:]])


def test_imu_tk_pair_is_the_files_numbers(data_file):
    accel, gyro = data_file("xsens_mti/xsens_acc.mat"), data_file("xsens_mti/xsens_gyro.mat")
    recording = imucal.read(accel, gyro)
    truth = np.loadtxt(accel)
    np.testing.assert_array_equal(recording.time_s, truth[:, 0])
    np.testing.assert_array_equal(recording.specific_force, truth[:, 1:])
    np.testing.assert_array_equal(recording.angular_rate, np.loadtxt(gyro)[:, 1:])
    assert (recording.accel_unit, recording.gyro_unit, len(recording.sources)) == ("lsb", "lsb", 2)


@pytest.mark.parametrize(("option", "unit"), [("accel_unit", "g"), ("gyro_unit", "dps")])
def test_imu_tk_in_other_units_is_refused(tmp_path, option, unit):
    for name in ("accel.mat", "gyro.mat"):
        (tmp_path / name).write_text("0.0 1 2 3\n0.1 1 2 3\n", encoding="utf-8")
    files = [tmp_path / "accel.mat", tmp_path / "gyro.mat"]
    with pytest.raises(imucal.InputError, match=f"{option} is '{unit}': give one of"):
        imucal.read(*files, format="imu_tk", **{option: unit})


def test_imu_tk_files_of_different_time_are_resampled(tmp_path):
    accel = write_text(tmp_path, "".join(f"{i} {i} 2 3\n" for i in range(9)), "acc.mat")
    gyro = write_text(tmp_path, "".join(f"{i + 0.5} 1 2 3\n" for i in range(9)), "gyro.mat")
    recording = imucal.read(accel, gyro)
    np.testing.assert_allclose(recording.specific_force[:, 0], np.arange(8) + 0.5)
    np.testing.assert_array_equal(recording.time_s, np.arange(8))
    assert (recording.accel_unit, recording.gyro_unit) == ("lsb", "lsb")
    assert [finding.code for finding in recording.findings] == ["resampled"]


@pytest.mark.parametrize(
    ("file", "columns", "rows"),
    [
        ("mpu9150/imu0.log", IMU_COLUMNS, 15969),
        (
            "mpu6050/example_data_calibration.csv",
            IMU_COLUMNS.replace("mps2", "lsb").replace("radps", "lsb"),
            10245,
        ),
    ],
)
def test_headerless_columns_are_the_files_numbers(file, columns, rows, data_file):
    path = data_file(file)
    recording = imucal.read(path, columns=columns, rate_hz=100)
    truth = np.genfromtxt(
        path.read_text().splitlines()[-rows:], delimiter="," if file.endswith("csv") else None
    )
    np.testing.assert_array_equal(np.hstack([recording.specific_force, recording.angular_rate]), truth)


@pytest.mark.parametrize("separator", [";", "\t", " "])
@pytest.mark.parametrize("header", [True, False])
def test_decimal_commas(tmp_path, separator, header):
    rows = [[0.01 * i, 1.5, -2, 3e-5, 4, 0.25 * i, 6] for i in range(5)]
    lines = [separator.join(str(number).replace(".", ",") for number in row) for row in rows]
    names = [HEADER.replace(",", separator)] if header else []
    path = write_text(tmp_path, "\n".join([*names, *lines, ""]))
    recording = imucal.read(path, **({} if header else {"columns": HEADER}))
    np.testing.assert_array_equal(recording.time_s, [row[0] for row in rows])
    np.testing.assert_array_equal(recording.angular_rate, [row[4:] for row in rows])


def test_columns_can_be_left_out_and_reordered(data_file):
    path = data_file("ferraris/example_ferraris_session.csv")
    columns = "-,gyro_x_dps,gyro_y_dps,gyro_z_dps,accel_x_mps2,accel_y_mps2,accel_z_mps2"
    recording = imucal.read(path, columns=columns, rate_hz=102.4)
    truth = np.genfromtxt(path, delimiter=",", skip_header=1)
    np.testing.assert_array_equal(recording.specific_force, truth[:, 4:])
    np.testing.assert_allclose(recording.angular_rate, np.deg2rad(truth[:, 1:4]), rtol=4e-16)
    assert recording.auxiliary == {}


# Bad files

MISSING = HEADER.replace("accel_z_mps2", "accel_z")
BAD_FILES = {
    "no bytes": ("", imucal.FormatError, "is empty"),
    "blank": ("\n \n", imucal.FormatError, "only blank lines"),
    "binary": ("\0\1\2", imucal.FormatError, "binary"),
    "unknown columns": (
        "a,b\n1,2\n",
        imucal.FormatError,
        "format could not be determined; first line: a, b. ",
    ),
    "missing column": (
        f"{MISSING}\n{ROW}\n",
        imucal.FormatError,
        r"accel_z_\* is missing .* found: time_s, .*accel_z,",
    ),
    "no time": (f"{IMU_COLUMNS}\n1,2,3,4,5,6\n", imucal.FormatError, "time_s .* is missing.*--rate-hz"),
    "two times": (f"time_ms,{HEADER}\n0,{ROW}\n", imucal.FormatError, "2 time columns"),
    "twice": (f"{HEADER},gyro_x_radps\n{ROW},0\n", imucal.FormatError, "gyro_x_radps is given twice"),
    "two units": (f"{HEADER},gyro_x_dps\n{ROW},0\n", imucal.FormatError, "gyro_x is given twice"),
    "mixed units": (f"{HEADER.replace('y_mps2', 'y_g')}\n{ROW}\n", imucal.FormatError, "mixed"),
    "text": (
        f"{HEADER}\n{ROW}\n\n1,0,abc,0,0,0,0\n",
        imucal.FormatError,
        "line 4, column accel_y_mps2: 'abc' is not",
    ),
    "short row": (f"{HEADER}\n{ROW}\n0,0,0\n", imucal.FormatError, "line 3 has 3 values, 7 are needed"),
    "long row": (f"{HEADER}\n{ROW},1\n", imucal.FormatError, "line 2 has 8 values, 7 are needed"),
    "one of two": ("0.0 1 2 3\n", imucal.FormatError, "give both files with --format imu_tk"),
    "part of stand": (f"{HEADER},stand_1_rad\n{ROW},1\n", imucal.FormatError, r"stand_2_\* is missing"),
}


@pytest.mark.parametrize("case", BAD_FILES, ids=str)
def test_bad_csv(tmp_path, case):
    text, error, message = BAD_FILES[case]
    with pytest.raises(error, match=message) as caught:
        imucal.read(write_text(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "run.csv" in str(caught.value)


@pytest.mark.parametrize("kept", [4, 100, -1])
def test_truncated_parquet(tmp_path, kept):
    path = tmp_path / "run.parquet"
    imucal.write(random_recording(), path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(imucal.FormatError, match=r"run.parquet is a damaged or truncated Parquet file"):
        imucal.read(path)


def test_text_named_parquet(tmp_path):
    with pytest.raises(imucal.FormatError, match="is not a Parquet file"):
        imucal.read(write_text(tmp_path, f"{HEADER}\n{ROW}\n", "run.parquet"))


def test_folder_and_missing_file(tmp_path):
    with pytest.raises(imucal.InputError, match="is a folder"):
        imucal.read(tmp_path)
    with pytest.raises(imucal.InputError, match="no such file"):
        imucal.read(tmp_path / "none.csv")


@contextmanager
def ordinary_user():
    """The superuser may read and write everything, so become nobody for a while."""
    user = os.geteuid()
    os.seteuid(65534 if user == 0 else user)
    try:
        yield
    finally:
        os.seteuid(user)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes with a path are POSIX")
def test_a_pipe_is_refused_before_its_first_samples_are_lost(tmp_path):
    pipe = tmp_path / "run.csv"
    os.mkfifo(pipe)
    for read in (imucal.read, imucal.io.read_pieces):
        with pytest.raises(imucal.InputError, match=r"run\.csv is a pipe or a device: save its data to a"):
            read(pipe)


@pytest.mark.skipif(sys.platform == "win32", reason="file modes are POSIX")
def test_no_permission(tmp_path):
    path, recording = tmp_path / "run.csv", random_recording(3)
    imucal.write(recording, path)
    path.chmod(0)
    tmp_path.chmod(0o500)
    with ordinary_user():
        with pytest.raises(imucal.InputError, match="no permission"):
            imucal.read(path)
        with pytest.raises(imucal.InputError, match="cannot be written: Permission denied"):
            imucal.write(recording, tmp_path / "new.csv")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "mat"}, "unknown format 'mat'"),
        ({"format": "euroc", "rate_hz": 100}, "euroc has no option rate_hz"),
        ({"format": "columns"}, "needs column names"),
        ({"columns": "a,b,c"}, "contains no canonical name"),
        ({"rate_hz": 100}, "rate_hz is given but there is a time column time_s"),
        ({"format": "imu_tk"}, "1 files given, but a recording in the format imu_tk consists of 2"),
    ],
)
def test_options_that_do_not_fit(tmp_path, options, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.read(write_text(tmp_path, f"{HEADER}\n{ROW}\n"), **options)


def test_wrong_number_of_columns(tmp_path):
    path = write_text(tmp_path, "ax,ay\n1,2,3\n")
    with pytest.raises(imucal.FormatError, match="line 2 has 3 values but 7 columns are named"):
        imucal.read(path, columns=HEADER)


# Writing


def test_unwritable_places(tmp_path):
    recording = random_recording()
    for path, message in [
        (tmp_path / "none" / "run.csv", f"there is no folder {tmp_path / 'none'}: create it first"),
        (tmp_path / "run.xlsx", "change the extension"),
    ]:
        with pytest.raises(imucal.InputError, match=message):
            imucal.write(recording, path)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(imucal.InputError, match="it is a folder"):
        imucal.write(recording, tmp_path / "folder.csv")


def test_auxiliary_name_with_a_meaning_is_not_written(tmp_path):
    with pytest.raises(imucal.InputError, match="'temp_degc' cannot be a column name"):
        imucal.write(random_recording(3, auxiliary={"temp_degc": [1, 2, 3]}), tmp_path / "run.csv")


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, ending):
    path = tmp_path / f"run.{ending}"
    imucal.write(random_recording(10), path)
    before = path.read_bytes()
    program = f"""
        import resource, signal
        import numpy as np
        import imucal
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        noise = np.random.default_rng(0).normal(size=(5000, 3))
        try:
            imucal.write(imucal.Recording(np.arange(5000), noise, noise), {str(path)!r})
        except imucal.InputError as error:
            print(error)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True)
    assert "cannot be written: File too large" in done.stdout, done.stderr
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
def test_killed_while_writing_leaves_the_old_or_the_new_file(tmp_path):
    path = tmp_path / "run.csv"
    program = f"""
        import numpy as np
        import imucal
        first, second = (imucal.Recording(np.arange(3000), *[np.full((3000, 3), x)] * 2) for x in (1.5, 2.5))
        imucal.write(first, {str(path)!r})
        print("ready", flush=True)
        while True:
            imucal.write(first, {str(path)!r})
            imucal.write(second, {str(path)!r})
    """
    for delay in (0.02, 0.05, 0.08):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE, text=True
        )
        process.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(delay + 0.2)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        values = imucal.read(path).specific_force
        assert values.shape == (3000, 3)
        assert set(np.unique(values)) in ({1.5}, {2.5})


def test_written_file_has_the_permissions_of_an_ordinary_one(tmp_path):
    ordinary = write_text(tmp_path, "x", "ordinary")
    imucal.write(random_recording(3), tmp_path / "run.csv")
    assert (tmp_path / "run.csv").stat().st_mode == ordinary.stat().st_mode
