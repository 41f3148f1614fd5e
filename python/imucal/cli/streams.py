"""Standard streams that stay usable after their reader has closed them, and text for a terminal.

A closed standard output only affects the printed text. All files are written, and the exit code is that of
the verdict.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from imucal.document.name import shown

__all__ = ["printable", "standing_streams"]

STANDARD_OUTPUT = 1
STANDARD_ERROR = 2


@contextmanager
def standing_streams() -> Iterator[None]:
    """Inside this block all standard streams are open, and a reader that closes them causes no error.

    Streams that a caller has replaced, as notebooks and tests do, are not changed.
    """
    _open_closed_descriptors()
    before: tuple[Any, Any] = sys.stdout, sys.stderr
    if sys.stdout is None:
        sys.stdout = _text_of(STANDARD_OUTPUT)
    elif sys.stdout is sys.__stdout__:
        with suppress(OSError):
            before[0].flush()
        sys.stdout = _text_of(STANDARD_OUTPUT)
    if sys.stderr is None:
        sys.stderr = _text_of(STANDARD_ERROR)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def printable(text: str) -> str:
    """Text for a terminal: characters that would move the cursor or reverse the text are escaped."""
    return shown(text, keep="\n\t")


def _open_closed_descriptors() -> None:
    """Open the null device for closed standard streams, so that no file opened later gets their number."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)


def _text_of(descriptor: int) -> io.TextIOWrapper:
    given = sys.__stdout__ if descriptor == STANDARD_OUTPUT else sys.__stderr__
    encoding = getattr(given, "encoding", None) or "utf-8"
    raw = _Standing(descriptor)
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=encoding, errors="backslashreplace", line_buffering=raw.isatty()
    )


class _Standing(io.RawIOBase):
    """A standard stream that discards all output after its reader has closed it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def fileno(self) -> int:
        return self._descriptor

    def write(self, data: Any) -> int:
        try:
            return os.write(self._descriptor, data)
        except BrokenPipeError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._descriptor)
            os.close(null)
            return memoryview(data).nbytes
