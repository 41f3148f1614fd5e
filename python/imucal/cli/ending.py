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
# Time, s, after which an interrupt is raised again that Python has discarded.
AGAIN_S: Final = 0.01


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

    def discarded(self) -> signal.Signals:
        """Forget the last signal, whose KeyboardInterrupt Python discarded; the signal to raise again."""
        by, self.by, self._last_signal_s = self.by, None, -GRACE_S
        return signal.SIGINT if by is None else by

    @property
    def what(self) -> str:
        """Description for a message."""
        return "interrupted" if self.by is None else f"ended by {self.by.name}"

    @property
    def code(self) -> int:
        """The exit code that shells use for a process ended by this signal."""
        return INTERRUPTED if self.by is None else 128 + self.by


@contextmanager
def as_interrupts() -> Iterator[Ended]:
    """Inside this block SIGTERM and SIGHUP raise KeyboardInterrupt, and no interrupt is discarded."""
    ended = Ended()
    numbers = []
    # Handlers are set only in the main thread, because signals interrupt only the main thread. If a signal is
    # already ignored, as with nohup, it stays ignored.
    if threading.current_thread() is threading.main_thread():
        known = [getattr(signal, name) for name in HANDLED if hasattr(signal, name)]
        numbers = [number for number in known if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, ended.handle)
    try:
        with _discarded_again(ended):
            yield ended
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def _discarded_again(ended: Ended) -> Iterator[None]:
    """Inside this block, an interrupt that Python discards is raised again a moment later.

    Python prints and discards exceptions of destructors and of callbacks of weak references, which its import
    system uses. Without this block, a command would go on if an interrupt arrived inside one of them.
    """
    before = sys.unraisablehook
    again: list[threading.Timer] = []

    def hook(discarded: sys.UnraisableHookArgs) -> None:
        if discarded.exc_type is KeyboardInterrupt:
            again.append(threading.Timer(AGAIN_S, _raise, [ended.discarded()]))
            again[-1].daemon = True
            again[-1].start()
        else:
            before(discarded)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
        for timer in again:
            timer.cancel()


def _raise(number: signal.Signals) -> None:
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:
        # Unlike raise_signal in another thread, this also ends a system call in which the main thread waits.
        os.kill(os.getpid(), number)


def _leave_closed_terminal() -> None:
    """If the terminal is closed, redirect output to the null device, so that later messages cannot fail."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
