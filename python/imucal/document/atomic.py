"""Atomic writing: a killed process leaves either the old file or the complete new file."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from imucal.document.temporary import TemporaryFile
from imucal.errors import InputError

__all__ = ["write_atomically", "write_text"]


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that replaces `path` if the block ends without an exception.

    The bytes are written to a temporary file in the same folder and flushed to the disk; then the file is
    renamed. After any exception, including an interrupt, the temporary file is removed and `path` is
    unchanged. A killed process leaves no temporary file either (`TemporaryFile`). Devices and pipes cannot be
    replaced and are written directly.

    Raises InputError if the file cannot be written (no folder, no permission, disk full, ...).
    """
    try:
        given = Path(path)
        # A pipe or device is opened by the given path, even if this path is a symbolic link such as
        # /dev/stdout. If standard output is a pipe, the target of this link is not a usable path.
        if given.exists() and not given.is_file() and not given.is_dir():
            with given.open("wb") as device:
                yield device
            return
        # If the path is a symbolic link, the link is kept, and the file to which it points is replaced.
        target = Path(os.path.realpath(given))
        if target.is_dir():
            raise IsADirectoryError(21, "it is a folder, give a file's name")
        if not target.parent.is_dir():
            raise FileNotFoundError(2, f"there is no folder {target.parent}: create it first")
        with TemporaryFile(target.parent) as temporary, os.fdopen(temporary.descriptor, "wb") as file:
            if target.exists() and hasattr(os, "fchmod"):
                os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
            yield file
            file.flush()
            os.fsync(file.fileno())
            temporary.replace(target, file)
        _sync_folder(target.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{os.fspath(path)} cannot be written: {reason}; what was there is unchanged"
        ) from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` as UTF-8, atomically.

    File names that are not valid UTF-8 contain lone surrogates; these are written as JSON-style escapes.
    """
    with write_atomically(path) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


def _sync_folder(folder: Path) -> None:
    """Flush the folder, so that the rename is durable on systems that support this."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
