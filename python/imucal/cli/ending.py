"""SIGTERM and SIGHUP end a command as Ctrl-C does: the motors of a stand stop, and temporary files go."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

__all__ = ["INTERRUPTED", "Ended", "as_interrupts"]

INTERRUPTED: Final = 128 + signal.SIGINT
# Windows has no SIGHUP.
HEARD: Final = ("SIGTERM", "SIGHUP")
# A terminal that is closed sends SIGHUP, and its shell once more: that must not break off the stop of motors.
GRACE_S: Final = 5.0


class Ended:
    """By which signal the command was ended, if it was."""

    def __init__(self) -> None:
        self.by: signal.Signals | None = None
        self._heard_s = -GRACE_S

    def hear(self, number: int, _: Any) -> None:
        """A signal has come."""
        now_s = time.monotonic()
        if now_s - self._heard_s < GRACE_S:
            return
        self.by, self._heard_s = signal.Signals(number), now_s
        _leave_closed_terminal()
        raise KeyboardInterrupt

    @property
    def what(self) -> str:
        """What happened, for a message."""
        return "interrupted" if self.by is None else f"ended by {self.by.name}"

    @property
    def code(self) -> int:
        """The exit code, as a shell has it for a process that a signal ended."""
        return INTERRUPTED if self.by is None else 128 + self.by


@contextmanager
def as_interrupts() -> Iterator[Ended]:
    """In this block SIGTERM and SIGHUP raise KeyboardInterrupt."""
    ended = Ended()
    numbers = []
    # Another thread cannot be interrupted, and who has a signal ignored, such as nohup, wants that.
    if threading.current_thread() is threading.main_thread():
        known = [getattr(signal, name) for name in HEARD if hasattr(signal, name)]
        numbers = [number for number in known if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, ended.hear)
    try:
        yield ended
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def _leave_closed_terminal() -> None:
    """What is said from now on must not fail where nobody can read it."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
