"""A pool of processes on this computer."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from signal import Signals
from typing import Any, Final, Protocol

from imucal.errors import ImucalError
from imucal.fleet.worker import START, Work, receive, send

__all__ = ["Done", "Ended", "LocalPool", "Pool", "processors"]


@dataclass(frozen=True)
class Ended:
    """Takes the place of an answer if the process ended without an answer.

    how   how the process ended: "by SIGSEGV" or "with exit code 3"; empty if it is not known
    """

    how: str = ""


# Pair of a submitted `Work` object and its answer. The answer is `Ended` if the process ended without one.
Done = tuple[Any, Any]
# Number of tasks in the pool per process. One task runs and the next one waits, so that the process can start
# the next task without waiting for the parent process.
PER_PROCESS: Final = 2
# Time, s, to wait for the exit code of a process whose pipes are closed.
ENDS_S: Final = 0.2
# Environment variables that restrict libraries to one thread, because their threads would compete with the
# other processes.
ONE_THREAD: Final = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_IO_THREADS": "1",
}


class Pool(Protocol):
    """Interface of a pool of processes that compute submitted tasks.

    processes  number of processes
    capacity   maximum number of tasks that are running or waiting in the pool
    """

    @property
    def processes(self) -> int:
        """The number of processes."""

    @property
    def capacity(self) -> int:
        """Maximum number of tasks in the pool."""

    def submit(self, work: Work) -> None:
        """Submit work."""

    def next(self) -> Done:
        """Wait until any submitted work ends. Returns the work with its answer.

        Raises ImucalError if no more work will end.
        """

    def close(self) -> None:
        """End the pool. Tasks in the pool are lost."""


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalPool:
    """Processes on this computer. One thread per process sends work to it and waits for the answers.

    bound   whether each process is bound to one processor, so that processes do not compete; only for a
            computer without other load
    """

    def __init__(self, processes: int | None = None, *, bound: bool = False) -> None:
        self.processes = processors() if processes is None else processes
        self.capacity = PER_PROCESS * self.processes
        self._tasks: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Done | BaseException] = queue.SimpleQueue()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock, self._closed = threading.Lock(), False
        self._threads = [
            threading.Thread(target=self._work, args=(number if bound else None,), daemon=True)
            for number in range(self.processes)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, work: Work) -> None:
        """Submit work."""
        self._tasks.put(work)

    def next(self) -> Done:
        """Wait until any work ends. Returns it with its answer. Raises ImucalError if no process starts."""
        # `get` is called with a timeout, because on Windows a wait without a timeout delays signals such as
        # Ctrl-C.
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

    def _work(self, number: int | None) -> None:
        child: subprocess.Popen[bytes] | None = None
        while (work := self._tasks.get()) is not None:
            try:
                child = child or self._started(number)
            except OSError as error:
                self._done.put(ImucalError(f"no process can be started: {error}: give a smaller --workers"))
                continue
            if child is None:
                break
            answer = _answer(child, work)
            if isinstance(answer, Ended):
                answer = Ended(_how(self._end(child)))
                child = None
            elif work.is_stuck(answer):
                self._end(child)
                child = None
            self._done.put((work, answer))
        if child is not None:
            self._end(child)

    def _started(self, number: int | None) -> subprocess.Popen[bytes] | None:
        """Start a process, bound to the processor `number` if it is given. Returns None after `close`."""
        with self._lock:
            if self._closed:
                return None
            child = subprocess.Popen(
                [sys.executable, "-c", START, repr(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=os.environ | ONE_THREAD,
                # The process has a separate session, so that Ctrl-C in a terminal reaches only the parent.
                # The parent then ends the process.
                start_new_session=True,
            )
            if number is not None and hasattr(os, "sched_setaffinity"):
                allowed = sorted(os.sched_getaffinity(0))
                os.sched_setaffinity(child.pid, {allowed[number % len(allowed)]})
            self._running.add(child)
            return child

    def _end(self, child: subprocess.Popen[bytes]) -> int | None:
        """End a process. Returns its exit code if it has ended by itself."""
        with self._lock:
            self._running.discard(child)
        # A process that has closed its pipe is about to end. Its exit code gives the reason.
        code: int | None = None
        with suppress(subprocess.TimeoutExpired):
            code = child.wait(ENDS_S)
        with suppress(OSError):
            child.kill()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        child.wait()
        return code


def _answer(child: subprocess.Popen[bytes], work: Work) -> Any:
    if child.stdin is None or child.stdout is None:
        return Ended()
    try:
        send(child.stdin, work)
        return receive(child.stdout)
    except (EOFError, OSError):
        return Ended()


def _how(code: int | None) -> str:
    if code is None:
        return ""
    if code >= 0:
        return f"with exit code {code}"
    with suppress(ValueError):
        return f"by {Signals(-code).name}"
    return f"by signal {-code}"
