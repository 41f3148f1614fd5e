"""Reads PX4 ULog files: the messages sensor_accel and sensor_gyro, or the message sensor_combined.

Units and frames follow PX4's message definitions (docs.px4.io, msg_docs): m/s^2 and rad/s in the board's
frame (front, right, down), degC, and microseconds since boot. sensor_accel and sensor_gyro contain
uncorrected samples. sensor_combined is "scaled and offset-compensated": PX4 has applied its CAL_* parameters
to these samples.
"""

from __future__ import annotations

import contextlib
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucal.document.source import open_large, parsing
from imucal.errors import FormatError, InputError
from imucal.io.extra import library
from imucal.io.remarks import corrected_by_px4, damaged
from imucal.io.streams import Stream, median_rate_hz, recording_from_streams
from imucal.recording.recording import Recording

__all__ = ["read_ulog"]

NEEDED = "sensor_accel with sensor_gyro, or sensor_combined"
# Value of accelerometer_timestamp_relative in a sensor_combined message without an accelerometer sample.
INVALID_RELATIVE_TIME = 0x7FFFFFFF


@dataclass(frozen=True)
class Choice:
    """A possible source of both sensors in a log; `datasets` are objects of pyulog."""

    topic: str
    instance: int
    datasets: tuple[Any, ...]

    def __str__(self) -> str:
        rates = " and ".join(f"{median_rate_hz(_time_ns(each.data)):.6g} Hz" for each in self.datasets)
        what = "corrected by PX4" if self.topic == "sensor_combined" else "uncorrected"
        return f"--topic {self.topic} --instance {self.instance} ({rates}, {what})"


def read_ulog(
    path: str | os.PathLike[str], *, topic: str | None = None, instance: int | None = None
) -> Recording:
    """Read a ULog file.

    topic     sensor_accel (with sensor_gyro) or sensor_combined; None if the log contains only one of these
    instance  number of the sensor, from 0; None if the log contains only one sensor

    Raises InputError if the choice is ambiguous, FormatError for invalid contents.
    """
    source, name = open_large(path), Path(path).name
    pyulog = library("pyulog", "px4", "PX4 logs")
    # The messages of pyulog about damage are suppressed, because the finding `file_damaged` reports it.
    with (
        parsing(name, "ULog", "download it from the flight controller again"),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        log = pyulog.ULog(os.fspath(path), ["sensor_accel", "sensor_gyro", "sensor_combined"])
    choice = _choose(name, log.data_list, topic, instance)
    findings = [damaged(name)] if log.file_corruption else []
    if choice.topic == "sensor_combined":
        accel, gyro = _combined(name, choice.datasets[0].data)
        findings.append(corrected_by_px4(name))
    else:
        accel, gyro = (_stream(name, each) for each in choice.datasets)
    return recording_from_streams(name, accel, gyro, [source], findings)


def _choose(name: str, datasets: list[Any], topic: str | None, instance: int | None) -> Choice:
    by_key = {(each.name, each.multi_id): each for each in datasets}
    choices = []
    for (message, number), each in sorted(by_key.items()):
        if message == "sensor_combined":
            choices.append(Choice(message, number, (each,)))
        elif message == "sensor_accel" and ("sensor_gyro", number) in by_key:
            choices.append(Choice(message, number, (each, by_key["sensor_gyro", number])))
    if not choices:
        found = ", ".join(f"{message} {number}" for message, number in by_key)
        raise FormatError(
            f"{name} contains neither {NEEDED}; found of these: {found or 'none'}: log them (SDLOG_PROFILE, "
            "or a file logger_topics.txt on the card)"
        )
    # sensor_accel and sensor_gyro are one source, named sensor_accel, which the topic sensor_gyro also
    # selects.
    wanted = "sensor_accel" if topic == "sensor_gyro" else topic
    fitting = [c for c in choices if wanted in (None, c.topic) and instance in (None, c.instance)]
    listed = "; ".join(map(str, choices))
    if not fitting:
        asked = " ".join(str(each) for each in (topic, instance) if each is not None)
        raise InputError(f"{name}: there is no {asked}; found: {listed}")
    if len(fitting) > 1:
        raise InputError(f"{name} contains {len(choices)} sensors: choose one: {listed}")
    return fitting[0]


def _time_ns(data: Any) -> Any:
    # The time of sampling if the log contains it, otherwise the time of publication.
    stamps = data.get("timestamp_sample")
    return (data["timestamp"] if stamps is None or not stamps.any() else stamps).astype(np.int64) * 1000


def _stream(name: str, dataset: Any) -> Stream:
    data = dataset.data
    values = np.stack([_field(name, dataset.name, data, axis) for axis in "xyz"], axis=1)
    temperature = data.get("temperature")
    return Stream(
        f"{dataset.name} {dataset.multi_id}",
        _time_ns(data),
        values.astype(np.float64),
        None if temperature is None else temperature.astype(np.float64),
    )


def _combined(name: str, data: Any) -> tuple[Stream, Stream]:
    accel, gyro = (
        np.stack([_field(name, "sensor_combined", data, f"{which}[{i}]") for i in range(3)], axis=1)
        for which in ("accelerometer_m_s2", "gyro_rad")
    )
    time_ns = data["timestamp"].astype(np.int64) * 1000
    relative_us = _field(name, "sensor_combined", data, "accelerometer_timestamp_relative").astype(np.int64)
    is_valid = relative_us != INVALID_RELATIVE_TIME
    return (
        Stream(
            "sensor_combined accelerometer_m_s2",
            (time_ns + relative_us * 1000)[is_valid],
            accel[is_valid].astype(np.float64),
        ),
        Stream("sensor_combined gyro_rad", time_ns, gyro.astype(np.float64)),
    )


def _field(name: str, message: str, data: Any, field: str) -> Any:
    if field not in data:
        raise FormatError(
            f"{name}: {message} has no field {field}; found: {', '.join(data)}: the PX4 version of this log "
            "is not supported, convert it with another program"
        )
    return data[field]
