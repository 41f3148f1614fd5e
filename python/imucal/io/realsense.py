"""CSV files of rs-convert and rs-data-collect, the recording tools of RealSense cameras.

Each line starts with the name of a stream, and each stream has its own rate and time stamps:

    Stream Type,F#,HW Timestamp (ms),Backend Timestamp(ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z
    Gyro,1,1767268800000.000,1767268800001.200,1767268800002.100,0.001,-0.002,0.003
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.document.source import open_file
from imucal.errors import FormatError
from imucal.io.remarks import lines_left_out
from imucal.io.streams import Stream, recording_from_streams
from imucal.recording.recording import Recording

__all__ = ["read_realsense"]

HARDWARE: Final = "HW Timestamp (ms)"
HOST: Final = "Host Timestamp(ms)"
VALUES: Final = ("3DOF_x", "3DOF_y", "3DOF_z")
STREAMS: Final = {"Accel": "the accelerometer", "Gyro": "the gyroscope"}
# Two clocks count as having the same unit if their elapsed times differ by at most this relative difference.
SAME_UNIT: Final = 0.1
# Lines of a stream that do not consist of numbers are skipped. The file is refused if their share of the
# lines of the stream exceeds this number.
MOST_GARBLED: Final = 0.01


def read_realsense(path: str | os.PathLike[str]) -> Recording:
    """Read the streams Accel (m/s^2) and Gyro (rad/s), with time stamps from the clock of the camera.

    The hardware clock is in ms or us, depending on the model and the version of the library. The unit is
    chosen so that the hardware clock agrees with the clock of the host. Raises FormatError if it agrees in
    neither unit, or if a stream is missing.
    """
    file = open_file(path)
    names: list[str] = []
    rows: dict[str, list[bytes]] = {name: [] for name in STREAMS}
    for line in file.content.replace(b"\r", b"").split(b"\n"):
        kind = line.partition(b",")[0].decode(errors="replace")
        if kind == "Stream Type":
            names = line.decode(errors="replace").split(",") if VALUES[0].encode() in line else names
        elif kind in rows:
            rows[kind].append(line)
    missing = [name for name in (HARDWARE, HOST, *VALUES) if name not in names]
    if missing:
        raise FormatError(
            f"{file.name}: the column {missing[0]!r} of the motion streams is missing; found: "
            f"{', '.join(names) or 'none'}: convert the recording again with rs-convert"
        )
    streams, left_out = [], 0
    for kind, lines in rows.items():
        stream, count = _stream(file.name, kind, lines, names)
        streams.append(stream)
        left_out += count
    findings = [lines_left_out(file.name, [f"{left_out} incomplete lines"], left_out)] if left_out else []
    return recording_from_streams(file.name, streams[0], streams[1], [file.source], findings)


def _stream(file: str, kind: str, lines: list[bytes], names: list[str]) -> tuple[Stream, int]:
    """The samples of a stream, and the number of skipped lines."""
    columns = _columns(lines, names)
    count = 0
    if columns is None:
        kept = [line for line in lines if _columns([line], names) is not None]
        count = len(lines) - len(kept)
        if count > max(1, MOST_GARBLED * len(lines)):
            raise FormatError(
                f"{file}: {count} of {len(lines)} lines of the stream {kind} do not have {len(names)} "
                "values: convert the recording again with rs-convert"
            )
        columns = _columns(kept, names)
    if columns is None:
        raise FormatError(
            f"{file}: there are no samples of {STREAMS[kind]} (lines that start with {kind!r}): record both "
            "motion streams"
        )
    hardware, host, *values = columns
    # Time stamps have three decimals, so they are converted to integers without loss.
    time_ns = np.round(hardware * 1000).astype(np.int64) * (_unit_ns(file, hardware, host) // 1000)
    return Stream(f"{file}, {kind}", time_ns, np.column_stack(values)), count


def _columns(lines: Sequence[bytes], names: list[str]) -> list[FloatArray] | None:
    """Columns of both clocks and of the values; None if a line contains anything except numbers."""
    wanted = (HARDWARE, HOST, *VALUES)
    table = _core.NumberColumns(ord(","), ord("."), [name in wanted for name in names])
    if not lines or not table.add(b"\n".join(lines)):
        return None
    columns = table.finish()
    if columns is None:
        return None
    found = dict(zip((name for name in names if name in wanted), columns, strict=True))
    return [np.asarray(found[name], dtype=np.float64) for name in wanted]


def _unit_ns(file: str, hardware: FloatArray, host: FloatArray) -> int:
    """The unit of the hardware clock, ns, from a comparison with the clock of the host."""
    span, span_ms = hardware[-1] - hardware[0], host[-1] - host[0]
    if len(hardware) < 2 or not (span > 0 and span_ms > 0):
        raise FormatError(f"{file}: the time stamps do not increase: record again")
    for unit_ns in (1_000_000, 1_000):
        if abs(span * unit_ns / (span_ms * 1e6) - 1) < SAME_UNIT:
            return unit_ns
    raise FormatError(
        f"{file}: the hardware clock advances by {span:.6g} while that of the host advances by "
        f"{span_ms:.6g} ms: its unit is neither ms nor us; give the .bag file itself"
    )
