"""Units per second of a plain loop, of 1 and 2 processes, and of Dask clusters of 2 workers."""

import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import dask
import numpy as np
from distributed import Client, LocalCluster

import imucal
from fleet.simulated import plan, unit_of, write_manifest, write_one

__all__ = ["DASK", "LOOP", "ONE", "PROFILED", "ROUNDS", "TWO", "TWO_LOOPS", "WAYS", "rates"]

WAYS = LOOP, TWO_LOOPS, ONE, TWO, DASK, PROFILED = (
    "a plain loop",
    "two plain loops at once",
    "1 process",
    "2 processes",
    "Dask, 2 workers",
    "Dask, 2 workers with a profiler",
)
# The recordings of 1 MB: the paper's gyroscope program at this sampling rate.
LARGE_RATE_HZ = 100.0
# The speed of a virtual machine changes within minutes. Ratios are therefore taken within a round, and every
# second round goes through the ways backwards.
ROUNDS = 7


def rates(folder: Path, units: int, *, large: bool) -> tuple[float, dict[str, list[float]]]:
    """Mean size of a recording, bytes, and units per second of each way in each round."""
    manifest, files = _recordings(folder, units, large=large)
    size = float(np.mean([path.stat().st_size for path in files]))
    measured: dict[str, Callable[[], float]] = {
        LOOP: lambda: _loop(files),
        TWO_LOOPS: lambda: _two_loops(files),
        ONE: lambda: _timed(folder, manifest, units, workers=1),
        TWO: lambda: _timed(folder, manifest, units, workers=2),
        # docs/fleet.md starts workers without the profiler, which Dask starts by default.
        DASK: lambda: _on_cluster(folder, manifest, units, has_profiler=False),
        PROFILED: lambda: _on_cluster(folder, manifest, units, has_profiler=True),
    }
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for round_number in range(ROUNDS):
        for way in WAYS[:: 1 if round_number % 2 == 0 else -1]:
            found[way].append(measured[way]())
    return size, found


def _on_cluster(folder: Path, manifest: Path, units: int, *, has_profiler: bool) -> float:
    with (
        dask.config.set({"distributed.worker.profile.enabled": has_profiler}),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        # A cluster stands before a run, so its workers have loaded their libraries.
        client.run(_load)
        return _timed(folder, manifest, units, scheduler=client)


def _load() -> None:
    import imucal.fleet.task  # noqa: F401


def _recordings(folder: Path, units: int, *, large: bool) -> tuple[Path, list[Path]]:
    planned = [replace(each, bad=None) for each in plan(max(units, 2000))[0][:units]]
    inside = folder / ("large" if large else "tiny")
    for each in planned:
        path = inside / each.file
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            continue
        if not large:
            write_one(inside, each)
            continue
        run = imucal.simulate(
            "random", seed=each.seed, unit=unit_of(each.number, 42), rate_hz=LARGE_RATE_HZ
        ).recording
        columns = {"accel_mps2": run.specific_force, "gyro_radps": run.angular_rate}
        np.savez(path, time_s=run.time_s, **{name: values.astype("f4") for name, values in columns.items()})
    write_manifest(inside / "manifest.csv", planned)
    return inside / "manifest.csv", [inside / each.file for each in planned]


def _loop(files: list[Path]) -> float:
    started = time.perf_counter()
    for path in files:
        imucal.calibrate(imucal.read(path), serial_number=path.stem).calibration.to_dict()
    return len(files) / (time.perf_counter() - started)


def _two_loops(files: list[Path]) -> float:
    """What the two processors give to processes that share nothing."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        # The processes start and load the library before the time is taken.
        list(processes.map(_loop, (files[:5], files[5:10])))
        return sum(processes.map(_loop, (files[::2], files[1::2])))


def _timed(folder: Path, manifest: Path, units: int, **where: object) -> float:
    store = folder / f"speed-{os.getpid()}-{time.monotonic_ns()}.sqlite"
    started = time.perf_counter()
    tally = imucal.Fleet(store).run(manifest, total=units, **where)
    elapsed_s = time.perf_counter() - started
    if tally.done != units:
        sys.exit(f"{where}: {tally.to_dict()}")
    return units / elapsed_s
