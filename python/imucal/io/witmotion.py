"""Reader of binary packets of WitMotion sensors, as recorded by a serial terminal.

A packet has 11 bytes: 0x55, the type of the packet, four int16 (little-endian), and the low byte of the sum
of the other ten bytes. The types are:

    0x50  time: year - 2000, month, day, hour, minute, second, ms (uint16)
    0x51  acceleration, counts of 16 g / 32768; temperature, counts of 0.01 degC
    0x52  angular rate, counts of 2000 deg/s / 32768

Bluetooth and SD-card models of the series WT901BLE and WT901SDCL write one packet per sample, without a sum:
0x55, 0x61, nine int16 (acceleration, angular rate, angles), and on an SD card the fields of the time packet.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from imucal.document.source import File, open_file
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.layout import HEAD
from imucal.io.remarks import damaged
from imucal.io.scale import GRAVITY_G
from imucal.recording.recording import Recording
from imucal.units import DEGREE_RAD, STANDARD_GRAVITY_MPS2

__all__ = ["are_packets", "read_witmotion"]

SIZE: Final = 11
START: Final = 0x55
KINDS: Final = (0x50, 0x5F)
# Start of a packet with a whole sample, and the sizes of the packet without and with the time, bytes.
SAMPLE: Final = b"\x55\x61"
SAMPLE_SIZES: Final = (20, 28)
TIME, ACCEL, GYRO = 0x50, 0x51, 0x52
# Size of one count in SI units, from the communication protocol of the WT901 series.
FORCE_MPS2: Final = 16 * STANDARD_GRAVITY_MPS2 / 32768
RATE_RADPS: Final = 2000 * DEGREE_RAD / 32768


def are_packets(start: bytes) -> bool:
    """Whether the start of a file consists of WitMotion packets."""
    return len(_offsets(start)) * SIZE > 0.8 * len(start) > 2 * SIZE or _sample_size(start) is not None


def read_witmotion(path: str | os.PathLike[str], *, rate_hz: float | None = None) -> Recording:
    """Read packets of acceleration and angular rate. Packets with a wrong checksum are skipped.

    rate_hz  sampling rate, Hz, if there are no time packets; the first sample is then at 0 s

    Raises FormatError if one kind of packet is missing, and for accelerations far from the size of gravity.
    """
    file = open_file(path)
    size = _sample_size(file.content[:HEAD])
    if size is not None:
        return _of_samples(file, size, rate_hz)
    packets = _packets(file.content)
    kinds = packets[:, 1]
    # A sample is an acceleration packet followed directly by a rate packet.
    first = np.flatnonzero((kinds[:-1] == ACCEL) & (kinds[1:] == GYRO))
    if not len(first):
        raise FormatError(
            f"{file.name}: there is no packet of acceleration (0x51) followed by one of angular rate (0x52): "
            "switch both on in the WitMotion software, and record again"
        )
    counts = np.ascontiguousarray(packets[:, 2:10]).view("<i2")
    force = _force(file, counts[first, :3])
    findings: list[Finding] = []
    if len(packets) * SIZE < len(file.content) - 2 * SIZE:
        findings.append(damaged(file.name))
    temperature = counts[first, 3] / 100.0
    return Recording(
        _time_s(Path(path).name, packets, first, rate_hz),
        force,
        counts[first + 1, :3] * RATE_RADPS,
        temperature_degc=temperature if (temperature > -40).all() and temperature.any() else None,
        name=file.name,
        sources=[file.source],
        findings=findings,
    )


def _force(file: File, counts: NDArray[np.int16]) -> NDArray[np.float64]:
    """The acceleration, m/s^2. Raises FormatError if it is far from the size of gravity."""
    force = counts * FORCE_MPS2
    gravity = float(np.median(np.linalg.norm(force, axis=1))) / STANDARD_GRAVITY_MPS2
    if not GRAVITY_G[0] < gravity < GRAVITY_G[1]:
        raise FormatError(
            f"{file.name}: the median acceleration is {gravity:.3g} g at a range of 16 g: set the ranges to "
            "16 g and 2000 deg/s in the WitMotion software, or record as text"
        )
    return np.asarray(force)


def _sample_size(start: bytes) -> int | None:
    """The size of the packets with a whole sample each, bytes; None for other files."""
    for size in SAMPLE_SIZES:
        at = _sample_offsets(start, size)
        if len(at) > 2 and len(at) * size > 0.8 * len(start):
            return size
    return None


def _sample_offsets(content: bytes, size: int) -> NDArray[np.int64]:
    """Offsets of packets with a whole sample that are followed by a packet or by the end of the file."""
    data = np.frombuffer(content, np.uint8)
    is_start = (data[:-1] == SAMPLE[0]) & (data[1:] == SAMPLE[1])
    at = np.flatnonzero(is_start)
    at = at[at + size <= len(data)]
    follows = np.concatenate([is_start, np.ones(size + 1, bool)])
    return np.asarray(at[follows[at + size]])


def _of_samples(file: File, size: int, rate_hz: float | None) -> Recording:
    """The recording in packets with a whole sample each."""
    at = _sample_offsets(file.content, size)
    packets = np.frombuffer(file.content, np.uint8)[at[:, None] + np.arange(size)]
    counts = np.ascontiguousarray(packets[:, 2:14]).view("<i2")
    if rate_hz is None and size == SAMPLE_SIZES[0]:
        raise FormatError(f"{file.name}: there is no time in the packets: give the sample rate (--rate-hz)")
    is_damaged = bool((np.diff(at) != size).any())
    return Recording(
        _stamps_s(packets[:, 20:]) if rate_hz is None else _clock(file.name, len(at), rate_hz),
        _force(file, counts[:, :3]),
        counts[:, 3:] * RATE_RADPS,
        name=file.name,
        sources=[file.source],
        findings=[damaged(file.name)] if is_damaged else [],
    )


def _offsets(content: bytes) -> NDArray[np.int64]:
    """The offsets of the packets with a valid checksum."""
    data = np.frombuffer(content, np.uint8)
    if len(data) < SIZE:
        return np.empty(0, np.int64)
    at = np.flatnonzero((data[:-1] == START) & (data[1:] >= KINDS[0]) & (data[1:] <= KINDS[1]))
    at = at[at + SIZE <= len(data)]
    sums = np.zeros(len(at), np.uint8)
    for index in range(SIZE - 1):
        sums += data[at + index]
    return np.asarray(at[sums == data[at + SIZE - 1]])


def _packets(content: bytes) -> NDArray[np.uint8]:
    """The bytes of the packets, (N, 11). Matches of the start byte inside a packet do not count."""
    at = _offsets(content)
    if len(at) > 1 and (np.diff(at) < SIZE).any():
        kept = [int(at[0])]
        for offset in at[1:].tolist():
            if offset - kept[-1] >= SIZE:
                kept.append(offset)
        at = np.array(kept)
    data = np.frombuffer(content, np.uint8)
    return np.asarray(data[at[:, None] + np.arange(SIZE)])


def _time_s(file: str, packets: NDArray[np.uint8], first: NDArray[Any], rate_hz: float | None) -> Any:
    if rate_hz is not None:
        return _clock(file, len(first), rate_hz)
    before = first - 1
    if before.min() < 0 or not (packets[before, 1] == TIME).all():
        raise FormatError(
            f"{file}: there is no packet of time (0x50) before each sample: switch it on in the WitMotion "
            "software, or give the sample rate (rate_hz, --rate-hz)"
        )
    return _stamps_s(packets[before, 2:])


def _clock(file: str, samples: int, rate_hz: float) -> NDArray[np.float64]:
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"{file}: rate_hz is {rate_hz}: give a positive number")
    return np.arange(samples) / rate_hz


def _stamps_s(stamps: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The times since the first stamp, s, from the fields of time packets."""
    years = stamps[:, 0].astype(np.int64) + 30
    months = (years * 12 + stamps[:, 1] - 1).astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    seconds = ((months + stamps[:, 2] - 1) * 24 + stamps[:, 3]) * 60 + stamps[:, 4]
    ms = (seconds * 60 + stamps[:, 5]) * 1000 + np.ascontiguousarray(stamps[:, 6:8]).view("<u2")[:, 0]
    return np.asarray((ms - ms[0]) / 1000.0)
