"""Traps of damaged numbers and files: named as what they are, without a crash, a hang or gigabytes."""

import functools
import shutil
from pathlib import Path

import numpy as np

import imucal
from changes import force, rate
from recordings import calibrating
from trap import Question, Trap, refused

CORPUS = Path(__file__).parents[2] / "fuzz" / "corpus"
FORMATS = {
    "csv_bad_row_not_utf8.csv": "csv",
    "dataflash_overflow.bin": "dataflash",
    "mat4_memoryerror.mat": "matlab",
    "mat5_segfault.mat": "matlab",
    "mcap_memoryerror.mcap": "mcap",
    "parquet_2GB.parquet": "parquet",
    "parquet_unicode.parquet": "parquet",
    "ulog_keyerror.ulg": "ulog",
}


def at(rows, axis, value):
    """A change that sets some samples of one axis."""

    def change(values):
        values[rows, axis] = value
        return values

    return change


IMPOSSIBLE = tuple(
    calibrating(
        "a sample that no sensor measures",
        f"{value:g} in {sensor}_{'xyz'[axis]}, {where}",
        on(at(rows, axis, value)),
        refused("value_impossible"),
    )
    for sensor, on in (("accel", force), ("gyro", rate))
    for axis, rows, where, value in (
        (0, 0, "first sample", 1.7e153),
        (1, -1, "last sample", -3.4e38),
        (2, 330, "in a move", 1e308),
        (0, np.s_[60:63], "three samples at rest", 2e6),
        (2, np.s_[::500], "every 500th sample", np.finfo(np.float32).max),
    )
)


def damaged(name: str, folder: Path) -> Question:
    path = folder / name
    shutil.copy(CORPUS / name, path)
    format = FORMATS[name]
    return Question(["inspect", path, "--format", format], lambda: imucal.read(path, format=format))


DAMAGED = tuple(
    Trap("a damaged file", name, functools.partial(damaged, name), (refused(name),)) for name in FORMATS
)

TRAPS = (*IMPOSSIBLE, *DAMAGED)
