"""A process of the local pool, which reads work from its standard input and writes the answers.

The processes are not started by `multiprocessing`, because it would run the caller's script again and does
not report which task was running when a process ended.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import struct
import sys
from contextlib import suppress
from functools import cache
from typing import IO, Any, Final, Protocol

__all__ = ["START", "Work", "do", "receive", "send", "serve"]

# Python program of a process of the pool. Its argument is the module search path of the parent, so that both
# import the same packages.
START: Final = (
    "import sys, ast; sys.path[:] = ast.literal_eval(sys.argv[1]); "
    "from imucal.fleet.worker import serve; serve()"
)
# Header of a message: the number of bytes of the pickle that follows.
LENGTH: Final = struct.Struct("<Q")


class Work(Protocol):
    """Work for a process of a pool. The work and its answer can be pickled."""

    def run(self) -> Any:
        """Do the work and return its answer."""

    def is_stuck(self, answer: Any) -> bool:
        """Whether the process that gave this answer is still busy with this work and has to be replaced."""


def do(work: Work) -> Any:
    """Run work and return its answer."""
    _keep_memory()
    return work.run()


# Maximum amount of freed memory, bytes, that a process keeps for its next recording and does not return to
# the operating system.
KEPT: Final = 128 << 20
# Parameter numbers of the function `mallopt` of the GNU C library, from malloc.h.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3


@cache
def _keep_memory() -> None:
    """Have the C library keep freed memory instead of returning it to the system after each array.

    Dask starts its workers with a threshold of 64 kB: the library returns freed memory beyond this amount.
    The calibration of a recording of 2 MB then takes a quarter longer, because the system clears each page
    again. Other C libraries have no `mallopt`.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(M_MMAP_THRESHOLD, KEPT // 4)
        library.mallopt(M_TRIM_THRESHOLD, KEPT)


def send(stream: IO[bytes], message: Any) -> None:
    """Write a message."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(LENGTH.pack(len(content)))
    stream.write(content)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read a message. Raises EOFError if the other side has closed the stream, even within a message."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    (size,) = LENGTH.unpack(head)
    content = stream.read(size)
    if len(content) < size:
        raise EOFError
    return pickle.loads(content)


def serve() -> None:
    """Do the work that the parent sends, until the parent closes the stream."""
    # Interrupts are ignored, because the parent ends its processes when the user interrupts it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = os.fdopen(os.dup(1), "wb")
    # Standard output is redirected to standard error, because text that libraries print must not be mixed
    # with the messages to the parent.
    os.dup2(2, 1)
    given = sys.stdin.buffer
    while True:
        try:
            send(replies, do(receive(given)))
        except (EOFError, BrokenPipeError):
            return
