"""Detection of a file's format by its content, or by its name if the content is ambiguous."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from imucal.document.source import first_bytes, is_folder
from imucal.errors import FormatError
from imucal.io.euroc import is_euroc
from imucal.io.formats import FORMATS
from imucal.io.head import Head
from imucal.io.header import sensor_column
from imucal.io.layout import HEAD, Layout, is_number, plain_text, split_line
from imucal.io.mapping import mapping_of
from imucal.io.names import NAMES
from imucal.io.packed import (
    OLD_SPREADSHEET,
    TEXT_ENDINGS,
    ZIP,
    kind_of_zip,
    unpacked_start,
)
from imucal.io.starts import (
    DATAFLASH_MAGIC,
    MATLAB_MAGIC,
    PARQUET_MAGIC,
    REALSENSE_HEADER,
    ROS1_MAGIC,
    ULOG_MAGIC,
)
from imucal.io.suggestion import rows_of_several_sensors
from imucal.io.text import Text, head_of, layout_of_start

__all__ = ["recognise"]

SPREADSHEETS: Final = (".xlsx", ".xlsm", ".ods", ".numbers")
SPREADSHEET_WAY_OUT: Final = (
    "open it and save the sheet as CSV (File > Save As > CSV UTF-8), or choose CSV in the export"
)

# First bytes of an SQLite database, which can be a ROS 2 bag.
SQLITE: Final = b"SQLite format 3\0"
# First bytes of files, each with the format that they identify.
STARTS: Final = (
    *((magic, "matlab") for magic in MATLAB_MAGIC),
    (PARQUET_MAGIC, "parquet"),
    (ROS1_MAGIC, "rosbag"),
    (SQLITE, "rosbag"),
    (b"\x89MCAP0\r\n", "mcap"),
    (ULOG_MAGIC, "ulog"),
    (DATAFLASH_MAGIC, "dataflash"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"\x93NUMPY", "numpy"),
    (ZIP, "numpy"),
)
# First bytes of a log of Betaflight, Cleanflight or INAV.
BLACKBOX: Final = b"H Product:Blackbox flight data recorder"
# First line of a log of ArduPilot that Mission Planner has converted to text.
ARDUPILOT_TEXT: Final = rb"FMT, ?\d+, ?\d+, ?\w+, ?\w+, "
# Start of a text in JSON. A bracket must be followed by a JSON value, because a line of a log may also start
# with a bracket: `[12.5][STATE] ...`.
JSON: Final = rb"\s*(?:\{|\[\s*(?:[\[{\"\]]|[-\d.eE+]+\s*,))"
# Number of lines at the start of a text that are tested for JSON objects.
JSON_LINES: Final = 40
# Start of a cell with a list or an object in JSON.
CELL_LIST: Final = rb'"[\[{]'
# A text of labels (ax:0.01) or sentences ($VNIMU,...) contains at least one of these characters.
MARKS_OF_LABELS: Final = b":=$[*"
# Extensions that only one format uses. They identify the format if the first bytes of the file are damaged.
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
        return "pair" if any(_has_header(path) for path in paths) else "imu_tk"
    path = Path(paths[0])
    if is_folder(path):
        if (path / "metadata.yaml").is_file():
            return "rosbag"
        if any(each.name.lower().endswith(TEXT_ENDINGS) for each in path.iterdir()):
            return "folder"
    start = first_bytes(paths[0], HEAD)
    _refuse_spreadsheet(path, start)
    _refuse_blackbox(path, start)
    if start.startswith(ZIP) and path.suffix.lower() != ".npz":
        return _format_of_zip(path)
    if start.startswith(SQLITE) and not _is_rosbag(path):
        return "sqlite"
    for magic, name in STARTS:
        if start.startswith(magic):
            return name
    if start[:1] == b"\x55" and _are_packets(start):
        return "witmotion"
    if path.suffix.lower() == ".mat" and b"\0\0" in (start[:2], start[2:4]):
        # A MAT-file of level 4 starts with a 32-bit integer below 5000, of which two bytes are zero. Other
        # .mat files that reach this line are text.
        return "matlab"
    if path.suffix.lower() in ENDINGS:
        return ENDINGS[path.suffix.lower()]
    head = unpacked_start(path.name, start, HEAD)
    _refuse_text_log(path, head)
    if REALSENSE_HEADER in head:
        return "realsense"
    if _is_json(path.name, head):
        return "json"
    if any(mark in head for mark in MARKS_OF_LABELS) and (kind := _labels_or_sentences(head)) is not None:
        return kind
    if "columns" in options and mapping_of(options["columns"]) is None:
        return "columns"
    if re.match(JSON, head):
        return "json"
    if "columns" in options:
        return "csv"
    text, layout = layout_of_start(path.name, head)
    if not layout.first and re.search(CELL_LIST, text):
        raise FormatError(
            f"{path.name}: the cells hold lists: write one line per sample, with one number in each cell"
        )
    if layout.names is not None:
        if is_euroc(layout.names):
            return "euroc"
        return "csv" if sensor_column(Head(Text(path.name, text, layout, ())).cells) is None else "rows"
    more = f", ... ({len(layout.first)} columns)" if len(layout.first) > 12 else ""
    shown = ", ".join(layout.first[:12])
    hint = (
        "It looks like one of the two files of imu_tk: give both files with --format imu_tk. "
        if len(layout.first) == 4 and all(map(is_number, layout.first))
        else _several_sensors(text, layout)
    )
    raise FormatError(
        f"{path.name}: the format could not be determined; first line: {shown[:200]}{more}. "
        f"{hint}Give the format ({', '.join(FORMATS)}), or name the columns (columns=..., --columns): {NAMES}"
    )


def _several_sensors(start: bytes, layout: Layout) -> str:
    """A sentence for a message if each line starts with the name of its sensor; otherwise empty."""
    lines = start.decode(errors="replace").splitlines()[:100]
    return rows_of_several_sensors({"1": [split_line(line, layout.separator)[0] for line in lines]})


def _is_rosbag(path: Path) -> bool:
    from imucal.io.sqlite_tables import is_rosbag

    return is_rosbag(path)


def _are_packets(start: bytes) -> bool:
    from imucal.io.witmotion import are_packets

    return are_packets(start)


def _is_json(name: str, head: bytes) -> bool:
    """Whether a text starts as a JSON document, or most of its first lines are JSON objects.

    Labels with numbers may look like JSON, such as `{"ax":0.1,"ay":0.2,}`, and are then no JSON.
    """
    if b"{" not in head and b"[" not in head:
        return False
    text = plain_text(name, head).removeprefix(b"\xef\xbb\xbf")
    lines = [line.strip() for line in text.split(b"\n")[:JSON_LINES] if line.strip()]
    if re.match(JSON, text) and (
        len(lines) == 1 or lines[0].endswith((b"[", b"{", b",")) or _parses(lines[0])
    ):
        return True
    complete = lines[:-1] or lines
    return 2 * sum(line.startswith(b"{") and _parses(line) for line in complete) > len(complete)


def _parses(line: bytes) -> bool:
    """Whether a line is a JSON value."""
    import json

    try:
        json.loads(line.removesuffix(b","))
    except (ValueError, RecursionError):
        return False
    return True


def _labels_or_sentences(head: bytes) -> str | None:
    from imucal.io.sentences import are_labels, are_sentences

    if are_sentences(head):
        return "vectornav"
    return "labels" if are_labels(head) else None


def _has_header(path: str | os.PathLike[str]) -> bool:
    return head_of(path)[1].names is not None


def _refuse_spreadsheet(path: Path, start: bytes) -> None:
    if start.startswith(OLD_SPREADSHEET):
        raise FormatError(f"{path.name} is a spreadsheet (Excel 97 to 2003): {SPREADSHEET_WAY_OUT}")


def _refuse_blackbox(path: Path, start: bytes) -> None:
    if start.startswith(BLACKBOX):
        raise FormatError(
            f"{path.name} is a Betaflight log: convert it with `blackbox_decode --unit-rotation deg/s "
            f"--unit-acceleration g {path.name}`, and give the CSV file that this writes"
        )


def _refuse_text_log(path: Path, head: bytes) -> None:
    if re.match(ARDUPILOT_TEXT, head):
        raise FormatError(
            f"{path.name} is a log of ArduPilot as text: give the log itself (.bin), or write the samples of "
            f"one IMU with `mavlogdump.py --format csv --types IMU {path.name} > imu.csv`, and give that file"
        )


def _format_of_zip(path: Path) -> str:
    kind = "spreadsheet" if path.suffix.lower() in SPREADSHEETS else kind_of_zip(path)
    if kind == "spreadsheet":
        raise FormatError(
            f"{path.name} is a spreadsheet (Excel, LibreOffice or Numbers): {SPREADSHEET_WAY_OUT}"
        )
    if kind == "other":
        raise FormatError(
            f"{path.name} is a zip archive without text files: unpack it, and give the recording"
        )
    return "numpy" if kind == "numpy" else "folder"
