"""Arrays with names: MATLAB, HDF5, NumPy and Parquet files, each written by its own library."""

import struct
import zipfile

import h5py
import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from pyarrow import parquet

import imucal
from array_files import ARRAY_WRITERS, canonical, hdf5


def assert_is(recording, known, *, is_counted=True):
    time_s = (known.time_ns - known.time_ns[0]) / 1e9 if is_counted else known.time_ns / 1e9
    np.testing.assert_array_equal(recording.time_s, time_s)
    np.testing.assert_array_equal(recording.specific_force, known.accel)
    np.testing.assert_array_equal(recording.angular_rate, known.gyro)


@pytest.mark.parametrize("name", ARRAY_WRITERS)
def test_arrays_with_canonical_names_are_found(tmp_path, known, name):
    ARRAY_WRITERS[name](tmp_path / name, known)
    recording = imucal.read(tmp_path / name)
    assert_is(recording, known)
    np.testing.assert_array_equal(recording.temperature_degc, known.temperature)
    assert recording.auxiliary == {}
    assert recording.name == name


@pytest.mark.parametrize(("order", "kind"), [("<", 0), (">", 1000)])
def test_matlab_version_4_is_recognised_by_its_name(tmp_path, known, order, kind):
    # Five 32-bit integers, the name, and the numbers by column: MAT-File Format, "Level 4 MAT-File Format".
    arrays = {**canonical(known), "time_s": known.time_ns / 1e9}
    del arrays["time_ns"]
    written = b""
    for name, array in arrays.items():
        rows, columns = len(array), array.size // len(array)
        written += struct.pack(f"{order}5i", kind, rows, columns, 0, len(name) + 1) + name.encode() + b"\0"
        written += array.T.astype(f"{order}f8").tobytes()
    (tmp_path / "v4.mat").write_bytes(written)
    assert_is(imucal.read(tmp_path / "v4.mat"), known, is_counted=False)
    (tmp_path / "v4").write_bytes(written)
    assert_is(imucal.read(tmp_path / "v4", format="matlab"), known, is_counted=False)


