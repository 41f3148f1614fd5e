"""A pool of a Dask cluster, with the interface of the pool of this computer."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Final

from imucal.errors import ImucalError
from imucal.fleet.local import Done, Ended
from imucal.fleet.worker import Work, do

__all__ = ["DaskPool"]

EXTRA: Final = "needs Dask: pip install 'imucal-rs[fleet]'"
# Tasks in the cluster per thread of a worker; the scheduler needs a few to have none of them wait.
PER_THREAD: Final = 3
# Time, s, in which a scheduler answers, also on a busy network.
CONNECT_S: Final = 30
# Longest time, s, in which a worker restarts.
RESTART_S: Final = 30
# The state of the connection is looked at after this time, s, without a task that ends.
POLL_S: Final = 1.0


class DaskPool:
    """The workers of a Dask scheduler.

    scheduler   its address, such as tcp://HOST:PORT, or a `distributed.Client`
    connect_s   a scheduler that does not answer for this time, s, is not there
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
                "scheduler`, and "
                "workers with `dask worker ADDRESS`"
            ) from None
        self.processes = max(threads, 1)
        self.capacity = PER_THREAD * self.processes
        self._futures: dict[Any, Work] = {}

    def submit(self, work: Work) -> None:
        """Do this work. Its class is imported by the worker, so imucal must be installed there."""
        # A task whose worker ends is lost at once. The scheduler would give it to further workers, and end
        # them.
        future = self._client.submit(do, work, pure=False, retries=0)
        self._futures[future] = work

    def next(self) -> Done:
        """Wait for any work. Raises ImucalError if the scheduler is lost."""
        import distributed
        from distributed.scheduler import KilledWorker

        # Dask's functions have no types.
        wait: Any = distributed.wait

        while True:
            self._require_scheduler()
            try:
                # The client is not Dask's default one, which is the user's.
                with self._client.as_current():
                    done = wait(list(self._futures), timeout=POLL_S, return_when="FIRST_COMPLETED").done
            except (TimeoutError, asyncio.TimeoutError):
                continue
            except Exception as error:
                # The class of the error of a closed connection depends on Dask's version.
                raise self._lost() from error
            for future in done:
                if future.status == "lost":
                    # Its worker ended before the result was taken; the scheduler computes the task again.
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
                    "install the "
                    "same version of imucal on it"
                )

    def _replace_worker_of(self, future: Any) -> None:
        """Restart the process that has computed a future; what else it computes is given to others."""
        # A worker without a nanny cannot be restarted, and keeps its thread.
        with suppress(Exception):
            self._client.restart_workers(list(self._client.who_has([future])[future.key]), timeout=RESTART_S)

    def close(self) -> None:
        """Cancel what is in the cluster and disconnect."""
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
            f"the scheduler {self._address} is lost: what was in the store is in it; start the scheduler, "
            "and run "
            "the same command again"
        )
