"""The file of a guided recording (a capture): a CSV file that grows by rows and is valid at any time.

The marker file OUT.csv.capture next to OUT.csv marks the recording as unfinished. It is removed at the end.
While the marker file exists, the same command continues the recording.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.appending import lock, write_all
from imucal.document.atomic import write_text
from imucal.errors import FormatError, InputError

__all__ = ["CaptureFile", "marker_of"]

SCHEMA: Final = "imucal.capture/1"


def marker_of(path: str | os.PathLike[str]) -> Path:
    """The path of the file that marks the recording at `path` as unfinished."""
    return Path(f"{os.fspath(path)}.capture")


class CaptureFile:
    """A recording to which rows are appended; for use in a `with` block. The file is locked while it is open.

    about     further fields of the marker file. To continue a recording, they must have the values that the
              marker file contains
    existing  existing rows of a file that is continued, (N, columns)
    age_s     time since the last existing row was written, s

    Raises InputError if the file exists and is not an unfinished recording with these columns and this
    `about`, or if the file cannot be written.
    """

    def __init__(
        self, path: str | os.PathLike[str], columns: Sequence[str], about: Mapping[str, Any]
    ) -> None:
        self.path, self.columns = Path(path), tuple(columns)
        if self.path.suffix.lower() != ".csv":
            raise InputError(f"{path}: a capture is written as .csv: change the extension")
        self._header = (",".join(self.columns) + "\n").encode()
        # Position of the end of each row in the file, bytes.
        self._ends: list[int] = []
        self.existing, self.age_s = np.zeros((0, len(self.columns))), 0.0
        marker = marker_of(path)
        document = {"schema": SCHEMA, "columns": list(self.columns), **about}
        continues = self.path.exists() and self.path.stat().st_size > 0
        if continues:
            self.age_s = max(time.time() - self.path.stat().st_mtime, 0.0)
            _require_same(self.path, marker, document)
        try:
            if not continues:
                write_text(marker, json.dumps(document, indent=2) + "\n")
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            _lock(self._file, self.path)
            if continues:
                self._continue()
            else:
                self._write(self._header)
                self._size = len(self._header)
            self.sync()
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> CaptureFile:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            # The file is truncated to its known size, because an interrupt may have occurred after a row was
            # written and before the size was updated.
            os.ftruncate(self._file, self._size)
            os.fsync(self._file)
        os.close(self._file)
        if not self._ends:
            # The files are removed, because a file without samples would block the next attempt.
            self.path.unlink(missing_ok=True)
            marker_of(self.path).unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._ends)

    def append(self, rows: FloatArray) -> None:
        """Append rows, (N, columns). Reading the file returns every number bit for bit."""
        if len(rows) == 0:
            return
        lines = [(",".join(map(_number, row)) + "\n").encode() for row in rows.tolist()]
        self._write(b"".join(lines))
        for line in lines:
            self._size += len(line)
            self._ends.append(self._size)

    def truncate(self, count: int) -> None:
        """Keep the first `count` rows."""
        self._ends = self._ends[:count]
        self._size = self._ends[-1] if self._ends else len(self._header)
        try:
            os.ftruncate(self._file, self._size)
            os.lseek(self._file, 0, os.SEEK_END)
        except OSError as error:
            raise self._unwritable(error) from error
        self.sync()

    def sync(self) -> None:
        """Flush all rows to the disk."""
        try:
            os.fsync(self._file)
        except OSError as error:
            raise self._unwritable(error) from error

    def finish(self) -> None:
        """Mark the recording as finished."""
        self.sync()
        marker_of(self.path).unlink(missing_ok=True)

    def _continue(self) -> None:
        """Read the rows of the file, and remove the last line if it was incomplete when the command ended."""
        with self.path.open("rb") as file:
            content = file.read()
        if not content.startswith(self._header):
            names = content.split(b"\n", 1)[0].decode("utf-8", "replace")
            raise InputError(
                f"{self.path} has the columns {names}, but the unit sends {','.join(self.columns)}: give the "
                "options of the interrupted recording, or another file"
            )
        lines = content[len(self._header) :].split(b"\n")[:-1]
        try:
            rows = [[float(cell or "nan") for cell in line.split(b",")] for line in lines]
            self.existing = np.array(rows, dtype=np.float64).reshape(len(rows), len(self.columns))
        except ValueError:
            raise FormatError(
                f"{self.path} has rows that are not {len(self.columns)} numbers: it was changed since it was "
                "recorded; record into another file"
            ) from None
        sizes = [len(line) + 1 for line in lines]
        self._ends = (len(self._header) + np.cumsum(sizes, dtype=np.int64)).tolist() if sizes else []
        self.truncate(len(rows))

    def _write(self, data: bytes) -> None:
        try:
            write_all(self._file, data)
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(
            f"{self.path} cannot be written: {error.strerror}; the rows before are kept: solve the problem "
            "(for a full disk: make room), and give the same command to continue"
        )


def _require_same(path: Path, marker: Path, document: Mapping[str, Any]) -> None:
    """Raises InputError unless `path` is an unfinished recording of the kind that `document` describes.

    The JSON file `marker` beside an unfinished recording must have the fields and values of `document`.
    """
    if not marker.exists():
        raise InputError(f"{path} exists: give another file; only an unfinished recording can be continued")
    try:
        before = json.loads(marker.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        before = None
    if not isinstance(before, dict) or before.get("schema") != SCHEMA:
        raise FormatError(
            f"{marker} does not describe an unfinished recording: remove it, and record into another file"
        )
    for name, value in document.items():
        if before.get(name) != value:
            raise InputError(
                f"{path} is an unfinished recording with {name} {before.get(name)!r}, not {value!r}: give "
                "the options of that recording to continue it, or another file"
            )


def _lock(file: int, path: Path) -> None:
    try:
        lock(file)
    except BlockingIOError:
        raise InputError(
            f"{path} is being recorded by another process: wait until it ends, or give another file"
        ) from None
    except OSError:
        # Some network file systems do not support locks.
        return


def _number(value: float) -> str:
    """The shortest text from which exactly this number is read.

    Integers have no decimal point, and NaN is an empty cell.
    """
    if value != value:
        return ""
    return str(int(value)) if value.is_integer() and abs(value) < 2.0**53 else repr(value)
