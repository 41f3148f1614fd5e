"""Valid small files of every format that imucal reads, and of every JSON document: what is damaged."""

import functools
import json
import operator
import sqlite3
import zipfile
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
from pyarrow import parquet

import imucal
from array_files import ARRAY_WRITERS
from log_files import dataflash, imu, pair, ulog
from ros_files import ROS_WRITERS, messages

CORPUS = Path(__file__).with_name("corpus")
LIMITS = {
    "schema": "imucal.limits/1",
    "parameters": {"gyro_bias_*": {"unit": "rad/s", "min": -0.1, "max": 0.1, "max_std": 0.01}},
    "control_set": {"chi2_per_dof": {"max": 2}},
    "effects": [],
}


@dataclass(frozen=True)
class Seed:
    """A valid file; `kind` is a format of `imucal.io.FORMATS`, or document.

    damaged  the file that is damaged; it differs from `path` in a folder
    """

    name: str
    kind: str
    path: Path
    options: dict = field(default_factory=dict)
    damaged: Path | None = None

    @property
    def is_json(self):
        return self.kind in ("json", "document")

    @property
    def is_text(self):
        return self.path.suffix != ".zip" and self.kind in (
            "csv",
            "columns",
            "euroc",
            "imu_tk",
            "pair",
            "folder",
            "labels",
            "vectornav",
            "realsense",
            "rows",
            "json",
            "document",
        )


def short_run(rows=60):
    """A unit at rest for a second."""
    chance = np.random.default_rng(5)
    accel = np.array([0.5, -0.25, 9.75]) + chance.normal(scale=0.02, size=(rows, 3))
    gyro = np.array([0.01, -0.02, 0.03]) + chance.normal(scale=0.002, size=(rows, 3))
    return SimpleNamespace(
        time_ns=1_700_000_000_000_000_000 + np.arange(rows) * 20_000_000,
        accel=accel.astype(np.float32).astype(np.float64),
        gyro=gyro.astype(np.float32).astype(np.float64),
        temperature=25 + 0.001 * np.arange(rows),
    )


def seeds(folder):
    """Write all seeds to a folder."""
    return [*_text(folder), *_tables(folder), *_bags_and_logs(folder), *_documents(folder), *_found_before()]


