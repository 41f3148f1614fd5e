"""A Dask scheduler and its workers as processes of their own, which can be killed."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from distributed import Client

__all__ = ["Cluster"]

# Longest time, s, in which a scheduler or its workers start, also on a computer with other work.
START_S = 240.0


class Cluster:
    """A scheduler and workers on this computer; `address` is that of the scheduler.

    start_files  folder of a sitecustomize.py for the workers
    """

    def __init__(self, folder: Path, *, workers: int, start_files: Path | None = None) -> None:
        environment = os.environ | {
            "OMP_NUM_THREADS": "1",
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        }
        if start_files is not None:
            before = environment.get("PYTHONPATH")
            environment["PYTHONPATH"] = os.pathsep.join([str(start_files), *([before] if before else [])])
        found = folder / f"scheduler-{time.monotonic_ns()}.json"
        words = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"]
        self._scheduler = _started([*words, "--scheduler-file", str(found)], environment)
        words = ["worker", "--nworkers", str(workers), "--nthreads", "1", "--no-dashboard"]
        words += ["--local-directory", str(folder), "--scheduler-file", str(found)]
        self._workers = _started(words, environment)
        end_s = time.monotonic() + START_S
        while not found.exists() and time.monotonic() < end_s:
            time.sleep(0.05)
        self.address = str(json.loads(found.read_text())["address"])
        with Client(self.address, set_as_default=False, timeout=START_S) as client:
            client.wait_for_workers(workers, timeout=START_S)

    @property
    def worker_parent(self) -> int:
        """The process whose children are the workers."""
        return self._workers.pid

    def kill_scheduler(self) -> None:
        """Kill the scheduler."""
        self._scheduler.kill()
        self._scheduler.wait()

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in (self._workers, self._scheduler):
            process.terminate()
        for process in (self._workers, self._scheduler):
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _started(words: list[str], environment: dict[str, str]) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
