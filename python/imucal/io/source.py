"""The bytes of a file that is read, and the table that a format's reader makes of them."""

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

HASHED_AT_ONCE = 1 << 20
ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class File:
    """A file, wholly in memory."""

    name: str
    content: bytes
    source: Source


@dataclass(frozen=True)
class Stored:
    """A column that is still in its file; `batches` reads columns of that file by their names."""

    name: str
    type: Any
    rows: int
    batches: Callable[[list[str]], Iterator[Any]]

    def __len__(self) -> int:
        return self.rows


@dataclass(frozen=True)
class Table:
    """Named columns of one file, of equal length: Arrow arrays, or all of them still in the file."""

    file: str
    names: list[str]
    columns: list[Any]
    # Where row i stands in the file, for messages: "line 12".
    place: Callable[[int], str]

    def column(self, name: str) -> Any:
        """The column of this name."""
        return self.columns[self.names.index(name)]

    def renamed(self, names: list[str]) -> Table:
        """The same columns under other names."""
        return Table(self.file, names, self.columns, self.place)


def parts(columns: Sequence[Any]) -> Iterator[list[Any]]:
    """The columns of a table in parts of a few thousand rows, which are in the cache when they are used."""
    if columns and isinstance(columns[0], Stored):
        for batch in columns[0].batches([column.name for column in columns]):
            yield [batch.column(column.name) for column in columns]
    elif columns:
        import pyarrow as pa

        table = pa.table(list(columns), names=[str(index) for index in range(len(columns))])
        for batch in table.to_batches(max_chunksize=ROWS_AT_ONCE):
            yield batch.columns


def open_file(path: str | os.PathLike[str]) -> File:
    """Read a file.

    Raises InputError if it is missing, a folder, or not readable, and FormatError if it is empty.
    """
    # It loads OpenSSL, 4 MB: recordings that are made of arrays need none.
    import hashlib

    given = os.fspath(path)
    with _readable(given):
        content = Path(given).read_bytes()
    _refuse_empty(given, len(content))
    return File(Path(given).name, content, Source(given, hashlib.sha256(content).hexdigest()))


def open_large(path: str | os.PathLike[str]) -> Source:
    """The source of a file that its format's library reads; its bytes pass through, they are not kept.

    Raises as `open_file` does.
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
    """Whether it is a folder; False for what cannot be seen, which reading it then tells."""
    return os.path.isdir(path)  # noqa: PTH112 (pathlib raises instead)


def require_file(path: str | os.PathLike[str]) -> None:
    """InputError for a pipe or a device: it can be read once, and a recording is looked at first."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return  # Reading it tells what is wrong.
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{os.fspath(path)} is a pipe or a device: write its data to a file, and give that")


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes:
    """The first bytes of a file; raises as `open_file` does."""
    given = os.fspath(path)
    with _readable(given), Path(given).open("rb") as file:
        content = file.read(count)
    _refuse_empty(given, len(content))
    return content


@contextmanager
def parsing(file: str, kind: str, way_out: str) -> Iterator[None]:
    """Turn whatever a format's library raises into a FormatError that names the file and the way out.

    A damaged file can break a parser anywhere, so any exception of it means the same.
    """
    try:
        yield
    except (ImucalError, MemoryError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(
            f"{file} cannot be read as {kind}: {reason[:200]}: it is damaged, cut off or of an unknown "
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
