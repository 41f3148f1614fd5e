"""Handling of SIGTERM and SIGHUP like Ctrl-C, so that motors are stopped and temporary files removed."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

__all__ = ["INTERRUPTED", "Ended", "as_interrupts"]

INTERRUPTED: Final = 128 + signal.SIGINT
# Names of the handled signals. Windows has no SIGHUP.
HANDLED: Final = ("SIGTERM", "SIGHUP")
# After the first signal, further signals within this time, s, are ignored. A closing terminal and its shell
# both send SIGHUP, and the second signal must not interrupt the stopping of the motors.
GRACE_S: Final = 5.0
# Delay, s, after which an interrupt that Python has discarded is raised again.
AGAIN_S: Final = 0.05


class Ended:
    """The signal that has ended the command, if any."""

    def __init__(self) -> None:
        self.by: signal.Signals | None = None
        self._last_signal_s = -GRACE_S

    def handle(self, number: int, _: Any) -> None:
        """Signal handler: raises KeyboardInterrupt."""
        now_s = time.monotonic()
        if now_s - self._last_signal_s < GRACE_S:
            return
        self.by, self._last_signal_s = signal.Signals(number), now_s
        _leave_closed_terminal()
        raise KeyboardInterrupt

    @property
    def what(self) -> str:
        """How the command ended, for a message, such as `ended by SIGTERM`."""
        return "interrupted" if self.by is None else f"ended by {self.by.name}"

    @property
    def code(self) -> int:
        """The exit code that shells use for a process that was ended by the signal."""
        return INTERRUPTED if self.by is None else 128 + self.by


@contextmanager
def as_interrupts() -> Iterator[Ended]:
    """Inside this block SIGTERM and SIGHUP raise KeyboardInterrupt.

    On POSIX, a KeyboardInterrupt that Python discards is raised again (`_discarded_again`). Python handles
    signals only in the main thread, so the block has no effect if another thread enters it.
    """
    ended = Ended()
    if threading.current_thread() is not threading.main_thread():
        yield ended
        return
    # If a signal is already ignored, as with nohup, it stays ignored.
    known = [getattr(signal, name) for name in HANDLED if hasattr(signal, name)]
    numbers = [number for number in known if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, ended.handle)
    try:
        with _discarded_again():
            yield ended
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def _discarded_again() -> Iterator[None]:
    """Inside this block, KeyboardInterrupt is raised again after 0.05 s (`AGAIN_S`) if Python discards it.

    Python prints and discards exceptions of destructors and of callbacks of weak references, such as those of
    its import system. Without this block, a command would go on if an interrupt arrived inside such a
    destructor or callback.
    """
    # Windows has no timers that raise a signal.
    if sys.platform == "win32" or signal.getsignal(signal.SIGALRM) != signal.SIG_DFL:
        yield
        return
    before = sys.unraisablehook

    def hook(discarded: sys.UnraisableHookArgs) -> None:
        if discarded.exc_type is KeyboardInterrupt:
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        else:
            before(discarded)

    signal.signal(signal.SIGALRM, signal.default_int_handler)
    sys.unraisablehook = hook
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = before
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


def _leave_closed_terminal() -> None:
    """If the terminal is closed, redirect output to the null device, so that later messages cannot fail."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
