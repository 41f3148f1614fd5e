"""Reads the jobs of a run from a manifest, a CSV file with one job per row."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Final

from imucal.errors import FormatError, InputError
from imucal.fleet.job import Job, path_text

__all__ = ["COLUMNS", "count_of_manifest", "is_manifest", "jobs_of_manifest", "shard", "shard_of"]

# Columns of a manifest; serial and files are required.
COLUMNS: Final = ("serial", "date", "station", "operator", "batch", "files", "control", "role")
REQUIRED: Final = ("serial", "files")
SEPARATOR: Final = ";"


def jobs_of_manifest(path: str | os.PathLike[str]) -> Iterator[Job]:
    """The jobs of a CSV manifest, one per row. Paths are relative to the folder of the manifest.

    Raises InputError or FormatError with the line number for an invalid row.
    """
    folder = Path(path).parent
    for line, row in _rows(path):
        given = {name: value.strip() or None for name, value in row.items()}
        serial, files = given.get("serial"), _paths(given.get("files"), folder)
        if serial is None or not files:
            missing = "serial" if serial is None else "files"
            raise FormatError(f"{os.fspath(path)}, line {line}: {missing} is empty: give serial and files")
        others = {name: given.get(name) for name in COLUMNS if name not in ("serial", "files", "control")}
        try:
            yield Job(serial, files, _paths(given.get("control"), folder), **others)
        except InputError as error:
            raise FormatError(f"{os.fspath(path)}, line {line}: {error}") from None


def is_manifest(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a CSV file with the header of a manifest."""
    if Path(path).suffix.lower() != ".csv":
        return False
    try:
        with Path(path).open("rb") as file:
            head = file.readline(1000).decode("utf-8-sig", "replace")
    except OSError:
        return False
    # A file with only one of the two required columns also counts as a manifest. It is then refused with a
    # message about the missing column.
    return bool({"serial", "files"} & {name.strip().strip('"') for name in head.split(",")})


def count_of_manifest(path: str | os.PathLike[str]) -> int:
    """The number of rows of a manifest. Each row is checked."""
    return sum(1 for _ in jobs_of_manifest(path))


def shard_of(text: str) -> tuple[int, int]:
    """The numbers I and N in `I/N`. Raises InputError for any other text."""
    number, slash, count = text.partition("/")
    if slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count):
        return int(number), int(count)
    raise InputError(f"--shard is {text!r}: give I/N, such as 3/16 for the third of sixteen parts")


def shard(jobs: Iterable[Job], part: tuple[int, int] | None) -> Iterator[Job]:
    """The jobs of `part` (I, N): every N-th job from the I-th on; all jobs if `part` is None."""
    if part is None:
        return iter(jobs)
    number, count = part
    return islice(iter(jobs), number - 1, None, count)


def _rows(path: str | os.PathLike[str]) -> Iterator[tuple[int, Mapping[str, str]]]:
    name = os.fspath(path)
    try:
        with Path(path).open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
            reader = csv.DictReader(file, strict=True)
            names = [given.strip() for given in reader.fieldnames or ()]
            _require_columns(name, names)
            reader.fieldnames = names
            for row in reader:
                if None in row or None in row.values():
                    raise FormatError(
                        f"{name}, line {reader.line_num}: the row has not the {len(names)} cells of the "
                        "header: put text with a comma into quotes"
                    )
                yield reader.line_num, row
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror}") from None
    except csv.Error as error:
        raise FormatError(f"{name} is no CSV file: {error}") from None


def _require_columns(name: str, given: list[str]) -> None:
    unknown = [each for each in given if each not in COLUMNS]
    missing = [each for each in REQUIRED if each not in given]
    if unknown or missing or len(set(given)) < len(given):
        what = f"the column {unknown[0]!r} is unknown" if unknown else "a column is missing or given twice"
        raise FormatError(
            f"{name}: {what}: a manifest has the columns {', '.join(COLUMNS)}, and needs serial and files"
        )


def _paths(cell: str | None, folder: Path) -> tuple[str, ...]:
    names = [name.strip() for name in (cell or "").split(SEPARATOR)]
    return tuple(path_text(folder / name) for name in names if name)
