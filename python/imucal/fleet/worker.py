"""A process of the local pool: takes tasks from its standard input, and writes their outcomes.

The processes are started with this module instead of by `multiprocessing`, which would run the caller's
script again and which does not tell whose task has ended a process.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
from typing import IO, Any, Final

__all__ = ["START", "receive", "send", "serve"]

# Program of a process: its argument is the search path of its parent, so that it finds the same packages.
START: Final = (
    "import sys, ast; sys.path[:] = ast.literal_eval(sys.argv[1]); "
    "from imucal.fleet.worker import serve; serve()"
)
# A message is its length, and a pickle of this many bytes.
LENGTH: Final = struct.Struct("<Q")


def send(stream: IO[bytes], message: Any) -> None:
    """Write a message."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(LENGTH.pack(len(content)))
    stream.write(content)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read a message; EOFError if the other side is gone, also in the middle of one."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    (size,) = LENGTH.unpack(head)
    content = stream.read(size)
    if len(content) < size:
        raise EOFError
    return pickle.loads(content)


def serve() -> None:
    """Run tasks until the parent is gone."""
    # The parent ends its processes itself when the user interrupts it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = os.fdopen(os.dup(1), "wb")
    # What a library prints must not end up between the messages.
    os.dup2(2, 1)
    tasks = sys.stdin.buffer
    from imucal.fleet.task import run_task

    while True:
        try:
            task = receive(tasks)
            send(replies, run_task(task))
        except (EOFError, BrokenPipeError):
            return
