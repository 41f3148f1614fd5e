"""The clock of a run. All waits use this clock, so that tests can replace it by a virtual clock."""

from __future__ import annotations

import time
from queue import SimpleQueue
from threading import Thread
from typing import Final, Protocol, TypeVar

__all__ = ["SYSTEM_CLOCK", "Clock", "SystemClock"]

Item = TypeVar("Item")


class Clock(Protocol):
    """A monotonic clock. A run waits only by the methods of this clock."""

    def now_s(self) -> float:
        """Seconds since an arbitrary instant."""

    def sleep(self, duration_s: float) -> None:
        """Return after `duration_s`."""

    def next_item(self, queue: SimpleQueue[Item], wait_s: float) -> Item:
        """Take the next item of a queue. Raises `queue.Empty` if none arrives within `wait_s`."""

    def start_work(self, thread: Thread) -> None:
        """Start `thread`, a computation in parallel to the run."""


class SystemClock:
    """The monotonic clock of the computer."""

    def now_s(self) -> float:
        """Seconds since an arbitrary instant."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Block this thread for `duration_s`."""
        time.sleep(duration_s)

    def next_item(self, queue: SimpleQueue[Item], wait_s: float) -> Item:
        """Take the next item of a queue. Raises `queue.Empty` if none arrives within `wait_s`."""
        return queue.get(timeout=wait_s)

    def start_work(self, thread: Thread) -> None:
        """Start the thread and return at once."""
        thread.start()


SYSTEM_CLOCK: Final = SystemClock()
