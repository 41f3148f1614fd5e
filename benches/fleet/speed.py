"""Units per second of a plain loop, of 1 and 2 processes, and of a Dask cluster of 2."""

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster

import imucal
from fleet.simulated import plan, unit_of, write_manifest, write_one

__all__ = ["WAYS", "Rate", "rates"]

WAYS = ("a plain loop", "1 process", "2 processes", "Dask, 2 workers")
# The recordings of 1 MB: the paper's gyroscope program at this sampling rate.
LARGE_RATE_HZ = 200.0


@dataclass(frozen=True)
class Rate:
    """Units per second of one way, with the start of its processes."""

    way: str
    units: int
    elapsed_s: float

    @property
    def per_s(self) -> float:
        return self.units / self.elapsed_s


def rates(folder: Path, units: int, *, large: bool) -> tuple[float, list[Rate]]:
    """Mean size of a recording, bytes, and the rate of each way."""
    manifest, files = _recordings(folder, units, large=large)
    size = float(np.mean([path.stat().st_size for path in files]))
    found = [_loop(files)]
    for way, workers in (("1 process", 1), ("2 processes", 2)):
        found.append(_timed(way, folder, manifest, units, workers=workers))
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        # A cluster stands before a run, so its workers have loaded their libraries.
        client.run(_load)
        found.append(_timed(WAYS[-1], folder, manifest, units, scheduler=client))
    return size, found


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


def _loop(files: list[Path]) -> Rate:
    started = time.perf_counter()
    for path in files:
        imucal.calibrate(imucal.read(path), serial_number=path.stem).calibration.to_dict()
    return Rate(WAYS[0], len(files), time.perf_counter() - started)


def _timed(way: str, folder: Path, manifest: Path, units: int, **where: object) -> Rate:
    store = folder / f"speed-{os.getpid()}-{time.monotonic_ns()}.sqlite"
    started = time.perf_counter()
    tally = imucal.Fleet(store).run(manifest, total=units, **where)
    elapsed_s = time.perf_counter() - started
    if tally.done != units:
        sys.exit(f"{way}: {tally.to_dict()}")
    return Rate(way, units, elapsed_s)
