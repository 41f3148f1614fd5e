"""Writing a file so that a killed process leaves the old file or the new one, never a part."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from imucal.errors import InputError

__all__ = ["write_atomically", "write_text"]


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that takes the place of `path` when the block ends well.

    The bytes go to a temporary file in the same folder, are flushed to the disk, and the file is renamed; if
    anything goes wrong, an interrupt included, the temporary file is removed and `path` is as it was.
    Devices and pipes cannot be renamed over and are written directly.

    Raises InputError if the file cannot be written (no folder, no permission, disk full, ...).
    """
    try:
        given = Path(path)
        # By the path as it was given: what /dev/stdout of a pipe points to has no path of its own.
        if given.exists() and not given.is_file() and not given.is_dir():
            with given.open("wb") as device:
                yield device
            return
        # A symbolic link stays a link: the file it points to is replaced.
        target = Path(os.path.realpath(given))
        if target.is_dir():
            raise IsADirectoryError(21, "it is a folder, give a file's name")
        if not target.parent.is_dir():
            raise FileNotFoundError(2, f"there is no folder {target.parent}: make it first")
        descriptor, temporary = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                Path(temporary).chmod(_mode(target))
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)  # noqa: PTH105 (the name says what it does)
        except BaseException:
            with suppress(OSError):
                Path(temporary).unlink()
            raise
        _sync_folder(target.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{os.fspath(path)} cannot be written: {reason}; what was there is unchanged"
        ) from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` as UTF-8, the way `write_atomically` does.

    A file name that is no text in UTF-8 has lone surrogates; they are written as escapes, as JSON has them.
    """
    with write_atomically(path) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


def _mode(target: Path) -> int:
    """The permissions that an ordinary write would leave: those of the old file, or those of the umask."""
    if target.exists():
        return stat.S_IMODE(target.stat().st_mode)
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
