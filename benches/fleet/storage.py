"""A store of 100,000 synthetic results: time to store them, memory of the process, and time of each query.

The statistics of all units and the report page are timed, too.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import imucal
from fleet.simulated import BATCHES, FIRST_DAY, OPERATORS, STATIONS, plan, write_one
from imucal.fleet.job import Job, KeyedJob, Options, keyed
from imucal.fleet.outcome import Outcome
from imucal.fleet.store import Store
from imucal.fleet.task import Task
from imucal.report import write_fleet_page
from peak_memory import peak_bytes, reset_peak

__all__ = ["Storage", "stored"]

PER_TRANSACTION = 50
# Other work of the machine only slows a query down, so the best round is the least disturbed.
ROUNDS = 3


class Storage:
    """What was measured: times in s, sizes in bytes."""

    rows: int
    elapsed_s: float
    size: int
    memory: tuple[int, int]
    queries: dict[str, float]
    statistics: dict[str, float]
    page: int


def stored(folder: Path, rows: int) -> Storage:
    """Store outcomes that vary around those of one recording, and query them."""
    each = replace(plan(2000)[0][0], bad=None)
    (folder / each.date).mkdir(parents=True, exist_ok=True)
    write_one(folder, each)
    options = Options()
    one = keyed(Job("template", (str(folder / each.file),)), options.text)
    (template,) = Task((one,), options).run()
    path = folder / "synthetic.sqlite"
    for old in folder.glob("synthetic.sqlite*"):
        old.unlink()
    found = Storage()
    random = np.random.default_rng(7)
    started = time.perf_counter()
    memory = [0, 0]
    reset_peak()
    with Store(path) as store:
        for first in range(0, rows, PER_TRANSACTION):
            numbers = range(first, first + PER_TRANSACTION)
            store.put([_outcome(template, number, rows, random) for number in numbers], options.text)
            if first == rows // 10 // PER_TRANSACTION * PER_TRANSACTION:
                memory[0] = peak_bytes()
    found.elapsed_s = time.perf_counter() - started
    memory[1] = peak_bytes()
    found.rows, found.memory = rows, (memory[0], memory[1])
    found.size = path.stat().st_size
    fleet = imucal.Fleet(path)
    found.queries = {
        name: min(_time(query) for _ in range(ROUNDS)) for name, query in _queries(fleet).items()
    }
    page = folder / "fleet.html"
    found.statistics = {
        "capability": _time(fleet.capability),
        "spc": _time(fleet.spc),
        "outliers": _time(fleet.outliers),
        "report": _time(lambda: write_fleet_page(page, fleet)),
    }
    found.page = page.stat().st_size
    return found


def _outcome(template: Outcome, number: int, rows: int, random: np.random.Generator) -> Outcome:
    measured = template.measured
    assert measured is not None
    values = np.frombuffer(measured.values) + random.normal(0, 1e-3, len(measured.names))
    day = np.datetime64(FIRST_DAY) + number * 250 // rows
    job = Job(
        f"{number:06}",
        (f"/recordings/{number:06}.npz",),
        date=str(day),
        station=STATIONS[number % 2],
        operator=OPERATORS[number % 3],
        batch=BATCHES[number * 5 // rows],
        role="production",
    )
    name = f"{number:064x}"
    if number % 100 == 99:
        return Outcome(KeyedJob(job, name, name, ()), "failed", "format", "damaged", 0.02)
    verdict = "poor" if number % 50 == 7 else "good"
    return Outcome(
        KeyedJob(job, name, name, ()), verdict, None, None, 0.02, replace(measured, values=values.tobytes())
    )


def _queries(fleet: imucal.Fleet) -> dict[str, Callable[[], object]]:
    listed = ("serial", "date", "station", "verdict", "chi2_per_dof")
    return {
        "count by verdict": lambda: fleet.count(),
        "list --verdict poor --since": lambda: fleet.rows(listed, verdict="poor", since="2026-09-01"),
        "show SERIAL": lambda: (fleet.rows(listed, serial="004242"), fleet.calibration("004242")),
        "query: mean of a parameter by station": lambda: fleet.query(
            "SELECT station, avg(gyro_bias_x), count(*) FROM measurements GROUP BY station"
        ),
        "measurements of one batch": lambda: fleet.measurements(batch=BATCHES[0]),
        "measurements of all units": lambda: fleet.measurements(),
    }


def _time(query: Callable[[], object]) -> float:
    started = time.perf_counter()
    query()
    return time.perf_counter() - started
