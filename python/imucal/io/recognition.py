"""Detection of a file's format by its content, or by its name if the content is ambiguous."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from imucal.document.source import first_bytes, is_folder
from imucal.errors import FormatError
from imucal.io.canonical import PARQUET_MAGIC
from imucal.io.columns import mapping_of
from imucal.io.dataflash import DATAFLASH_MAGIC
from imucal.io.euroc import is_euroc
from imucal.io.formats import FORMATS
from imucal.io.matlab import MATLAB_MAGIC
from imucal.io.names import NAMES, is_canonical
from imucal.io.ros import ROS1_MAGIC
from imucal.io.suggestion import columns_suggested
from imucal.io.text import first_fields, is_number
from imucal.io.ulog import ULOG_MAGIC

__all__ = ["recognise"]

# First bytes of a file, and the format that they identify.
STARTS: Final = (
    *((magic, "matlab") for magic in MATLAB_MAGIC),
    (PARQUET_MAGIC, "parquet"),
    (ROS1_MAGIC, "rosbag"),
    (b"SQLite format 3\0", "rosbag"),
    (b"\x89MCAP0\r\n", "mcap"),
    (ULOG_MAGIC, "ulog"),
    (DATAFLASH_MAGIC, "dataflash"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"\x93NUMPY", "numpy"),
    (b"PK\x03\x04", "numpy"),
)
# Part of a text file that is searched for its first line, bytes.
LONGEST_HEADER = 1 << 16
# Extensions used by one format only. They identify a file whose first bytes are damaged.
ENDINGS: Final = {
    ".parquet": "parquet",
    ".bag": "rosbag",
    ".db3": "rosbag",
    ".mcap": "mcap",
    ".ulg": "ulog",
    ".bin": "dataflash",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".npy": "numpy",
    ".npz": "numpy",
}


def recognise(paths: Sequence[str | os.PathLike[str]], options: Mapping[str, Any]) -> str:
    """The format of the files, from their number, content and names, and from the options for text files.

    Raises FormatError if the format cannot be determined, and the errors of `first_bytes`.
    """
    if len(paths) == 2:
        return "imu_tk"
    path = Path(paths[0])
    if is_folder(path) and (path / "metadata.yaml").is_file():
        return "rosbag"
    start = first_bytes(paths[0], max(len(magic) for magic, _ in STARTS))
    for magic, name in STARTS:
        if start.startswith(magic):
            return name
    if path.suffix.lower() in ENDINGS:
        return ENDINGS[path.suffix.lower()]
    if "columns" in options and mapping_of(options["columns"]) is None:
        return "columns"
    fields = first_fields(path.name, first_bytes(path, LONGEST_HEADER))
    if is_euroc(fields):
        return "euroc"
    if "columns" in options or any(is_canonical(field) for field in fields):
        return "csv"
    shown = ", ".join(fields[:12])
    pair = len(fields) == 4 and all(map(is_number, fields))
    hint = "It looks like one file of an imu_tk pair: add --format imu_tk for two files. " if pair else ""
    raise FormatError(
        f"{path.name}: the format could not be determined; first line: {shown[:200]}. "
        f"{hint or columns_suggested(fields)}Give the format "
        f"({', '.join(FORMATS)}), or name the columns (columns=..., --columns): {NAMES}"
    )
