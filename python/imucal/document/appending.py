"""Files to which data are appended while they arrive: complete writes, and a lock against a second writer."""

from __future__ import annotations

import os

__all__ = ["lock", "write_all"]


def write_all(file: int, data: bytes) -> None:
    """Write all bytes to an open file. Raises OSError."""
    done = os.write(file, data)
    while done < len(data):
        done += os.write(file, data[done:])


def lock(file: int) -> None:
    """Lock an open file until it is closed.

    Raises BlockingIOError if another process has locked the file, and OSError if the file system does not
    support locks.
    """
    try:
        import fcntl
    except ImportError:
        # Windows has no fcntl, so a second process that writes to the file is not detected on Windows.
        return
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
