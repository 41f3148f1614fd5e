"""A fleet with one file that ends each process that reads it, beside the same fleet without this file."""

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import imucal
from fleet.killing import Run, start
from fleet.simulated import plan, write_manifest, write_one, write_poison

__all__ = ["Poisoned", "poisoned"]


@dataclass
class Poisoned:
    """What was measured: times in s, memory of the parent after a tenth of the units and after all, bytes.

    rows       number of rows by verdict
    serials    units that are stored as poisoned, and the planted one
    again      units that a second run computes
    """

    units: int
    rows: dict[str, int]
    serials: list[str]
    planted: str
    elapsed_s: float
    without_s: float
    again: int
    memory: tuple[int, int]


def poisoned(folder: Path, units: int) -> Poisoned:
    """Run a fleet with one poisoned file, in the middle of its manifest, and without it."""
    planned = [replace(each, bad=None) for each in plan(max(units, 2000))[0][:units]]
    for day in {each.date for each in planned}:
        (folder / day).mkdir(parents=True, exist_ok=True)
    bad = replace(planned[units // 2], bad="poisoned")
    with ProcessPoolExecutor() as pool:
        list(pool.map(write_one, [folder] * (units + 1), [*planned, bad], chunksize=20))
    write_manifest(folder / "good.csv", planned)
    write_manifest(folder / "poisoned.csv", [*planned[: units // 2], bad, *planned[units // 2 + 1 :]])
    write_poison(folder / "sitecustomize")
    without_s, _ = _timed(folder, "good.csv", units)
    elapsed_s, run = _timed(folder, "poisoned.csv", units)
    fleet = imucal.Fleet(folder / "poisoned.csv.sqlite")
    _, again = _timed(folder, "poisoned.csv", units, keep=True)
    words = {line.split()[0]: line.split()[1:] for line in again.output.read_text().splitlines()}
    memory = [int(line.split()[1]) for line in run.output.read_text().splitlines() if line[:6] == "memory"]
    serials = [serial for (serial,) in fleet.rows(("serial",), verdict="poisoned")[1]]
    return Poisoned(
        units,
        fleet.count(),
        serials,
        bad.serial,
        elapsed_s,
        without_s,
        int(words["done"][0]),
        (memory[0], memory[-1]),
    )


def _timed(folder: Path, manifest: str, units: int, *, keep: bool = False) -> tuple[float, Run]:
    store = folder / f"{manifest}.sqlite"
    for old in () if keep else folder.glob(f"{store.name}*"):
        old.unlink()
    started = time.monotonic()
    run = start(store, folder / manifest, total=units, start_files=folder / "sitecustomize")
    if run.wait() != 0:
        raise SystemExit(run.output.read_text())
    return time.monotonic() - started, run