def _text(folder):
    known = short_run()
    time_s = (known.time_ns - known.time_ns[0]) / 1e9
    table = np.column_stack([time_s, known.accel, known.gyro, known.temperature])
    names = [
        "time_s",
        *(f"accel_{axis}_mps2" for axis in "xyz"),
        *(f"gyro_{axis}_radps" for axis in "xyz"),
        "temp_degc",
    ]
    csv = folder / "run.csv"
    np.savetxt(csv, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    yield Seed("csv", "csv", csv)
    np.savetxt(folder / "run.txt", table, fmt="%.9g")
    yield Seed("columns", "columns", folder / "run.txt", {"columns": ",".join(names)})
    euroc = ["#timestamp [ns]", *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz")]
    euroc += [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
    rows = [
        ",".join(map(str, [stamp, *gyro, *accel]))
        for stamp, gyro, accel in zip(known.time_ns, known.gyro, known.accel, strict=True)
    ]
    (folder / "data.csv").write_text("\n".join([",".join(euroc), *rows]))
    yield Seed("euroc", "euroc", folder / "data.csv")
    for name, values in (("acc.mat", known.accel), ("gyr.mat", known.gyro)):
        np.savetxt(folder / name, np.column_stack([time_s, 1000 * values]), fmt="%.9g")
    yield Seed("imu_tk", "imu_tk", folder / "acc.mat", {"second": folder / "gyr.mat"})
    yield from _one_file_per_sensor(folder, known, time_s)
    yield from _one_table_per_sensor(folder, known, time_s)
    yield from _lines(folder, known, time_s)


def _one_file_per_sensor(folder, known, time_s):
    """Two text files, and a folder and a zip archive of them."""
    phone = folder / "phone"
    phone.mkdir()
    for name, values, unit in (("Accelerometer", known.accel, "m/s^2"), ("Gyroscope", known.gyro, "rad/s")):
        header = ",".join(["time (s)", *(f"{axis} ({unit})" for axis in "xyz")])
        # The gyroscope is late, so that it is resampled.
        stamps = time_s + 0.005 * (name == "Gyroscope")
        for path in (folder / f"{name}.csv", phone / f"{name}.csv"):
            table = np.column_stack([stamps, values])
            np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    first, second = folder / "Accelerometer.csv", folder / "Gyroscope.csv"
    yield Seed("pair", "pair", first, {"second": second})
    yield Seed("pair, second", "pair", second, {"second": first})
    yield Seed("folder", "folder", phone, damaged=phone / "Gyroscope.csv")
    with zipfile.ZipFile(folder / "phone.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(phone.iterdir()):
            archive.write(path, path.name)
    # The bytes of an archive are not text.
    yield Seed("zip", "folder", folder / "phone.zip")


def _one_table_per_sensor(folder, known, time_s):
    """A table with the name of the sensor in each row, a database, JSON objects and JSON columns."""
    tables = {"accelerometer": known.accel, "gyroscope": known.gyro}
    rows = [
        [name, stamp, *(round(float(number), 6) for number in triad)]
        for name, values in tables.items()
        for stamp, triad in zip(time_s.tolist(), values, strict=True)
    ]
    lines = [",".join(map(str, row)) for row in [["sensor", "time_s", "x", "y", "z"], *rows]]
    (folder / "rows.csv").write_text("\n".join(lines) + "\n")
    options = {"accel_unit": "m/s^2", "gyro_unit": "rad/s"}
    yield Seed("rows", "rows", folder / "rows.csv", options)
    with closing(sqlite3.connect(folder / "phone.sqlite")) as database, database:
        for name in tables:
            database.execute(f"CREATE TABLE {name} (time_s REAL, x REAL, y REAL, z REAL)")
            own = [row[1:] for row in rows if row[0] == name]
            database.executemany(f"INSERT INTO {name} VALUES (?, ?, ?, ?)", own)
    yield Seed("sqlite", "sqlite", folder / "phone.sqlite", options)
    objects = [{"sensor": name, "time_s": stamp, "values": triad} for name, stamp, *triad in rows]
    (folder / "rows.json").write_text(json.dumps(objects))
    yield Seed("json, objects", "json", folder / "rows.json", options)
    columns = {name: values.round(6).tolist() for name, values in tables.items()}
    (folder / "columns.json").write_text(json.dumps({"time_s": time_s.tolist(), **columns}))
    names = [
        "time_s=time_s",
        *(f"accel_{axis}_mps2=accelerometer.{axis}" for axis in "xyz"),
        *(f"gyro_{axis}_radps=gyroscope.{axis}" for axis in "xyz"),
    ]
    yield Seed("json, columns", "json", folder / "columns.json", {"columns": ",".join(names)})


def _lines(folder, known, time_s):
    """Lines of `label:value`, sentences with a check sum, and the lines of a RealSense camera."""
    values = np.column_stack([time_s, known.accel, known.gyro])
    labels = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
    rows = (" ".join(f"{n}:{v:.6g}" for n, v in zip(labels, row, strict=True)) for row in values)
    (folder / "plotter.txt").write_text("\n".join(rows) + "\n")
    yield Seed("labels", "labels", folder / "plotter.txt")
    sentences = []
    for accel, gyro in zip(known.accel, known.gyro, strict=True):
        body = "VNYMR," + ",".join(f"{v:+.6f}" for v in (*np.zeros(3), *np.ones(3), *accel, *gyro))
        check = functools.reduce(operator.xor, body.encode())
        sentences.append(f"${body}*{check:02X}")
    (folder / "vn.txt").write_text("\r\n".join(sentences) + "\r\n")
    yield Seed("vectornav", "vectornav", folder / "vn.txt", {"rate_hz": 50.0})
    head = "Stream Type,F#,HW Timestamp (ms),Backend Timestamp(ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z"
    lines = []
    for kind, triad in (("Accel", known.accel), ("Gyro", known.gyro)):
        stamps = [f"{stamp:.3f}" for stamp in 1e9 + 1000 * time_s]
        each = enumerate(zip(stamps, triad, strict=True))
        lines += ["", head]
        lines += [f"{kind},{i},{ms},{ms},{ms},{x:.6g},{y:.6g},{z:.6g}" for i, (ms, (x, y, z)) in each]
    (folder / "imu_pose.csv").write_text("\n".join(lines) + "\n")
    yield Seed("realsense", "realsense", folder / "imu_pose.csv")


def _packets(folder, known):
    """Packets of WitMotion: 0x55, kind, eight bytes and their sum; ranges of 16 g and 2000 deg/s."""
    written = b""
    for accel, gyro in zip(known.accel, known.gyro, strict=True):
        for kind, values in ((0x51, accel / 9.80665 / 16), (0x52, np.degrees(gyro) / 2000)):
            words = np.append(np.round(values * 32768), 2500).astype("<i2")
            body = bytes([0x55, kind]) + words.tobytes()
            written += body + bytes([sum(body) & 0xFF])
    (folder / "wt901.bin").write_bytes(written)
    yield Seed("witmotion", "witmotion", folder / "wt901.bin", {"rate_hz": 50.0})


def _tables(folder):
    known = short_run()
    for name, write in ARRAY_WRITERS.items():
        write(folder / name, known)
        kind = {".npz": "numpy", ".h5": "hdf5", ".mat": "matlab"}[Path(name).suffix]
        yield Seed(name, kind, folder / name)
    names = ["time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz")]
    columns = [(known.time_ns - known.time_ns[0]) / 1e9, *known.accel.T, *known.gyro.T]
    table = pa.table(columns, names=names)
    for name, settings in {
        "snappy.parquet": {},
        "plain.parquet": {"compression": "none", "use_dictionary": False, "data_page_version": "2.0"},
    }.items():
        parquet.write_table(table, folder / name, **settings)
        yield Seed(name, "parquet", folder / name)
    # Columns of sensor_msgs/Imu, whose time stamps are in two columns.
    stamp = {"header.stamp.sec": known.time_ns // 10**9, "header.stamp.nanosec": known.time_ns % 10**9}
    for what, values in (("angular_velocity", known.gyro), ("linear_acceleration", known.accel)):
        stamp |= {f"{what}.{axis}": values[:, i] for i, axis in enumerate("xyz")}
    parquet.write_table(pa.table(stamp), folder / "stamps.parquet")
    yield Seed("stamps.parquet", "parquet", folder / "stamps.parquet")
    kinds = [("time_s", "f8"), ("accel_mps2", "f4", 3), ("gyro_radps", "f4", 3)]
    rows = np.empty(60, dtype=kinds)
    rows["time_s"], rows["accel_mps2"], rows["gyro_radps"] = columns[0], known.accel, known.gyro
    np.save(folder / "run.npy", rows)
    yield Seed("run.npy", "numpy", folder / "run.npy")


def _bags_and_logs(folder):
    known = short_run()
    for name, (write, store) in ROS_WRITERS.items():
        path = folder / name
        write(path, {"/imu/data": messages(known, store)})
        if not path.is_dir():
            yield Seed(name, "mcap" if path.suffix == ".mcap" else "rosbag", path)
            continue
        for file in sorted(path.iterdir()):
            yield Seed(f"{name}/{file.suffix}", "rosbag", path, damaged=file)
    ulog(folder / "flight.ulg", *pair(known))
    yield Seed("ulog", "ulog", folder / "flight.ulg")
    dataflash(folder / "flight.bin", ["IMU"], imu(known))
    yield Seed("dataflash", "dataflash", folder / "flight.bin")
    yield from _packets(folder, known)


def _documents(folder):
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    documents = {
        "calibration": lambda path: imucal.Calibration(triad, triad).save(path),
        "program": lambda path: imucal.Program.random(seed=1, moves=5).write(path),
        "stand": lambda path: imucal.Stand.cheap(1).write(path),
        "stand_limits": lambda path: imucal.StandLimits().write(path),
        "unit": lambda path: imucal.Unit.named("bmi088").write(path),
        "limits": lambda path: path.write_text(json.dumps(LIMITS)),
    }
    for name, save in documents.items():
        path = folder / f"{name}.json"
        save(path)
        yield Seed(name, "document", path, {"load": name})


def _found_before():
    """Files on which an earlier version crashed, hung or took gigabytes."""
    kinds = {".bin": "dataflash", ".h5": "hdf5", ".mat": "matlab", ".mcap": "mcap", ".ulg": "ulog"}
    for path in sorted(CORPUS.iterdir()):
        yield Seed(path.name, kinds.get(path.suffix, path.suffix[1:]), path)
