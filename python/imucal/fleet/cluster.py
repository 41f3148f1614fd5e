"""Pool of workers of a Dask cluster, with the same interface as the local pool."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Final

from imucal.errors import ImucalError
from imucal.fleet.local import Done, Ended
from imucal.fleet.worker import Work, do

__all__ = ["DaskPool"]

EXTRA: Final = "needs Dask: pip install 'imucal-rs[fleet]'"
# Number of tasks per worker thread that are submitted in advance, so that no thread has to wait for its next
# task.
PER_THREAD: Final = 3
# Timeout of the connection to a scheduler, s. This time is sufficient even on a busy network.
CONNECT_S: Final = 30
# Timeout of the restart of a worker, s.
RESTART_S: Final = 30
# Interval, s, at which the connection is checked while no task ends.
POLL_S: Final = 1.0


class DaskPool:
    """The workers of a Dask scheduler.

    scheduler   address of the scheduler, such as tcp://HOST:PORT, or a `distributed.Client`
    connect_s   timeout of the connection, s
    """

    def __init__(self, scheduler: Any, *, connect_s: float = CONNECT_S) -> None:
        try:
            import distributed
        except ImportError:
            raise ImucalError(f"a scheduler {EXTRA}") from None
        connect: Any = distributed.Client
        self._owned = isinstance(scheduler, str)
        self._address = scheduler if self._owned else "the scheduler"
        try:
            self._client = (
                connect(scheduler, timeout=connect_s, set_as_default=False) if self._owned else scheduler
            )
            threads = sum(self._client.nthreads().values())
        except (OSError, ValueError) as error:
            raise ImucalError(
                f"{self._address}: no scheduler answers within {connect_s:g} s: {error}: start `dask "
                "scheduler`, and workers with `dask worker ADDRESS`"
            ) from None
        self.processes = max(threads, 1)
        self.capacity = PER_THREAD * self.processes
        self._futures: dict[Any, Work] = {}

    def submit(self, work: Work) -> None:
        """Submit work. Workers import the class of the work, so they need an installation of imucal."""
        # Tasks are not retried. If a task kills its worker, the scheduler would give the task to further
        # workers, and the task would kill them, too.
        future = self._client.submit(do, work, pure=False, retries=0)
        self._futures[future] = work

    def next(self) -> Done:
        """Wait until one of the submitted tasks ends. Returns the task and its answer.

        Raises ImucalError if the scheduler is lost.
        """
        import distributed
        from distributed.scheduler import KilledWorker

        # `wait` has the type Any, because Dask's functions have no type annotations.
        wait: Any = distributed.wait

        while True:
            self._require_scheduler()
            try:
                # This client must not become Dask's default client, because the user may have set another
                # default client.
                with self._client.as_current():
                    done = wait(list(self._futures), timeout=POLL_S, return_when="FIRST_COMPLETED").done
            except (TimeoutError, asyncio.TimeoutError):
                continue
            except Exception as error:
                # Any exception is caught, because the class of the error for a closed connection depends on
                # Dask's version.
                raise self._lost() from error
            for future in done:
                if future.status == "lost":
                    # The worker ended before its result was fetched, so the scheduler computes the task
                    # again.
                    continue
                work = self._futures.pop(future)
                if future.status == "finished":
                    with suppress(Exception):
                        answer = future.result()
                        if work.is_stuck(answer):
                            self._replace_worker_of(future)
                        return work, answer
                if future.status in ("finished", "cancelled", "lost", "pending"):
                    self._require_scheduler()
                    return work, Ended()
                failure = future.exception()
                if isinstance(failure, KilledWorker):
                    return work, Ended()
                raise ImucalError(
                    f"a worker of {self._address} cannot run tasks: {type(failure).__name__}: {failure}: "
                    "install the same version of imucal on it"
                )

    def _replace_worker_of(self, future: Any) -> None:
        """Restart the worker process that has computed a future.

        The scheduler gives the other tasks of this process to other workers.
        """
        # A worker that runs without Dask's nanny process cannot be restarted. The job that exceeded its time
        # limit then continues to occupy a thread of this worker.
        with suppress(Exception):
            self._client.restart_workers(list(self._client.who_has([future])[future.key]), timeout=RESTART_S)

    def close(self) -> None:
        """Cancel all submitted tasks and disconnect."""
        with suppress(Exception):
            self._client.cancel(list(self._futures), force=True)
        self._futures.clear()
        if self._owned:
            with suppress(Exception):
                self._client.close(timeout=2)

    def _require_scheduler(self) -> None:
        if self._client.status != "running":
            raise self._lost()

    def _lost(self) -> ImucalError:
        return ImucalError(
            f"the scheduler {self._address} is lost: results that are already in the store are safe; start "
            "the scheduler, and run the same command again"
        )
