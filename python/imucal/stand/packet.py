"""Decoder for binary packets, whose layout is described in a file of schema imucal.packet/1.

    {"schema": "imucal.packet/1",
     "sync": "aa55", "byte_order": "little",
     "fields": [{"name": "sequence", "type": "uint16"}, {"name": "time_us", "type": "uint32"},
                {"name": "accel_x_lsb", "type": "int16"}, ...,
                {"name": "temp_degc", "type": "int16", "scale": 0.01}],
     "checksum": {"kind": "crc16-ccitt", "over": "all"}}

A packet consists of the sync bytes, the fields, and the checksum in the same byte order. The checksum is
computed over all bytes before it, or over the fields only. Bytes that match no packet are skipped and
counted.
"""

from __future__ import annotations

import binascii
import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from imucal.document.json_document import Node, read_json
from imucal.errors import FormatError

__all__ = ["CHECKSUMS", "Field", "PacketDecoder", "PacketFormat"]

SCHEMA: Final = "imucal.packet/1"
TYPES: Final = {
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"},
    **{"int64": "q", "uint64": "Q", "float32": "f", "float64": "d"},
}
# Field name of a number to ignore.
SKIP: Final = "-"


@dataclass(frozen=True)
class Field:
    """One number of a packet: name (`-` to ignore it), type, and conversion: value = scale * raw + offset."""

    name: str
    type: str
    scale: float = 1.0
    offset: float = 0.0

    @property
    def wraps_at(self) -> float | None:
        """The value at which an unsigned field wraps to zero, in its unit; None for other types."""
        size = struct.calcsize(f"<{TYPES[self.type]}")
        return self.scale * 2.0 ** (8 * size) if self.type.startswith("uint") else None


@dataclass(frozen=True)
class PacketFormat:
    """The layout of a packet."""

    sync: bytes
    byte_order: str
    fields: tuple[Field, ...]
    checksum: str
    over_fields_alone: bool = False

    @staticmethod
    def read(path: str | os.PathLike[str]) -> PacketFormat:
        """Read the description of a packet. Raises FormatError with the name of an invalid field."""
        node = read_json(path)
        node.require_schema(SCHEMA)
        sync = node.get("sync")
        try:
            start = bytes.fromhex(sync.text())
        except ValueError:
            start = b""
        if not start:
            raise FormatError(f"{sync.file}: $.sync is {sync.value!r}: give bytes in hex, such as aa55")
        checksum = node.get("checksum")
        over = checksum.get("over").text(("all", "fields")) if "over" in checksum.mapping() else "all"
        return PacketFormat(
            start,
            node.get("byte_order").text(("little", "big")),
            tuple(_field(item) for item in node.get("fields").items()),
            checksum.get("kind").text(tuple(CHECKSUMS)),
            over == "fields",
        )

    @property
    def layout(self) -> struct.Struct:
        """The struct layout of the fields."""
        order = "<" if self.byte_order == "little" else ">"
        return struct.Struct(order + "".join(TYPES[field.type] for field in self.fields))

    def sum_of(self, packet: bytes) -> bytes:
        """The checksum of a packet, given the bytes of the packet without its checksum."""
        size, of = CHECKSUMS[self.checksum]
        body = packet[len(self.sync) :] if self.over_fields_alone else packet
        return of(body).to_bytes(size, "little" if self.byte_order == "little" else "big")

    def pack(self, *raw: float) -> bytes:
        """A packet with these raw numbers, one per field; for test programs."""
        packet = self.sync + self.layout.pack(*raw)
        return packet + self.sum_of(packet)


