"""Reading and writing recordings.

Formats:

    csv      the package's own: the unit is in the column's name (time_s, accel_x_mps2, ..., gyro_z_radps)
    parquet  the same columns as Parquet
    imu_tk   a pair of ASCII files, accelerometer and gyroscope, with the columns time, x, y, z
    euroc    the IMU file of the EuRoC data sets
    columns  any table of numbers as text; the caller names the columns
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from imucal.errors import FormatError, InputError
from imucal.io.canonical import PARQUET_MAGIC, read_csv, read_parquet, write_csv, write_parquet
from imucal.io.columns import read_columns
from imucal.io.euroc import is_euroc, read_euroc
from imucal.io.imu_tk import read_imu_tk
from imucal.io.source import open_file
from imucal.io.text import first_fields
from imucal.io.vocabulary import NAMES, is_canonical
from imucal.recording import AccelUnit, GyroUnit, Recording

__all__ = ["FORMATS", "files_per_recording", "read", "write"]


@dataclass(frozen=True)
class Format:
    """How a format is read: the function, how many files make a recording, and the options it knows."""

    read: Callable[..., Recording]
    files: int
    options: frozenset[str]


FORMATS: Final[dict[str, Format]] = {
    "csv": Format(read_csv, 1, frozenset({"rate_hz"})),
    "parquet": Format(read_parquet, 1, frozenset({"rate_hz"})),
    "imu_tk": Format(read_imu_tk, 2, frozenset({"time_unit", "accel_unit", "gyro_unit"})),
    "euroc": Format(read_euroc, 1, frozenset()),
    "columns": Format(read_columns, 1, frozenset({"columns", "rate_hz", "skip_rows"})),
}


def read(
    *paths: str | os.PathLike[str],
    format: str | None = None,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    skip_rows: int | None = None,
    time_unit: str | None = None,
    accel_unit: AccelUnit | None = None,
    gyro_unit: GyroUnit | None = None,
) -> Recording:
    """Read one recording.

    paths      one file; two (accelerometer, gyroscope) for imu_tk
    format     csv, parquet, imu_tk, euroc or columns; None finds it out from the file
    columns    [columns] a name for every column, `-` for one to leave out
    rate_hz    [columns, csv, parquet] sample rate, if there is no time column
    skip_rows  [columns] lines to leave out at the top
    time_unit  [imu_tk] s (default), ms, us or ns
    accel_unit, gyro_unit  [imu_tk] "lsb" (default), or "m/s^2" and "rad/s"

    Physical units become SI, counts stay counts. Time in ms, us or ns is counted from the first sample, time
    in s is kept. Empty cells become NaN.

    Raises InputError for files that cannot be read and options that do not fit, FormatError for the contents.
    """
    given = {
        "columns": columns,
        "rate_hz": rate_hz,
        "skip_rows": skip_rows,
        "time_unit": time_unit,
        "accel_unit": accel_unit,
        "gyro_unit": gyro_unit,
    }
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if not paths:
        raise InputError("no file is given: give the path of a recording")
    chosen = format or _detect(paths, options)
    if chosen not in FORMATS:
        raise InputError(f"the format {chosen!r} is not known: give one of {', '.join(FORMATS)}")
    known = FORMATS[chosen]
    if len(paths) != known.files:
        raise InputError(
            f"{len(paths)} files are given, a recording in the format {chosen} is {known.files}"
            + (": read several recordings one by one" if known.files == 1 else " (accelerometer, gyroscope)")
        )
    unfit = sorted(options.keys() - known.options)
    if unfit:
        raise InputError(
            f"the format {chosen} knows no option {unfit[0]}: leave it out, or give another format"
        )
    if chosen == "columns" and columns is None:
        raise InputError(f"the format columns needs names for the columns (columns=..., --columns): {NAMES}")
    return known.read(*paths, **options)


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as CSV or Parquet, by the ending of `path` (.csv, .parquet).

    Both have the canonical columns in SI units or counts and give every number back bit for bit. The file is
    written whole or not at all. Raises InputError if it cannot be written.
    """
    ending = Path(path).suffix.lower()
    if ending == ".csv":
        write_csv(recording, path)
    elif ending == ".parquet":
        write_parquet(recording, path)
    else:
        raise InputError(f"{os.fspath(path)}: a recording is written as .csv or .parquet: change the ending")


def files_per_recording(format: str | None) -> int:
    """How many files make one recording in a format."""
    return FORMATS[format].files if format in FORMATS else 1


def _detect(paths: Sequence[str | os.PathLike[str]], options: dict[str, Any]) -> str:
    """The format of the files, by the options, the number of files and the first line."""
    if "columns" in options:
        return "columns"
    if len(paths) == 2:
        return "imu_tk"
    file = open_file(paths[0])
    if file.content.startswith(PARQUET_MAGIC) or Path(paths[0]).suffix.lower() == ".parquet":
        return "parquet"
    fields = first_fields(file)
    if is_euroc(fields):
        return "euroc"
    if any(is_canonical(field) for field in fields):
        return "csv"
    shown = ", ".join(fields[:12])
    raise FormatError(
        f"{file.name}: the format is not clear, its first line is: {shown[:200]}. Give the format "
        f"({', '.join(FORMATS)}), or name the columns (columns=..., --columns): {NAMES}"
    )
