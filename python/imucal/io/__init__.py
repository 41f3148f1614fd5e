"""Reading and writing recordings. `formats` lists the file formats that can be read."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from imucal.data_frame import is_frame
from imucal.document.source import require_file
from imucal.errors import InputError
from imucal.io.faults import faults_named
from imucal.io.formats import FORMATS
from imucal.io.names import NAMES
from imucal.io.temperature_counts import TempScale, scale_of, with_temperature
from imucal.io.text import NotInPartsError
from imucal.io.vocabulary import column_names
from imucal.recording.axes import Axes
from imucal.recording.recording import Recording, as_recording

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
    *paths: Any,
    format: str | None = None,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    skip_rows: int | None = None,
    topic: str | None = None,
    instance: int | None = None,
    group: str | None = None,
    receive_time: bool | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
    temp_scale: TempScale | None = None,
    axes: str | None = None,
) -> Recording:
    """Read one recording. An option with format names in brackets exists only for these formats.

    paths      path of one file; or paths of two files, one per sensor; or path of a folder or a zip archive
               with such files, or of the folder of a ROS 2 bag; or a data frame (pandas, polars, pyarrow,
               DuckDB), for which only the options columns and rate_hz exist
    format     a name of `imucal.io.FORMATS`; None detects the format from the file
    columns    [columns] a canonical name for every column, `-` for a column to ignore;
               [csv, folder, labels, parquet, matlab, hdf5, numpy] "canonical=name,..." if the file uses other
               names
    rate_hz    [columns, csv, pair, folder, labels, vectornav, witmotion, parquet, matlab, hdf5, numpy]
               sampling rate, Hz, if there is no time column; for pair and folder also instead of the time
               stamps
    skip_rows  [columns] number of lines to skip at the start of the file
    topic      [rosbag, mcap] topic of the messages; [ulog, dataflash] name of the message
    instance   [ulog, dataflash] number of the sensor, from 0
    group      [matlab, hdf5, numpy] group that contains the arrays
    receive_time   [rosbag, mcap] use the time stamps of the bag instead of those of the messages
    time_unit  [imu_tk, pair, folder] s, ms, us or ns, if no header states the unit
    accel_unit, gyro_unit  [imu_tk, pair, folder] "lsb" (default of imu_tk), "m/s^2" and "rad/s"; for pair and
               folder also "g", "mg", "deg/s", "mdeg/s" and the other units of docs/formats.md, if no header
               states the unit
    temp_scale  slope, degC per count, and offset, degC, of a column temp_lsb: (1/340, 36.53) or
               "1/340,36.53". Without `temp_scale` these counts become an auxiliary input
    axes       axis remapping after reading, for all formats: "frd" or "ned" for data with z down, "x,-y,-z",
               or "accel=..." and "gyro=..." for one sensor; see `Recording.with_axes`

    Physical units are converted to SI units, and counts are unchanged. Time in ms, us or ns is counted from
    the first sample, and time in s is unchanged. Empty cells become NaN. Repairs to the data are reported in
    the recording's `findings`.

    Raises InputError for unreadable files, for options that do not apply and for ambiguous choices,
    FormatError for invalid contents, and ImucalError if the library for the format is not installed.
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
    turn = _axes(axes)
    scale = None if temp_scale is None else scale_of(temp_scale)
    if len(paths) == 1 and is_frame(paths[0]):
        return turn(with_temperature(_of_frame(paths[0], format, given), scale))
    chosen, options = _chosen(paths, format, given)
    known = FORMATS[chosen]
    if known.isolated:
        (recording,) = _pieces(chosen, paths, options)
    else:
        with faults_named(paths, known.title):
            recording = known.read(*paths, **options)
    return turn(with_temperature(recording, scale))


def _of_frame(frame: Any, format: str | None, given: Mapping[str, Any]) -> Recording:
    from imucal.io.frames import read_frame

    options = {name: value for name, value in given.items() if value is not None}
    if format is not None:
        options["format"] = format
    unfit = sorted(options.keys() - {"columns", "rate_hz"})
    if unfit:
        raise InputError(f"a data frame has no option {unfit[0]}: leave it out")
    return read_frame(frame, **options)


