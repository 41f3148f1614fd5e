"""Derives serial numbers from file paths, by a pattern such as `{date}/{serial}-{role}.csv`.

A pattern is matched against the end of a path. Its fields in braces have the names of the columns of a
manifest, except `files` and `control`; `*` is any text within one file or folder name. A file with the role
`control` is a control recording.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from imucal.errors import InputError
from imucal.fleet.job import Job, path_text

__all__ = ["CONTROL_WORDS", "Naming", "files_of", "naming_of"]

FIELDS: Final = ("serial", "date", "station", "operator", "batch", "role")
# Words in file names that state the role of a recording, in upper or lower case.
CONTROL_WORDS: Final = ("control", "check", "verify")
RUN_WORDS: Final = ("run", "cal", "calibration", "rec", "recording")
# Words in file names that state the sensor. They are not part of a serial number.
SENSOR_WORDS: Final = ("acc", "accel", "accelerometer", "gyro", "gyr", "gyroscope")
WORD: Final = re.compile(r"[^-_. ]+")
# In a folder, files with these extensions count as recordings.
ENDINGS: Final = (
    *(".csv", ".parquet", ".txt", ".tsv", ".log", ".npz", ".npy", ".mat", ".h5", ".hdf5"),
    *(".bag", ".db3", ".mcap", ".ulg", ".bin", ".zip", ".gz"),
)


@dataclass(frozen=True)
class Naming:
    """Rule that derives serial numbers from paths: by a pattern, or by the words of file names."""

    pattern: str = ""

    def jobs(self, files: Iterable[str], *, with_lone_controls: bool = True) -> list[Job]:
        """Group files into jobs: all files of a unit in one folder, also control recordings, form one job.

        Raises InputError for a file without serial number. A control recording without another recording of
        its unit in the same folder raises InputError, or is omitted if `with_lone_controls` is false.
        """
        groups: dict[tuple[str | None, ...], tuple[list[str], list[str]]] = {}
        for file in files:
            fields = self._fields(file)
            is_control = (fields.get("role") or "").lower() in CONTROL_WORDS
            role = (
                None if is_control or (fields.get("role") or "").lower() in RUN_WORDS else fields.get("role")
            )
            about = (*(fields.get(name) for name in FIELDS if name != "role"), role)
            # Files of one unit in two folders are two measurements, even without a date.
            runs, controls = groups.setdefault((str(Path(file).parent), *about), ([], []))
            (controls if is_control else runs).append(path_text(file))
        jobs = []
        for (_, serial, *others), (runs, controls) in groups.items():
            if not runs and not with_lone_controls:
                continue
            if not runs:
                raise InputError(
                    f"{controls[0]} is a control recording, and unit {serial} has no other recording in its "
                    "folder: give the pattern of the names with --names, or a manifest"
                )
            fields = dict(zip(FIELDS[1:], others, strict=True))
            jobs.append(Job(serial or "", tuple(runs), tuple(controls), **fields))
        return jobs

    def words(self, job: Job) -> str:
        """A sentence that explains how serial numbers are derived, with `job` as an example."""
        rule = (
            f"by {self.pattern}"
            if self.pattern
            else "from the names of files, or of folders if files have names like run.csv"
        )
        control = f", with control {Path(job.control[0]).name}" if job.control else ""
        return f"serial numbers {rule}: {job.files[0]} is unit {job.serial}{control}"

    def _fields(self, file: str) -> dict[str, str | None]:
        if not self.pattern:
            return _by_words(file)
        found = _expression(self.pattern).search(file.replace(os.sep, "/"))
        if found is None:
            raise InputError(
                f"{file} does not end like --names {self.pattern}: give another pattern, or a manifest"
            )
        return dict(found.groupdict())


def naming_of(pattern: str | None) -> Naming:
    """The `Naming` for a pattern. Raises InputError if the pattern has no {serial} or an unknown field."""
    if pattern is not None:
        _expression(pattern)
    return Naming(pattern or "")


def files_of(patterns: Sequence[str], *, or_none: bool = False) -> list[str]:
    """The files that match paths, folders and glob patterns. The files of each folder or pattern are sorted.

    Raises InputError for a pattern without any file, unless `or_none` is true.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        if Path(pattern).is_dir():
            inside = (str(path) for path in sorted(Path(pattern).rglob("*")) if path.is_file())
            names = [name for name in inside if name.lower().endswith(ENDINGS)]
        elif Path(pattern).exists():
            names = [pattern]
        else:
            # glob.glob is used, because Path.glob does not accept absolute patterns.
            matching = glob.glob(pattern, recursive=True)  # noqa: PTH207
            names = sorted(name for name in matching if Path(name).is_file())
        if not names and not or_none:
            raise InputError(f"{pattern}: there is no such file: check the path or the pattern")
        found |= dict.fromkeys(names)
    return list(found)


def _by_words(file: str) -> dict[str, str | None]:
    """Serial number and role from the words of a path: run-0007.csv, 0007_control.csv, 0007/run.csv."""
    path = Path(file)
    stem = path.name.split(".")[0] or path.name
    words = WORD.findall(stem)
    roles = [word for word in words if word.lower() in (*CONTROL_WORDS, *RUN_WORDS)]
    rest = [word for word in words if word.lower() not in (*CONTROL_WORDS, *RUN_WORDS, *SENSOR_WORDS)]
    if not rest:
        return {"serial": path.absolute().parent.name, "role": roles[0] if roles else None}
    # A serial number may consist of several words, such as A-17. The separators between its words are kept.
    start, end = stem.index(rest[0]), stem.rindex(rest[-1]) + len(rest[-1])
    return {"serial": stem[start:end], "role": roles[0] if roles else None}


def _expression(pattern: str) -> re.Pattern[str]:
    parts = re.split(r"(\{[^{}]*\}|\*)", pattern)
    text, seen = "", set()
    for part in parts:
        name = part[1:-1]
        if part == "*":
            text += r"[^/]*"
        elif part.startswith("{"):
            if name not in FIELDS or name in seen:
                raise InputError(
                    f"--names {pattern}: the field {part} is unknown or given twice: the fields are "
                    + ", ".join(f"{{{each}}}" for each in FIELDS)
                )
            seen.add(name)
            text += rf"(?P<{name}>[^/]+?)"
        else:
            text += re.escape(part)
    if "serial" not in seen:
        raise InputError(f"--names {pattern} has no {{serial}}: give the place of the serial number")
    return re.compile(rf"(?:^|/){text}$")
