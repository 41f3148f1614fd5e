"""Access to the bytes of input files, and their SHA-256."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from imucal.errors import FormatError, ImucalError, InputError

__all__ = [
    "File",
    "Source",
    "first_bytes",
    "hashed_blocks",
    "is_folder",
    "open_file",
    "open_large",
    "parsing",
    "require_file",
]

# Number of bytes read at once to hash a file. A block of this size stays in the cache of the processor.
HASHED_AT_ONCE: Final = 1 << 17


@dataclass(frozen=True)
class Source:
    """A file from which a recording was read: its path as given, and the SHA-256 of its bytes."""

    path: str
    sha256: str


@dataclass(frozen=True)
class File:
    """A file loaded into memory."""

    name: str
    content: bytes
    source: Source


def open_file(path: str | os.PathLike[str]) -> File:
    """Load a file into memory.

    Raises InputError if the file is missing, a folder, or not readable, and FormatError if it is empty.
    """
    # Imported here, because hashlib loads OpenSSL (4 MB), which recordings made from arrays do not need.
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
    piece = memoryview(bytearray(HASHED_AT_ONCE))
    with _readable(given), Path(given).open("rb", buffering=0) as file:
        while count := file.readinto(piece):
            digest.update(piece[:count])
            size += count
    _refuse_empty(given, size)
    return Source(given, digest.hexdigest())


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a folder.

    If the path cannot be accessed, the result is False, and reading it reports the error.
    """
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


def hashed_blocks(
    path: str | os.PathLike[str], first: int, size: int, sources: list[Source]
) -> Iterator[bytes]:
    """The bytes of a file: the first `first` bytes, then blocks of `size`.

    After the last block, the Source of the file is appended to `sources`.

    Raises the errors of `open_file`.
    """
    import hashlib

    given, digest = os.fspath(path), hashlib.sha256()
    with _readable(given), Path(given).open("rb", buffering=0) as file:
        block = file.read(first)
        digest.update(block)
        yield block
        while block := file.read(size):
            digest.update(block)
            yield block
    sources.append(Source(given, digest.hexdigest()))


@contextmanager
def parsing(file: str, kind: str, way_out: str) -> Iterator[None]:
    """Convert any exception of a library that parses a file to a FormatError with the file and a remedy.

    Parsers raise all kinds of exceptions on damaged files, so every exception is treated as damage.

    kind      name of the format
    way_out   the remedy
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
        if not any(Path(given).iterdir()):
            raise InputError(
                f"{given} is a folder without files: give a recording, or check the path"
            ) from None
        raise InputError(f"{given} is a folder: give the file in it, or both files of a recording") from None
    except PermissionError:
        raise InputError(f"{given}: no permission to read it: change its mode or copy it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{given} cannot be read: {error}") from None


def _refuse_empty(given: str, size: int) -> None:
    if not size:
        raise FormatError(f"{given} is empty (0 bytes): record or export it again")
