"""Reads sensor_msgs/Imu messages from ROS 1 bags, ROS 2 bags (sqlite3 and MCAP storage) and MCAP files.

The message (docs.ros.org, sensor_msgs/Imu) is in m/s^2 and rad/s. A value of -1 as the first element of a
covariance means "not measured". `header.stamp` is the time at which the sample was taken. The time at which
the bag received the message is used only on request, because it contains transport delay and jitter.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from imucal.document.source import Source, first_bytes, is_folder, open_large, parsing
from imucal.errors import FormatError, InputError
from imucal.io.extra import library
from imucal.io.mcap import messages_of_mcap, topics_of_mcap
from imucal.io.starts import ROS1_MAGIC
from imucal.io.streams import Stream, recording_from_streams
from imucal.recording.recording import Recording

__all__ = ["read_mcap", "read_rosbag"]

IMU: Final = "sensor_msgs/msg/Imu"
# First element of the covariance of a quantity that was not measured.
NOT_MEASURED: Final = -1.0
# Repair commands for damaged files, for error messages.
REPAIR_BAG = "`rosbag reindex` (ROS 1) or `ros2 bag reindex` (ROS 2) may repair it, or record it again"
REPAIR_MCAP = "`mcap recover` may repair it, or record it again"
FIELDS = {"accel": "linear_acceleration", "gyro": "angular_velocity"}


@dataclass
class Samples:
    """The samples of one topic, in the order of the messages, with three numbers per triad."""

    stamp_ns: array[int] = field(default_factory=lambda: array("q"))
    accel: array[float] = field(default_factory=lambda: array("d"))
    gyro: array[float] = field(default_factory=lambda: array("d"))
    # Sensors that a message marks as not measured, by the first element of a covariance.
    absent: set[str] = field(default_factory=set)


def read_rosbag(
    path: str | os.PathLike[str], *, topic: str | None = None, receive_time: bool = False
) -> Recording:
    """Read a ROS 1 bag (.bag), a ROS 2 bag (its folder), or one file of a ROS 2 bag (.db3).

    topic         topic of the Imu messages, or "ACCEL,GYRO" if each sensor has its own topic; None if the bag
                  contains only one
    receive_time  use the time stamps of the bag instead of header.stamp

    Raises InputError if the choice of a topic is ambiguous, FormatError for invalid contents.
    """
    given = Path(path)
    name, sources = given.name or given.resolve().name, _sources(given)
    # A folder is a ROS 2 bag even if its name ends with .bag.
    is_ros1 = not is_folder(given) and (
        given.suffix.lower() == ".bag" or first_bytes(given, len(ROS1_MAGIC)) == ROS1_MAGIC
    )
    reader = library("rosbags.rosbag1" if is_ros1 else "rosbags.rosbag2", "ros", "ROS bags").Reader
    serialisation = "ros1" if is_ros1 else "cdr"
    with parsing(name, "a ROS bag", REPAIR_BAG), reader(given) as bag:
        types = {connection.topic: connection.msgtype for connection in bag.connections}
        counts = {each: bag.topics[each].msgcount for each in types}
        wanted = _topics(name, topic, types, counts)
        connections = [connection for connection in bag.connections if connection.topic in wanted]
        samples = _samples(
            wanted,
            (
                (connection.topic, received_ns, raw, serialisation)
                for connection, received_ns, raw in bag.messages(connections)
            ),
            receive_time,
        )
    return _recording(name, wanted, samples, sources)


def read_mcap(
    path: str | os.PathLike[str], *, topic: str | None = None, receive_time: bool = False
) -> Recording:
    """Read an MCAP file with ROS 1 or ROS 2 messages; arguments and errors as for `read_rosbag`."""
    name, source = Path(path).name, open_large(path)
    library("mcap.reader", "ros", "MCAP files")
    with parsing(name, "MCAP", REPAIR_MCAP), Path(path).open("rb") as file:
        types, counts = topics_of_mcap(file)
        wanted = _topics(name, topic, types, counts)
        samples = _samples(wanted, messages_of_mcap(file, wanted), receive_time)
    return _recording(name, wanted, samples, [source])


def _sources(path: Path) -> list[Source]:
    if not is_folder(path):
        return [open_large(path)]
    return [open_large(file) for file in sorted(path.iterdir()) if file.is_file()]


def _topics(name: str, given: str | None, types: dict[str, str], counts: dict[str, int]) -> list[str]:
    """The topics in `given`, or the only Imu topic; two topics are those of accelerometer and gyroscope."""
    imus = [topic for topic, kind in types.items() if kind == IMU]
    listed = ", ".join(f"{topic} ({counts[topic]} messages)" for topic in imus)
    if given is not None:
        wanted = [topic.strip() for topic in given.split(",")]
        for topic in wanted:
            if topic not in types:
                raise InputError(f"{name}: there is no topic {topic!r}; topics of {IMU}: {listed or 'none'}")
            if types[topic] != IMU:
                raise InputError(
                    f"{name}: the topic {topic} has the type {types[topic]}, expected {IMU}; topics of that "
                    f"type: {listed or 'none'}"
                )
        if len(wanted) > 2:
            raise InputError(f"{name}: {len(wanted)} topics given: give one, or two as ACCEL,GYRO")
        return wanted
    if not imus:
        others = ", ".join(f"{topic} ({kind})" for topic, kind in types.items())
        raise FormatError(
            f"{name}: no topic has the type {IMU}; found: {others or 'no topics'}: record the topic of the "
            "IMU's driver, or convert its messages to this type"
        )
    if len(imus) > 1:
        raise InputError(
            f"{name}: {len(imus)} topics have the type {IMU}: {listed}: choose one (topic=..., --topic), or "
            "two as ACCEL,GYRO if each sensor has its own topic"
        )
    return imus


def _samples(
    topics: list[str], messages: Iterable[tuple[str, int, bytes, str]], receive_time: bool
) -> dict[str, Samples]:
    """Decode messages given as topic, time of receipt in ns, bytes and serialisation."""
    samples = {topic: Samples() for topic in topics}
    decode = _decoders()
    for topic, received_ns, raw, serialisation in messages:
        message = decode[serialisation](raw, IMU)
        stamp = message.header.stamp
        into = samples[topic]
        into.stamp_ns.append(received_ns if receive_time else stamp.sec * 1_000_000_000 + stamp.nanosec)
        for sensor, which in FIELDS.items():
            vector = getattr(message, which)
            getattr(into, sensor).extend((vector.x, vector.y, vector.z))
            if getattr(message, f"{which}_covariance")[0] == NOT_MEASURED:
                into.absent.add(sensor)
    return samples


def _recording(name: str, topics: list[str], samples: dict[str, Samples], sources: list[Source]) -> Recording:
    accel, gyro = (
        _stream(name, topic, sensor, samples[topic])
        for sensor, topic in zip(FIELDS, (topics[0], topics[-1]), strict=True)
    )
    return recording_from_streams(name, accel, gyro, sources)


def _decoders() -> dict[str, Any]:
    typesys = library("rosbags.typesys", "ros", "ROS messages")
    ros1 = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    # All releases of ROS 2 have the same definition of Imu.
    ros2 = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    return {"ros1": ros1.deserialize_ros1, "cdr": ros2.deserialize_cdr}


def _stream(name: str, topic: str, sensor: str, samples: Samples) -> Stream:
    if sensor in samples.absent:
        raise FormatError(
            f"{name}: {FIELDS[sensor]} of {topic} is marked as not measured (covariance -1): if each sensor "
            "has its own topic, give both: --topic ACCEL,GYRO"
        )
    if samples.stamp_ns and not any(samples.stamp_ns):
        raise FormatError(
            f"{name}: header.stamp of {topic} is 0 in all messages, so the driver does not set it: use the "
            "bag's time stamps, which contain jitter (receive_time=True, --receive-time)"
        )
    values = np.array(getattr(samples, sensor), dtype=np.float64).reshape(-1, 3)
    return Stream(topic, np.array(samples.stamp_ns, dtype=np.int64), values)