def read_pieces(
    *paths: str | os.PathLike[str],
    format: str | None = None,
    temp_scale: TempScale | None = None,
    axes: str | None = None,
    **given: Any,
) -> Iterator[Recording]:
    """Read a recording in pieces, with the arguments of `read`.

    Only CSV and Parquet files give several pieces.

    Time counts from the start of the first piece. Raises the errors of `read`. At a later piece of a CSV
    file, also raises NotInPartsError (a FormatError) if the column types can only be determined from the
    whole file.
    """
    scale = None if temp_scale is None else scale_of(temp_scale)
    turn = _axes(axes)
    chosen, options = _chosen(paths, format, given)
    return (turn(with_temperature(piece, scale)) for piece in _pieces(chosen, paths, options))


def _pieces(
    format: str, paths: Sequence[str | os.PathLike[str]], options: Mapping[str, Any]
) -> Iterator[Recording]:
    """The recording in pieces, or in one piece."""
    known = FORMATS[format]
    with faults_named(paths, known.title):
        pieces = None
        if known.isolated:
            from imucal.io.isolated import read_in_child

            pieces = read_in_child(paths, format, known.title, options)
        yield from known.pieces(*paths, **options) if pieces is None else pieces


def _axes(axes: str | None) -> Callable[[Recording], Recording]:
    """A function that remaps the axes of a recording. Raises InputError at once for an invalid `axes`."""
    if axes is None:
        return lambda recording: recording
    Axes.parse(axes)
    return lambda recording: recording.with_axes(axes)


def _chosen(
    paths: Sequence[str | os.PathLike[str]], format: str | None, given: Mapping[str, Any]
) -> tuple[str, dict[str, Any]]:
    """The name of the files' format, and the given options, checked against that format."""
    options = {name: value for name, value in given.items() if value is not None and value is not False}
    if not paths:
        raise InputError("no file is given: give the path of a recording")
    for path in paths:
        if not isinstance(path, (str, os.PathLike)):
            raise InputError(
                f"a {type(path).__name__} is neither the path of a file nor a data frame: call collect() of "
                "a lazy frame, and give several frames one by one"
            )
    for path in paths:
        require_file(path)
    chosen = format or _recognised(paths, options)
    if chosen not in FORMATS:
        raise InputError(f"unknown format {chosen!r}: give one of {', '.join(FORMATS)}")
    known = FORMATS[chosen]
    if len(paths) != known.files:
        raise InputError(
            f"{len(paths)} files given, but a recording in the format {chosen} consists of {known.files}"
            + (": read several recordings one by one" if known.files == 1 else " (accelerometer, gyroscope)")
        )
    unfit = sorted(options.keys() - set(known.options))
    if unfit:
        raise InputError(
            f"the format {chosen} has no option {unfit[0]}: leave it out, or give another format"
        )
    if chosen == "columns" and "columns" not in options:
        raise InputError(f"the format columns needs column names (columns=..., --columns): {NAMES}")
    return chosen, options


def _recognised(paths: Sequence[str | os.PathLike[str]], options: Mapping[str, Any]) -> str:
    from imucal.io.recognition import recognise

    return recognise(paths, options)


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as CSV or Parquet, depending on the extension of `path` (.csv, .parquet).

    Columns have canonical names, in SI units or counts. Reading the file returns every number bit for bit.
    The file is written atomically. Raises InputError if it cannot be written.
    """
    from imucal.io.canonical import write_columns

    write_columns(column_names(as_recording(recording)), path)


def write_pieces(pieces: Iterable[Recording], path: str | os.PathLike[str]) -> None:
    """Write a recording that is given in one or more pieces. The file equals the file that `write` gives."""
    from imucal.io.canonical import write_parts

    write_parts((column_names(piece) for piece in pieces), path)


def files_per_recording(format: str | None, paths: Sequence[str | os.PathLike[str]] = ()) -> int:
    """The number of files of one recording: 2 if each sensor has a separate file, otherwise 1."""
    if format is None and len(paths) == 2:
        from imucal.io.sensor_files import are_pair

        return 2 if are_pair(paths) else 1
    return FORMATS[format].files if format in FORMATS else 1
