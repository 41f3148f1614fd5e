"""Creation of the source of a unit's samples from its address and the format of its data."""

from __future__ import annotations

import os

import numpy as np

from imucal.errors import InputError
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.lines import LineDecoder
from imucal.stand.link import Link, link_to
from imucal.stand.packet import PacketDecoder, PacketFormat
from imucal.stand.phone import phone_link
from imucal.stand.phone_messages import PhoneDecoder
from imucal.stand.ros_topic import TEMPLATE, RosTopic
from imucal.stand.rows import recording_of
from imucal.stand.stream import Decoder, StreamSource

__all__ = ["unit_source"]

PHONE = ("http://", "phyphox://")
ROS = "ros2://"


def unit_source(
    address: str,
    *,
    baud: int,
    columns: str | None = None,
    packet: str | os.PathLike[str] | None = None,
    rate_hz: float | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> StreamSource:
    """The source at an address.

    address  an address for `link_to`; or http://[HOST]:PORT, to which Sensor Logger sends its messages; or
             phyphox://HOST[:PORT]; or ros2://TOPIC
    columns  template of text lines, see `LineDecoder`
    packet   file that describes binary packets
    rate_hz  sampling rate of a unit that sends no time, Hz

    Raises InputError if the format is not given, or lacks columns that a recording needs.
    """
    source = StreamSource(
        _link(address, baud), _decoder(address, columns, packet), rate_hz=rate_hz, clock=clock
    )
    # The columns are checked here, so that an error is reported before the run and not after it.
    recording_of(source.columns, np.zeros((0, len(source.columns))), "the data of the unit")
    return source


def _link(address: str, baud: int) -> Link:
    if address.startswith(PHONE):
        return phone_link(address)
    if address.startswith(ROS):
        return RosTopic(address.removeprefix(ROS))
    return link_to(address, baud)


def _decoder(address: str, columns: str | None, packet: str | os.PathLike[str] | None) -> Decoder:
    is_known = address.startswith((*PHONE, ROS))
    if (columns is not None and packet is not None) or (is_known and (columns or packet) is not None):
        raise InputError(
            f"the format of {address} is known: leave --columns and --packet out"
            if is_known
            else "the format of the unit's data is needed: give either --columns or --packet"
        )
    if address.startswith(ROS):
        return LineDecoder(TEMPLATE)
    if packet is not None:
        return PacketDecoder(PacketFormat.read(packet))
    if columns is not None:
        return LineDecoder(columns)
    if is_known or address.startswith("udp://"):
        # Datagrams without a format are assumed to be messages of a phone.
        return PhoneDecoder()
    raise InputError("the format of the unit's data is needed: give either --columns or --packet")
