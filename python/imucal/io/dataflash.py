"""Reads ArduPilot dataflash logs (.bin): messages IMU, or messages ACC and GYR at the rates of the sensors.

The units are those declared in the log and in ArduPilot's list of log messages (ardupilot.org, logmessages):
m/s/s and rad/s in the body frame (front, right, down), degC, and microseconds since boot. ArduPilot has
applied its INS_* parameters and the rotation of the board, AHRS_ORIENTATION, to the samples in these
messages. AHRS_ORIENTATION is read from the messages PARM.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imucal.document.source import first_bytes, open_large, parsing
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.extra import library
from imucal.io.remarks import damaged, remark
from imucal.io.starts import DATAFLASH_MAGIC
from imucal.io.streams import Stream, median_rate_hz, recording_from_streams
from imucal.recording.recording import Recording

__all__ = ["read_dataflash"]

# Names of messages with samples. Before ArduPilot 4.1, the name contained the instance of the sensor: IMU2,
# IMU3, ACC1, ACC2, ...
MESSAGE = re.compile(r"(IMU|ACC|GYR)([1-9]?)")
ACCEL, GYRO = ("AccX", "AccY", "AccZ"), ("GyrX", "GyrY", "GyrZ")
# Type of the messages that contain parameters, and name of the parameter for the rotation of the board.
PARAMETER, ORIENTATION = "PARM", "AHRS_ORIENTATION"
# Names of the field with the sensor temperature: T, and Temp before ArduPilot 4.1.
TEMPERATURE = ("T", "Temp")
# Expected unit of each field, in the notation of FMTU messages.
UNITS = {**dict.fromkeys(ACCEL, "m/s/s"), **dict.fromkeys(GYRO, "rad/s")}


@dataclass
class Rows:
    """The values of all messages with one name and instance, in the order of the log.

    `accel` and `gyro` contain three consecutive numbers per message. All fields are arrays, because lists of
    Python numbers would need several times the memory of the file.
    """

    time_us: array[int] = field(default_factory=lambda: array("q"))
    accel: array[float] = field(default_factory=lambda: array("d"))
    gyro: array[float] = field(default_factory=lambda: array("d"))
    temperature: array[float] = field(default_factory=lambda: array("d"))

    def time_ns(self) -> Any:
        return np.array(self.time_us, dtype=np.int64) * 1000


def read_dataflash(
    path: str | os.PathLike[str], *, topic: str | None = None, instance: int | None = None
) -> Recording:
    """Read a dataflash log.

    topic     IMU, or ACC (with GYR); None if the log contains only one of these
    instance  number of the sensor, from 0; None if the log contains only one sensor

    Raises InputError if the choice is ambiguous, FormatError for invalid contents.
    """
    source, name = open_large(path), Path(path).name
    if first_bytes(path, 2) != DATAFLASH_MAGIC:
        raise FormatError(f"{name} is not a dataflash log (it does not start with A3 95): check its format")
    reader = library("pymavlink.DFReader", "ardupilot", "ArduPilot logs")
    with parsing(name, "dataflash", "download it from the flight controller again"), _complaints() as printed:
        rows, orientations = _rows(name, reader.DFReader_binary(os.fspath(path)))
    kind, number = _choose(name, rows, topic, instance)
    findings = [_corrected(name), *_rotated(name, orientations)]
    if printed.getvalue():
        findings.append(damaged(name))
    if kind == "IMU":
        imu = rows["IMU", number]
        temperature = imu.temperature if len(imu.temperature) == len(imu.time_us) else None
        accel = _stream(f"IMU {number}", imu, imu.accel, temperature)
        return recording_from_streams(
            name, accel, _stream(f"IMU {number}", imu, imu.gyro), [source], findings
        )
    of_accel, of_gyro = rows["ACC", number], rows["GYR", number]
    accel = _stream(f"ACC {number}", of_accel, of_accel.accel)
    gyro = _stream(
        f"GYR {number}", of_gyro, of_gyro.gyro, _temperature_at(of_gyro, rows.get(("IMU", number)))
    )
    return recording_from_streams(name, accel, gyro, [source], findings)


@contextlib.contextmanager
def _complaints() -> Iterator[io.StringIO]:
    """Captures the output of pymavlink, which prints a message for every damaged part that it skips."""
    printed = io.StringIO()
    # The fast indexer of pymavlink is switched off, because its messages bypass sys.stdout and could not be
    # captured.
    before = os.environ.get("PYMAVLINK_FAST_INDEX")
    os.environ["PYMAVLINK_FAST_INDEX"] = "0"
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            yield printed
    finally:
        if before is None:
            del os.environ["PYMAVLINK_FAST_INDEX"]
        else:
            os.environ["PYMAVLINK_FAST_INDEX"] = before


def _rows(name: str, log: Any) -> tuple[dict[tuple[str, int], Rows], list[int]]:
    """The samples by kind of message and instance, and all values of AHRS_ORIENTATION, in log order."""
    rows: dict[tuple[str, int], Rows] = {}
    orientations: list[int] = []
    kinds = [message for message in log.name_to_id if MESSAGE.fullmatch(message)]
    if kinds and PARAMETER in log.name_to_id:
        kinds.append(PARAMETER)
    while kinds and (message := log.recv_match(type=kinds)) is not None:
        if message.get_type() == PARAMETER:
            if message.Name == ORIENTATION:
                orientations.append(int(message.Value))
            continue
        match = MESSAGE.fullmatch(message.get_type())
        assert match is not None
        columns = message.fmt.columns
        number = message.I if "I" in columns else int(match[2] or 1) - 1
        key = match[1], number
        if key not in rows:
            _require_units(name, message.fmt)
            rows[key] = Rows()
        into = rows[key]
        # ACC and GYR messages contain the time of sampling (SampleUS) besides the time of logging (TimeUS).
        into.time_us.append(message.SampleUS if "SampleUS" in columns else message.TimeUS)
        if "AccX" in columns:
            into.accel.extend(getattr(message, axis) for axis in ACCEL)
        if "GyrX" in columns:
            into.gyro.extend(getattr(message, axis) for axis in GYRO)
        for column in TEMPERATURE:
            if column in columns:
                into.temperature.append(getattr(message, column))
    return rows, orientations


def _require_units(name: str, fmt: Any) -> None:
    for axis, unit in UNITS.items():
        declared = fmt.get_unit(axis) if axis in fmt.columns else ""
        if declared not in ("", unit):
            raise FormatError(
                f"{name}: {fmt.name}.{axis} is in {declared}, expected {unit}: convert it first"
            )


def _choose(
    name: str, rows: dict[tuple[str, int], Rows], topic: str | None, instance: int | None
) -> tuple[str, int]:
    choices = [
        (kind, number)
        for kind, number in sorted(rows)
        if kind == "IMU" or (kind == "ACC" and ("GYR", number) in rows)
    ]
    if not choices:
        found = ", ".join(f"{kind} {number}" for kind, number in rows)
        raise FormatError(
            f"{name} contains neither IMU nor ACC with GYR; found of these: {found or 'none'}: set the IMU "
            "bit of LOG_BITMASK, or INS_RAW_LOG_OPT, and record again"
        )
    wanted = "ACC" if topic == "GYR" else topic
    fitting = [c for c in choices if wanted in (None, c[0]) and instance in (None, c[1])]
    listed = "; ".join(
        f"--topic {kind} --instance {number} ({median_rate_hz(rows[kind, number].time_ns()):.6g} Hz)"
        for kind, number in choices
    )
    if not fitting:
        asked = " ".join(str(each) for each in (topic, instance) if each is not None)
        raise InputError(f"{name}: there is no {asked}; found: {listed}")
    if len(fitting) > 1:
        raise InputError(f"{name} contains {len(choices)} sensors: choose one: {listed}")
    return fitting[0]


def _stream(what: str, rows: Rows, values: Sequence[float], temperature_degc: Any = None) -> Stream:
    temperature = None if temperature_degc is None else np.asarray(temperature_degc, dtype=np.float64)
    return Stream(what, rows.time_ns(), np.array(values, dtype=np.float64).reshape(-1, 3), temperature)


def _temperature_at(rows: Rows, imu: Rows | None) -> Any:
    """Temperature from the slower IMU messages of the same sensor, interpolated to the times of `rows`."""
    if imu is None or len(imu.temperature) != len(imu.time_us):
        return None
    return np.interp(rows.time_us, imu.time_us, imu.temperature)


def _corrected(name: str) -> Finding:
    return remark(
        name,
        "already_corrected",
        "ArduPilot has applied its calibration parameters (INS_*) to the logged samples",
        "a calibration of this recording adds to these parameters and does not replace them; for a "
        "calibration that replaces them, set them to neutral values before recording (offsets 0, scales 1, "
        "INS_GYR_CAL 0)",
    )


def _rotated(name: str, orientations: Sequence[int]) -> list[Finding]:
    """A finding if the board was rotated at any time during the log."""
    values = list(dict.fromkeys(orientations))
    if not any(values):
        return []
    listed = ", then ".join(map(str, values))
    return [
        remark(
            name,
            "board_rotated",
            f"{ORIENTATION} is {listed}: ArduPilot has rotated the logged samples from the axes of the "
            "sensor to the axes of the vehicle",
            "a calibration of this recording is along the axes of the vehicle; ArduPilot's parameters "
            f"apply before the rotation, so export with --board-orientation {values[-1]}"
            if len(values) == 1
            else "record again without a change of this parameter",
        )
    ]
