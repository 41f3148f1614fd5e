"""Reading and writing recordings; `formats` has the catalogue of what is read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from imucal.errors import InputError
from imucal.io.canonical import write_columns, write_parts
from imucal.io.formats import FORMATS, Format
from imucal.io.recognition import recognise
from imucal.io.source import require_file
from imucal.io.text import NotInPartsError
from imucal.io.vocabulary import NAMES, column_names
from imucal.recording.recording import AccelUnit, GyroUnit, Recording

__all__ = [
    "FORMATS",
    "NotInPartsError",
    "files_per_recording",
    "read",
    "read_pieces",
    "write",
    "write_pieces",
]


def read(
    *paths: str | os.PathLike[str],
    format: str | None = None,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    skip_rows: int | None = None,
    topic: str | None = None,
    instance: int | None = None,
    group: str | None = None,
    receive_time: bool | None = None,
    time_unit: str | None = None,
    accel_unit: AccelUnit | None = None,
    gyro_unit: GyroUnit | None = None,
) -> Recording:
    """Read one recording.

    paths      one file; two (accelerometer, gyroscope) for imu_tk; the folder of a ROS 2 bag
    format     one of `imucal.io.FORMATS`; None finds it out from the file
    columns    [columns] a name for every column, `-` for one to leave out
               [csv, parquet, matlab, hdf5, numpy] "ours=theirs,..." where the file has other names
    rate_hz    [columns, csv, parquet, matlab, hdf5, numpy] sample rate, if there is no time column
    skip_rows  [columns] lines to leave out at the top
    topic      [rosbag, mcap] topic of the messages; [ulog, dataflash] name of the message
    instance   [ulog, dataflash] number of the sensor, from 0
    group      [matlab, hdf5, numpy] where the arrays are
    receive_time   [rosbag, mcap] time stamps of the bag instead of those of the messages
    time_unit  [imu_tk] s (default), ms, us or ns
    accel_unit, gyro_unit  [imu_tk] "lsb" (default), or "m/s^2" and "rad/s"

    Physical units become SI, counts stay counts. Time in ms, us or ns is counted from the first sample, time
    in s is kept. Empty cells become NaN. What had to be done to the data is in the recording's `findings`.

    Raises InputError for files that cannot be read, options that do not fit and choices that are not clear,
    FormatError for the contents, ImucalError for a format whose library is not installed.
    """
    given = {
        "columns": columns,
        "rate_hz": rate_hz,
        "skip_rows": skip_rows,
        "topic": topic,
        "instance": instance,
        "group": group,
        "receive_time": receive_time,
        "time_unit": time_unit,
        "accel_unit": accel_unit,
        "gyro_unit": gyro_unit,
    }
    known, options = _chosen(paths, format, given)
    return known.read(*paths, **options)


def read_pieces(
    *paths: str | os.PathLike[str], format: str | None = None, **given: Any
) -> Iterator[Recording]:
    """What `read` reads, with the same arguments, piece by piece; formats other than CSV and Parquet in one.

    Time counts from the first piece. Raises as `read`; and NotInPartsError, a FormatError, at a later piece
    of a CSV file that only as a whole tells what its columns are.
    """
    known, options = _chosen(paths, format, given)
    if known.pieces is None:
        return iter([known.read(*paths, **options)])
    return known.pieces(*paths, **options)


def _chosen(
    paths: Sequence[str | os.PathLike[str]], format: str | None, given: Mapping[str, Any]
) -> tuple[Format, dict[str, Any]]:
    """The format of the files, and the options that are given for it."""
    options = {name: value for name, value in given.items() if value is not None and value is not False}
    if not paths:
        raise InputError("no file is given: give the path of a recording")
    for path in paths:
        require_file(path)
    chosen = format or recognise(paths, options)
    if chosen not in FORMATS:
        raise InputError(f"the format {chosen!r} is not known: give one of {', '.join(FORMATS)}")
    known = FORMATS[chosen]
    if len(paths) != known.files:
        raise InputError(
            f"{len(paths)} files are given, a recording in the format {chosen} is {known.files}"
            + (": read several recordings one by one" if known.files == 1 else " (accelerometer, gyroscope)")
        )
    unfit = sorted(options.keys() - set(known.options))
    if unfit:
        raise InputError(
            f"the format {chosen} knows no option {unfit[0]}: leave it out, or give another format"
        )
    if chosen == "columns" and "columns" not in options:
        raise InputError(f"the format columns needs names for the columns (columns=..., --columns): {NAMES}")
    return known, options


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as CSV or Parquet, by the ending of `path` (.csv, .parquet).

    Both have the canonical columns in SI units or counts and give every number back bit for bit. The file is
    written whole or not at all. Raises InputError if it cannot be written.
    """
    write_columns(column_names(recording), path)


def write_pieces(pieces: Iterable[Recording], path: str | os.PathLike[str]) -> None:
    """Write a recording that comes piece by piece, one piece at least, as `write` does."""
    write_parts((column_names(piece) for piece in pieces), path)


def files_per_recording(format: str | None) -> int:
    """How many files make one recording in a format."""
    return FORMATS[format].files if format in FORMATS else 1
