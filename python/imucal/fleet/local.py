"""A pool of processes on this computer."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from typing import Final, Protocol

from imucal.errors import ImucalError
from imucal.fleet.outcome import Outcome
from imucal.fleet.task import Task
from imucal.fleet.worker import START, receive, send

__all__ = ["Done", "LocalPool", "Pool", "processors"]

# A task and its outcomes; None if the process ended without them.
Done = tuple[Task, list[Outcome] | None]
# Tasks in the pool per process: one that runs, and one that waits, so that no process waits for the parent.
PER_PROCESS: Final = 2
# Environment of a process: threads of these libraries would compete with the other processes.
ONE_THREAD: Final = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_IO_THREADS": "1",
}


class Pool(Protocol):
    """Processes that compute tasks.

    processes  their number
    capacity   largest number of tasks to submit at a time
    """

    @property
    def processes(self) -> int:
        """The number of processes."""

    @property
    def capacity(self) -> int:
        """Largest number of tasks in the pool at a time."""

    def submit(self, task: Task) -> None:
        """Compute a task."""

    def next(self) -> Done:
        """Wait for any task. Raises ImucalError if no more of them will end."""

    def close(self) -> None:
        """End the pool; tasks that are in it are lost."""


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalPool:
    """Processes of this computer, each with a thread that sends it tasks and waits for their outcomes."""

    def __init__(self, processes: int | None = None) -> None:
        self.processes = processors() if processes is None else processes
        self.capacity = PER_PROCESS * self.processes
        self._tasks: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Done | BaseException] = queue.SimpleQueue()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock, self._closed = threading.Lock(), False
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(self.processes)]
        for thread in self._threads:
            thread.start()

    def submit(self, task: Task) -> None:
        """Compute a task."""
        self._tasks.put(task)

    def next(self) -> Done:
        """Wait for any task. Raises ImucalError if no process can be started."""
        # A wait without a timeout would delay the signals of Windows.
        while True:
            try:
                done = self._done.get(timeout=1.0)
            except queue.Empty:
                continue
            if isinstance(done, BaseException):
                raise done
            return done

    def close(self) -> None:
        """End the processes."""
        with self._lock:
            self._closed = True
            running = list(self._running)
        for _ in self._threads:
            self._tasks.put(None)
        for child in running:
            child.kill()
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        child: subprocess.Popen[bytes] | None = None
        while (task := self._tasks.get()) is not None:
            try:
                child = child or self._started()
            except OSError as error:
                self._done.put(ImucalError(f"no process can be started: {error}: give a smaller --workers"))
                continue
            if child is None:
                break
            outcomes = _computed(child, task)
            if outcomes is None:
                self._end(child)
                child = None
            self._done.put((task, outcomes))
        if child is not None:
            self._end(child)

    def _started(self) -> subprocess.Popen[bytes] | None:
        """A new process; None after `close`."""
        with self._lock:
            if self._closed:
                return None
            child = subprocess.Popen(
                [sys.executable, "-c", START, repr(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=os.environ | ONE_THREAD,
                # Ctrl-C in a terminal reaches the parent only, which ends the processes.
                start_new_session=True,
            )
            self._running.add(child)
            return child

    def _end(self, child: subprocess.Popen[bytes]) -> None:
        with self._lock:
            self._running.discard(child)
        with suppress(OSError):
            child.kill()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        child.wait()


def _computed(child: subprocess.Popen[bytes], task: Task) -> list[Outcome] | None:
    """The outcomes of a task; None if the process ended without them."""
    if child.stdin is None or child.stdout is None:
        return None
    try:
        send(child.stdin, task)
        outcomes: list[Outcome] = receive(child.stdout)
        return outcomes
    except (EOFError, OSError):
        return None