def test_columns_groups_and_structured_arrays(tmp_path, known):
    names = ["time_ns", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz"), "fan_rpm"]
    rows = np.zeros(len(known.time_ns), dtype=[(name, "i8" if name == "time_ns" else "f8") for name in names])
    rows["time_ns"] = known.time_ns
    rows["fan_rpm"] = np.arange(len(rows))
    for i, axis in enumerate("xyz"):
        rows[f"accel_{axis}_mps2"], rows[f"gyro_{axis}_radps"] = known.accel[:, i], known.gyro[:, i]
    np.save(tmp_path / "rows.npy", rows)
    with h5py.File(tmp_path / "rows.h5", "w") as file:
        file["imu/rows"] = rows
    for name in ("rows.npy", "rows.h5"):
        recording = imucal.read(tmp_path / name)
        assert_is(recording, known)
        np.testing.assert_array_equal(recording.auxiliary["fan_rpm"], rows["fan_rpm"])


def test_two_groups_are_listed_and_chosen(tmp_path, known):
    path = tmp_path / "run.h5"
    hdf5(path, known, "unit_1")
    hdf5(path, known, "unit_2")
    with pytest.raises(imucal.InputError, match=r"2 groups contain a recording: unit_1, unit_2: .*--group"):
        imucal.read(path)
    assert_is(imucal.read(path, group="unit_2"), known)
    with pytest.raises(imucal.InputError, match=r"no group 'unit_3': give one of unit_1, unit_2"):
        imucal.read(path, group="unit_3")


@pytest.mark.parametrize("separator", ["/", "."])
def test_other_names_are_mapped(tmp_path, known, separator):
    force, rate = known.accel / 9.80665, np.degrees(known.gyro)
    columns = f"time_s=imu{separator}t, accel_g=imu{separator}acc, gyro_dps=imu{separator}gyr"
    time_s = known.time_ns / 1e9
    if separator == "/":
        path = tmp_path / "run.h5"
        with h5py.File(path, "w") as file:
            file["imu/t"], file["imu/acc"], file["imu/gyr"] = time_s, force, rate.T
    else:
        path = tmp_path / "run.mat"
        scipy.io.savemat(path, {"imu": {"t": time_s, "acc": force, "gyr": rate.T}})
    recording = imucal.read(path, columns=columns)
    np.testing.assert_array_equal(recording.time_s, time_s)
    np.testing.assert_allclose(recording.specific_force, known.accel, rtol=3e-16)
    np.testing.assert_allclose(recording.angular_rate, known.gyro, rtol=5e-16)
    with pytest.raises(imucal.InputError, match=r"no array 'imu.acce'; found: .*imu.acc \(400, 3\)"):
        imucal.read(path, columns=columns.replace("acc,", "acce,"))


@pytest.mark.parametrize("is_transposed", [False, True])
def test_one_array_with_a_name_for_every_column(tmp_path, known, is_transposed):
    rows = np.column_stack([known.accel, known.gyro, np.zeros(len(known.accel))])
    np.save(tmp_path / "rows.npy", rows.T if is_transposed else rows)
    names = ",".join([*(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz"), "-"])
    recording = imucal.read(tmp_path / "rows.npy", columns=names, rate_hz=100)
    np.testing.assert_array_equal(recording.specific_force, known.accel)
    np.testing.assert_array_equal(recording.angular_rate, known.gyro)
    assert recording.auxiliary == {}
    with pytest.raises(imucal.FormatError, match=r"without names: name every column"):
        imucal.read(tmp_path / "rows.npy")
    with pytest.raises(imucal.InputError, match=r"6 columns are named, but no array has as many"):
        imucal.read(tmp_path / "rows.npy", columns=names.removesuffix(",-"))
    with pytest.raises(imucal.FormatError, match=r"accel_x_mps2 is given twice"):
        imucal.read(tmp_path / "rows.npy", columns=names.removesuffix("-") + "accel_x_mps2", rate_hz=100)


@pytest.mark.slow
def test_examples_run_as_printed(tmp_path, known, example_of):
    np.savez(tmp_path / "run.npz", **canonical(known))
    hdf5(tmp_path / "run.h5", known, "unit_1")
    hdf5(tmp_path / "run.h5", known, "unit_2")
    struct = {"t": known.time_ns / 1e9, "acc": known.accel, "gyr": np.degrees(known.gyro)}
    scipy.io.savemat(tmp_path / "run.mat", {"imu": struct})
    parquet.write_table(
        pa.table(
            {
                "time_ns": known.time_ns,
                **{f"accel_{a}_mps2": known.accel[:, i] for i, a in enumerate("xyz")},
                **{f"gyro_{a}_radps": known.gyro[:, i] for i, a in enumerate("xyz")},
            }
        ),
        tmp_path / "run.parquet",
    )
    for format in ("numpy", "hdf5", "parquet"):
        assert_is(example_of(format), known)
    np.testing.assert_allclose(example_of("matlab").angular_rate, known.gyro, rtol=5e-16)


def bad(known, **changes):
    return {name: array for name, array in (canonical(known) | changes).items() if array is not None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"gyro_radps": None},
            r"no arrays with names like accel_mps2 and gyro_radps.*found: time_ns \(400,\)",
        ),
        ({"gyro_radps": np.zeros((399, 3))}, "gyro_x_radps has 399 samples but time_ns has 400"),
        ({"time_ns": None}, "time_s .* is missing.*rate_hz"),
        ({"gyro_radps": np.zeros((400, 4))}, r"gyro_radps has the shape \(400, 4\), \(N, 3\) is needed"),
        ({"gyro_radps": np.zeros((400, 3), complex)}, "gyro_radps has elements of type complex128"),
        ({"temp_degc": np.zeros((20, 20))}, r"temp_degc has the shape \(20, 20\), \(N,\) is needed"),
        ({"accel_x_mps2": np.zeros(400)}, "accel_x_mps2 is given twice"),
    ],
)
def test_bad_arrays_are_named(tmp_path, known, changes, message):
    np.savez(tmp_path / "run.npz", **bad(known, **changes))
    with pytest.raises(imucal.FormatError, match=message) as caught:
        imucal.read(tmp_path / "run.npz")
    assert "run.npz" in str(caught.value)


def test_nan_is_kept_for_the_checks(tmp_path, known):
    gyro = known.gyro.copy()
    gyro[7, 1] = np.nan
    np.savez(tmp_path / "run.npz", **bad(known, gyro_radps=gyro))
    np.testing.assert_array_equal(imucal.read(tmp_path / "run.npz").angular_rate, gyro)


@pytest.mark.parametrize("name", ARRAY_WRITERS)
@pytest.mark.parametrize("kept", [0, 12, 600, 0.7])
def test_truncated_files_are_named(tmp_path, known, name, kept):
    path = tmp_path / name
    ARRAY_WRITERS[name](path, known)
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(imucal.FormatError, match=name) as caught:
        imucal.read(path)
    assert "\n" not in str(caught.value)


def test_pickled_objects_are_refused(tmp_path):
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(imucal.FormatError, match=r"objects.npy .*pickled.*save plain arrays"):
        imucal.read(tmp_path / "objects.npy")


def test_archive_without_arrays_and_array_without_dimension(tmp_path, known):
    with zipfile.ZipFile(tmp_path / "sheet.xlsx", "w") as archive:
        archive.writestr("sheet.xml", "<sheet/>")
    with pytest.raises(
        imucal.FormatError, match=r"sheet.xlsx is a spreadsheet .*: open it and save the sheet as CSV"
    ):
        imucal.read(tmp_path / "sheet.xlsx")
    np.savez(tmp_path / "run.npz", rate=50.0, **canonical(known))
    assert_is(imucal.read(tmp_path / "run.npz"), known)
    np.savez(tmp_path / "run.npz", **bad(known, temp_degc=np.array(20.0)))
    with pytest.raises(imucal.FormatError, match=r"temp_degc has the shape \(\), \(N,\) is needed"):
        imucal.read(tmp_path / "run.npz")


@pytest.mark.slow
def test_columns_of_a_csv_with_other_names(tmp_path, example_of):
    (tmp_path / "other.csv").write_text(
        "t,ax,ay,az,gx,gy,gz,note\n"
        + "".join(f"{10 * i},0,0,{1 + i % 2 / 500},1,{i % 3 / 10},3,a\n" for i in range(600))
    )
    recording = example_of("csv")
    np.testing.assert_array_equal(recording.time_s, np.arange(600) * 10 / 1e3)
    np.testing.assert_array_equal(recording.specific_force[0], [0, 0, 9.80665])
    np.testing.assert_allclose(recording.angular_rate[1], np.radians([1, 0.1, 3]), rtol=3e-16)
    with pytest.raises(imucal.InputError, match=r"no column 'nil'; found: t, ax"):
        imucal.read("other.csv", columns="time_s=nil")
    with pytest.raises(imucal.InputError, match=r"'ax' without a partner"):
        imucal.read("other.csv", columns="time_s=t,ax")
    with pytest.raises(imucal.InputError, match=r"contains time_s twice"):
        imucal.read("other.csv", columns="time_s=t,time_s=ax")


def mat_element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def test_a_matlab_timetable_is_named_with_the_export_to_choose(tmp_path):
    # An object as MATLAB stores it: flags with class 17, name, class system, class name, and references.
    references = b"".join(
        (
            mat_element(6, struct.pack("<II", 13, 0)),
            mat_element(5, struct.pack("<ii", 6, 1)),
            mat_element(1, b""),
            mat_element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)),
        )
    )
    flags = mat_element(6, struct.pack("<II", 17, 0))
    names = b"".join(mat_element(1, word) for word in (b"Acceleration", b"MCOS", b"timetable"))
    header = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "phone.mat").write_bytes(
        header + mat_element(14, flags + names + mat_element(14, references))
    )
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        file["Acceleration"] = np.zeros((1, 6), np.uint32)
        file["#subsystem#/MCOS"] = np.zeros((1, 3), np.uint32)
    with (tmp_path / "new.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    for name in ("phone.mat", "new.mat"):
        with pytest.raises(imucal.FormatError, match=r"timetables .*writetimetable\(tt, 'run.csv'\)"):
            imucal.read(tmp_path / name)
