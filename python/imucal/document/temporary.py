"""Temporary files that a killed process does not leave behind.

On Linux the file has no name until it is complete, so the kernel removes it with the process. On other
systems, and on file systems that do not support unnamed files, the file has a short hidden name and a lock
that ends with its process. The next process that writes into the folder removes files whose lock has ended.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final

try:
    import fcntl
except ImportError:  # Windows has no fcntl; users delete remaining files by hand.
    fcntl = None  # type: ignore[assignment]

__all__ = ["TemporaryFile"]

# Prefix of the name of a temporary file. The name of the target is not part of it, because that name may
# already have the maximum length of 255 bytes.
PREFIX: Final = ".imucal-"
SUFFIX: Final = ".tmp"
# A temporary file without a lock counts as left by a killed process if it is older than this time, s. A
# younger file may have been created by a running process that has not locked it yet.
LEFT_BEHIND_S: Final = 60.0
# Maximum number of attempts to link a complete file to its name while other processes write the same target.
ATTEMPTS: Final = 20


class TemporaryFile:
    """A temporary file in a folder that replaces the target file when it is complete.

    descriptor   file descriptor of the open file, for writing
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._name: Path | None = None
        self.descriptor = self._open()

    def __enter__(self) -> TemporaryFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the temporary file unless it has replaced the target file."""
        if self._name is not None:
            with suppress(OSError):
                self._name.unlink()

    def replace(self, target: Path, file: BinaryIO) -> None:
        """Put the temporary file, which is complete and flushed, in place of `target`."""
        if self._name is not None:
            # Windows renames closed files only.
            file.close()
            self._name.replace(target)
            self._name = None
            return
        with suppress(FileExistsError):
            self._link(target)
            return
        # A link cannot replace an existing file, but a rename can. Therefore the file is first linked to an
        # intermediate name and then renamed. The intermediate name depends only on the target. If the process
        # is killed between link and rename, the next process that writes this target replaces the
        # intermediate file.
        linked = self._folder / f"{PREFIX}{_digest(target.name)}{SUFFIX}"
        for attempt in range(ATTEMPTS):
            try:
                with suppress(FileNotFoundError):
                    linked.unlink()
                self._link(linked)
                linked.replace(target)
                return
            except (FileExistsError, FileNotFoundError):
                # The intermediate name already exists, or was just removed, because another process writes
                # the same target.
                if attempt == ATTEMPTS - 1:
                    raise
                time.sleep(0.01 * attempt)

    def _link(self, path: Path) -> None:
        """Link the unnamed file to a name in its folder."""
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            # The folder is given by its descriptor, because otherwise `os.link` does not follow the symbolic
            # link in /proc.
            os.link(f"/proc/self/fd/{self.descriptor}", path.name, dst_dir_fd=folder, follow_symlinks=True)
        finally:
            os.close(folder)

    def _open(self) -> int:
        """Open an unnamed file if the file system supports it, otherwise a named file."""
        if hasattr(os, "O_TMPFILE") and Path("/proc/self/fd").is_dir():
            # Not all file systems support files without a name.
            with suppress(OSError):
                return os.open(self._folder, os.O_TMPFILE | os.O_RDWR, 0o666)
        import tempfile

        _remove_left_behind(self._folder)
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, suffix=SUFFIX, dir=self._folder)
        self._name = Path(name)
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The default permissions are set, because a file of mkstemp can be read by the current user only.
        mask = os.umask(0)
        os.umask(mask)
        with suppress(OSError):
            self._name.chmod(0o666 & ~mask)
        return descriptor


def _digest(name: str) -> str:
    """A short name for a name of any length."""
    import zlib

    return f"{zlib.crc32(os.fsencode(name)):08x}"


def _remove_left_behind(folder: Path) -> None:
    """Remove files of processes that were killed."""
    if fcntl is None:
        return
    for path in folder.glob(f"{PREFIX}*{SUFFIX}"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime < LEFT_BEHIND_S:
                continue
            descriptor = os.open(path, os.O_RDWR)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(descriptor)
