"""The bytes of a file that is read, and the table that a format's reader makes of them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucal.errors import FormatError, InputError
from imucal.recording import Source

__all__ = ["File", "Table", "open_file"]


@dataclass(frozen=True)
class File:
    """A file, wholly in memory."""

    name: str
    content: bytes
    source: Source


@dataclass(frozen=True)
class Table:
    """Named columns of one file, as Arrow arrays of equal length."""

    file: str
    names: list[str]
    columns: list[Any]
    # Where row i stands in the file, for messages: "line 12".
    place: Callable[[int], str]

    def renamed(self, names: list[str]) -> Table:
        """The same columns under other names."""
        return Table(self.file, names, self.columns, self.place)


def open_file(path: str | os.PathLike[str]) -> File:
    """Read a file.

    Raises InputError if it is missing, a folder, or not readable, and FormatError if it is empty.
    """
    given = os.fspath(path)
    try:
        content = Path(given).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{given}: there is no such file: check the path") from None
    except IsADirectoryError:
        raise InputError(f"{given} is a folder: give the file in it") from None
    except PermissionError:
        raise InputError(f"{given}: no permission to read it: change its mode or copy it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{given} cannot be read: {error}") from None
    if not content:
        raise FormatError(f"{given} is empty (0 bytes): record or export it again")
    return File(Path(given).name, content, Source(given, hashlib.sha256(content).hexdigest()))
