"""Counts of kills: of the parent, of workers, and of a Dask scheduler; two parents, and a full disk."""

import random
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import imucal
from fleet.dask_processes import Cluster
from fleet.killing import Run, check, kill, start, workers_of
from fleet.simulated import plan, write_manifest, write_one

__all__ = ["Killed", "killed"]

UNITS = 60


@dataclass
class Killed:
    """Kills of one kind.

    lost       units that were told and are not in the store, and rows that are there twice or in part
    completed  further runs after which the store has all units
    """

    what: str
    kills: int = 0
    lost: int = 0
    completed: int = 0
    runs: int = 0


def killed(folder: Path, *, parents: int, workers: int, schedulers: int, seed: int = 1) -> list[Killed]:
    """Kill processes at random moments of runs of UNITS units."""
    draw = random.Random(seed)
    planned = [replace(each, bad=None) for each in plan(2000)[0][:UNITS]]
    for each in planned:
        (folder / each.date).mkdir(parents=True, exist_ok=True)
        write_one(folder, each)
    manifest = folder / "manifest.csv"
    write_manifest(manifest, planned)
    rows = [
        Killed("parent"),
        Killed("worker"),
        Killed("scheduler"),
        Killed("none: two parents"),
        Killed("full disk"),
    ]
    with tempfile.TemporaryDirectory(dir=folder) as place:
        number = 0

        def store() -> Path:
            nonlocal number
            number += 1
            return Path(place) / f"{number}.sqlite"

        while rows[0].kills < parents:
            path = store()
            run = start(path, manifest, total=UNITS)
            run.wait_for(draw.randrange(UNITS))
            rows[0].kills += run.process.poll() is None and kill(run.process.pid)
            run.wait()
            _finish(rows[0], path, manifest, run)
        while rows[1].kills < workers:
            path = store()
            run = start(path, manifest, total=UNITS)
            for moment in sorted(draw.sample(range(1, UNITS // 2), 2)):
                run.wait_for(moment)
                rows[1].kills += sum(map(kill, workers_of(run.process.pid)[:1]))
            run.wait()
            _finish(rows[1], path, manifest, run)
        while rows[2].kills < schedulers:
            path = store()
            with Cluster(Path(place), workers=2) as cluster:
                run = start(path, manifest, scheduler=cluster.address, total=UNITS)
                run.wait_for(draw.randrange(1, UNITS // 2))
                rows[2].kills += run.process.poll() is None
                cluster.kill_scheduler()
                run.wait()
            _finish(rows[2], path, manifest, run)
        path = store()
        both = [start(path, manifest, total=UNITS, workers=1) for _ in range(2)]
        for run in both:
            run.wait()
        _finish(rows[3], path, manifest, *both)
        path = store()
        run = start(path, manifest, total=UNITS, limit_bytes=200_000)
        run.wait()
        _finish(rows[4], path, manifest, run)
    return rows


def _finish(row: Killed, store: Path, manifest: Path, *runs: Run) -> None:
    """Check the store, and complete it by a further run."""
    row.runs += 1
    try:
        check(store, [serial for run in runs for serial in run.told])
    except AssertionError as fault:
        print(f"{row.what}: {fault}")
        row.lost += 1
    rest = start(store, manifest, total=UNITS)
    rest.wait()
    row.completed += check(store, rest.told) == UNITS and imucal.Fleet(store).count() == {"good": UNITS}
