"""Reading of topics and messages in MCAP files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, BinaryIO

from imucal.errors import FormatError
from imucal.io.extra import library

__all__ = ["messages_of_mcap", "topics_of_mcap"]


def topics_of_mcap(file: BinaryIO) -> tuple[dict[str, str], dict[str, int]]:
    """For each topic, the message type in ROS 2 notation, and the number of messages."""
    summary = _reader(file).get_summary()
    if summary is None:
        raise ValueError("the summary at the end of the file is missing")
    counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
    types: dict[str, str] = {}
    number: dict[str, int] = {}
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        kind = channel.message_encoding if schema is None else schema.name
        # Type names of ROS 1, such as sensor_msgs/Imu, are converted to ROS 2 notation, which has /msg/.
        types[channel.topic] = kind if kind.count("/") != 1 else kind.replace("/", "/msg/")
        number[channel.topic] = number.get(channel.topic, 0) + counts.get(channel.id, 0)
    return types, number


def messages_of_mcap(file: BinaryIO, topics: Collection[str]) -> Iterator[tuple[str, int, bytes, str]]:
    """Topic, time of receipt in ns, bytes and serialisation of each message, in the order of receipt.

    Raises FormatError for messages that are not serialised as in ROS 1 (ros1) or ROS 2 (cdr).
    """
    for _, channel, message in _reader(file).iter_messages(topics=list(topics)):
        if channel.message_encoding not in ("ros1", "cdr"):
            raise FormatError(
                f"the messages of {channel.topic} are serialised as {channel.message_encoding!r}, but ros1 "
                "or cdr is needed: convert them to sensor_msgs/Imu of ROS"
            )
        yield channel.topic, message.log_time, message.data, channel.message_encoding


def _reader(file: BinaryIO) -> Any:
    file.seek(0)
    return library("mcap.reader", "ros", "MCAP files").make_reader(file, validate_crcs=True)
