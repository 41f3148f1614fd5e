"""Transfer of recordings between two processes as a stream of bytes.

The stream consists of frames. A frame is a line of JSON, followed by the bytes of the arrays that the line
lists. The line is {"recording": fields, "arrays": [[field, key, type, shape], ...]} for a recording,
{"error": class, "message": text} for a failure, or {"end": true} at the end. The key is the name of an
auxiliary input; it is null for all other arrays. A frame contains no code, unlike pickled objects.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, fields
from typing import IO, Any, BinaryIO, Final, cast

import numpy as np
from numpy.typing import NDArray

import imucal.errors as errors
from imucal.document.source import Source
from imucal.errors import ImucalError
from imucal.finding import Finding, Place
from imucal.recording.recording import Recording

__all__ = ["BrokenFrameError", "recordings_in", "write_end", "write_error", "write_recording"]

# Longest accepted line of JSON, bytes. A recording with thousands of named columns needs less.
LONGEST_LINE: Final = 1 << 24
# Accepted types of the columns of a recording.
TYPES: Final = ("<f8", "<f4", "<i2")


class BrokenFrameError(Exception):
    """The stream ends early, or is not in this format."""


def write_recording(recording: Recording, stream: BinaryIO) -> None:
    """Write one recording."""
    plain: dict[str, Any] = {}
    listed: list[tuple[str, str | None, str, tuple[int, ...]]] = []
    columns: list[Any] = []

    def put(field: str, key: str | None, values: Any) -> None:
        native = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        listed.append((field, key, native.dtype.str, native.shape))
        columns.append(native)

    for field in fields(Recording):
        value = getattr(recording, field.name)
        if isinstance(value, np.ndarray):
            put(field.name, None, value)
        elif isinstance(value, dict):
            plain[field.name] = {}
            for key, values in value.items():
                put(field.name, key, values)
        elif isinstance(value, tuple):
            plain[field.name] = [
                asdict(item) if isinstance(item, (Source, Finding)) else item for item in value
            ]
        else:
            plain[field.name] = value
    _write_line({"recording": plain, "arrays": listed}, stream)
    for column in columns:
        stream.write(column.data.cast("B") if column.size else b"")


def write_error(error: ImucalError, stream: BinaryIO) -> None:
    """Write the error that ended the reading."""
    _write_line({"error": type(error).__name__, "message": str(error)}, stream)


def write_end(stream: BinaryIO) -> None:
    """Mark the end of the last recording."""
    _write_line({"end": True}, stream)


def _write_line(document: dict[str, Any], stream: BinaryIO) -> None:
    stream.write(json.dumps(document).encode() + b"\n")


def recordings_in(stream: IO[bytes], most_bytes: int) -> Iterator[Recording]:
    """The recordings in a stream. Each array may have at most `most_bytes` bytes.

    Raises the ImucalError that the stream contains, and BrokenFrameError for a stream without an end.
    """
    while True:
        line = stream.readline(LONGEST_LINE)
        try:
            frame = json.loads(line)
            if frame.get("end"):
                return
            if "recording" not in frame:
                raise getattr(errors, frame["error"])(frame["message"])
            recording = _recording(frame["recording"], frame["arrays"], stream, most_bytes)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, ImucalError):
                raise
            raise BrokenFrameError from None
        yield recording


def _recording(plain: dict[str, Any], listed: list[Any], stream: IO[bytes], most_bytes: int) -> Recording:
    given = dict(plain)
    for field, key, kind, shape in listed:
        size = math.prod(shape) * np.dtype(kind).itemsize
        if kind not in TYPES or not 0 <= size <= most_bytes:
            raise BrokenFrameError
        values = np.empty(shape, dtype=kind)
        _fill(values, stream)
        if key is None:
            given[field] = values
        else:
            given[field][key] = values
    given["sources"] = [Source(**source) for source in given["sources"]]
    given["findings"] = [_finding(finding) for finding in given["findings"]]
    accel, gyro = given["column_units"]
    if not all(unit is None or isinstance(unit, str) for unit in (accel, gyro)):
        raise BrokenFrameError
    given["column_units"] = (accel, gyro)
    return Recording(**given)


def _finding(given: dict[str, Any]) -> Finding:
    place = given["place"] and Place(**given["place"])
    return Finding(**{**given, "columns": tuple(given["columns"]), "place": place})


def _fill(values: NDArray[Any], stream: IO[bytes]) -> None:
    into = values.data.cast("B") if values.size else memoryview(b"")
    while into:
        count = cast(Any, stream).readinto(into)
        if not count:
            raise BrokenFrameError
        into = into[count:]