class PacketDecoder:
    """Decodes bytes to rows of numbers, one for each packet with a correct checksum.

    columns  names of the fields that are not ignored
    """

    def __init__(self, form: PacketFormat) -> None:
        self.form = form
        kept = [(i, field) for i, field in enumerate(form.fields) if field.name != SKIP]
        self.columns = tuple(field.name for _, field in kept)
        self.wraps_at = tuple(field.wraps_at for _, field in kept)
        self.is_checked = True
        self.damaged = 0
        self.remark = f"no packet starts with {form.sync.hex()} and has a correct checksum"
        self.skipped_bytes = 0
        self._kept = [(i, field.scale, field.offset) for i, field in kept]
        self._layout = form.layout
        self._size = len(form.sync) + self._layout.size
        self._whole = self._size + CHECKSUMS[form.checksum][0]
        self._left = b""
        # Bytes before the first packet are not counted as skipped, because reading can start within a packet.
        self._found = False

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """Append received bytes. Returns the rows of the packets that are now complete."""
        data = self._left + data
        rows, at = [], 0
        while True:
            start = data.find(self.form.sync, at)
            if start < 0:
                # The sync bytes may be split between two calls.
                start = max(at, len(data) - len(self.form.sync) + 1)
                self._skip(start - at)
                at = start
                break
            self._skip(start - at)
            at = start
            if len(data) - at < self._whole:
                break
            packet = data[at : at + self._size]
            is_whole = self._is_whole(data, at)
            inner = data.find(self.form.sync, at + 1, at + self._whole) if is_whole else -1
            if inner >= 0:
                # Data that are not a packet pass a 16-bit CRC with a probability of 1/65536. If another valid
                # packet starts inside this packet, one of the two is such a false match. It is assumed to be
                # this packet, which then consists of the end of one packet and the start of the next packet.
                if len(data) - inner < self._whole:
                    break
                is_whole = not self._is_whole(data, inner)
            if is_whole:
                raw = self._layout.unpack_from(packet, len(self.form.sync))
                rows.append(tuple(scale * raw[i] + offset for i, scale, offset in self._kept))
                at += self._whole
                self._found, self.remark = True, ""
            else:
                self.damaged += self._found
                self._skip(1)
                at += 1
        self._left = data[at:]
        return rows

    def _is_whole(self, data: bytes, at: int) -> bool:
        packet = data[at : at + self._size]
        return self.form.sum_of(packet) == data[at + self._size : at + self._whole]

    def counts(self) -> dict[str, int]:
        """Numbers of damaged packets and skipped bytes."""
        return {"packets_damaged": self.damaged, "bytes_skipped": self.skipped_bytes}

    def _skip(self, count: int) -> None:
        if self._found:
            self.skipped_bytes += count


def _field(node: Node) -> Field:
    fields = node.mapping()
    return Field(
        node.get("name").text(),
        node.get("type").text(tuple(TYPES)),
        node.get("scale").number() if "scale" in fields else 1.0,
        node.get("offset").number() if "offset" in fields else 0.0,
    )


def _remainder(byte: int, step: Callable[[int], int]) -> int:
    for _ in range(8):
        byte = step(byte)
    return byte


# CRC tables for the polynomial 0x8005 with the lowest bit first, and for 0x07 with the highest bit first.
MODBUS: Final = [_remainder(b, lambda crc: crc >> 1 ^ (0xA001 if crc & 1 else 0)) for b in range(256)]
CRC8: Final = [_remainder(b, lambda crc: crc << 1 & 0xFF ^ (0x07 if crc & 0x80 else 0)) for b in range(256)]


def _modbus(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ MODBUS[(crc ^ byte) & 0xFF]
    return crc


def _crc8(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc = CRC8[crc ^ byte]
    return crc


def _xor(data: bytes) -> int:
    result = 0
    for byte in data:
        result ^= byte
    return result


# Size in bytes and function of each checksum. For the text "123456789" the four CRCs from crc16-ccitt to crc8
# give 29b1, 31c3, 4b37 and f4, the published check values.
CHECKSUMS: Final[dict[str, tuple[int, Callable[[bytes], int]]]] = {
    "crc32": (4, zlib.crc32),
    "crc16-ccitt": (2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc16-xmodem": (2, lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": (2, _modbus),
    "crc8": (1, _crc8),
    "sum8": (1, lambda data: sum(data) & 0xFF),
    "xor8": (1, _xor),
}
