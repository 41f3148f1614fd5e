"""Access to the bytes of input files, and the table that the reader of a format returns."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucal.errors import FormatError, ImucalError, InputError
from imucal.recording.recording import Source

__all__ = [
    "ROWS_AT_ONCE",
    "File",
    "Stored",
    "Table",
    "first_bytes",
    "is_folder",
    "open_file",
    "open_large",
    "parsing",
    "parts",
    "require_file",
]

# Bytes read at once to hash a file.
HASHED_AT_ONCE = 1 << 20
# Rows of a table processed at once; their columns fit into the processor's cache.
ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class File:
    """A file loaded into memory."""

    name: str
    content: bytes
    source: Source


@dataclass(frozen=True)
class Stored:
    """A column whose values are read on demand; `batches` reads the named columns of its file."""

    name: str
    type: Any
    rows: int
    batches: Callable[[list[str]], Iterator[Any]]

    def __len__(self) -> int:
        return self.rows


@dataclass(frozen=True)
class Table:
    """Named columns of one file, of equal length: either Arrow arrays or `Stored` columns."""

    file: str
    names: list[str]
    columns: list[Any]
    # Location of row i in the file, for messages: "line 12".
    place: Callable[[int], str]

    def column(self, name: str) -> Any:
        """The column of this name."""
        return self.columns[self.names.index(name)]

    def renamed(self, names: list[str]) -> Table:
        """The columns under new names."""
        return Table(self.file, names, self.columns, self.place)


def parts(columns: Sequence[Any]) -> Iterator[list[Any]]:
    """The columns of a table in parts of at most `ROWS_AT_ONCE` rows."""
    if columns and isinstance(columns[0], Stored):
        for batch in columns[0].batches([column.name for column in columns]):
            yield [batch.column(column.name) for column in columns]
    elif columns:
        import pyarrow as pa

        table = pa.table(list(columns), names=[str(index) for index in range(len(columns))])
        for batch in table.to_batches(max_chunksize=ROWS_AT_ONCE):
            yield batch.columns


def open_file(path: str | os.PathLike[str]) -> File:
    """Load a file into memory.

    Raises InputError if the file is missing, a folder, or not readable, and FormatError if it is empty.
    """
    # Imported here because it loads OpenSSL (4 MB), which recordings made from arrays do not need.
    # It loads OpenSSL, 4 MB: recordings that are made of arrays need none.
    import hashlib

    given = os.fspath(path)
    with _readable(given):
        content = Path(given).read_bytes()
    _refuse_empty(given, len(content))
    return File(Path(given).name, content, Source(given, hashlib.sha256(content).hexdigest()))


def open_large(path: str | os.PathLike[str]) -> Source:
    """Hash a file without keeping its contents, for formats whose library reads the file itself.

    Raises the errors of `open_file`.
    """
    import hashlib

    given = os.fspath(path)
    digest, size = hashlib.sha256(), 0
    with _readable(given), Path(given).open("rb") as file:
        while piece := file.read(HASHED_AT_ONCE):
            digest.update(piece)
            size += len(piece)
    _refuse_empty(given, size)
    return Source(given, digest.hexdigest())


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a folder; False if it cannot be accessed, which reading it will report."""
    return os.path.isdir(path)  # noqa: PTH112 (pathlib raises instead)


def require_file(path: str | os.PathLike[str]) -> None:
    """Raises InputError for a pipe or a device, because a recording is read more than once."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return  # Opening the file reports the error.
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{os.fspath(path)} is a pipe or a device: save its data to a file, and give that")


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes:
    """The first bytes of a file. Raises the errors of `open_file`."""
    given = os.fspath(path)
    with _readable(given), Path(given).open("rb") as file:
        content = file.read(count)
    _refuse_empty(given, len(content))
    return content


@contextmanager
def parsing(file: str, kind: str, way_out: str) -> Iterator[None]:
    """Convert any exception of a format's library to a FormatError with the file and a suggested remedy.

    Parsers raise all kinds of exceptions on damaged files, so every exception is treated as damage.
    """
    try:
        yield
    except (ImucalError, MemoryError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(
            f"{file} cannot be read as {kind}: {reason[:200]}: it is damaged, truncated or of an unknown "
            f"version: {way_out}"
        ) from None


@contextmanager
def _readable(given: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{given}: there is no such file: check the path") from None
    except IsADirectoryError:
        raise InputError(f"{given} is a folder: give the file in it") from None
    except PermissionError:
        raise InputError(f"{given}: no permission to read it: change its mode or copy it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{given} cannot be read: {error}") from None


def _refuse_empty(given: str, size: int) -> None:
    if not size:
        raise FormatError(f"{given} is empty (0 bytes): record or export it again")
