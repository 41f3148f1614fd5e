"""A simulated fleet with planted faults: its manifest, its recordings, and the truth.

    PYTHONPATH=benches python -m fleet.simulated FOLDER --units 2000

Writes manifest.csv, truth.json and one compressed NumPy file per recording: 16 moves, 50 s at 25 Hz, 30 kB.
Two stations, three operators and five batches; each unit is measured once in production, some again every
month, and ten of them in a gauge study. The folder `sitecustomize` of the truth makes poisoned files end the
process that reads them.
"""

import argparse
import csv
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path

import numpy as np

import imucal

__all__ = ["BAD_KINDS", "Planned", "Truth", "plan", "write", "write_manifest", "write_one", "write_poison"]

FIRST_DAY = date(2026, 3, 2)
PRODUCTION_DAYS = 25
STATIONS, OPERATORS, BATCHES = ("A", "B"), ("ann", "bob", "eve"), ("b1", "b2", "b3", "b4", "b5")
# Standard deviations of the units.
SPREADS = {"accel": (0.05, 3e-3, 5e-4), "gyro": (5e-3, 3e-3, 5e-4)}
DENSITIES = {"accel": 1e-3, "gyro": 1e-4}
MOVES, MOVE_S, HOLD_S, RATE_HZ = 16, 1.0, 2.0, 25.0
# The axes of the gyroscopes at one station, on one day, about z.
SHIFT_DEG = 0.05
DRIFT_MPS2_PER_MONTH = 2e-3
MONTHS = 6
# An odd unit has one parameter this many standard deviations of the units from their mean.
ODD = {
    "gyro_sensitivity_zz": 9.0,
    "accel_bias_y": 9.0,
    "gyro_sensitivity_xy": 9.0,
    "accel_sensitivity_xx": -9.0,
    "gyro_bias_z": -9.0,
}
# Kinds of bad recordings, each of which has no result.
BAD_KINDS = (
    *("truncated", "empty", "not_a_recording", "missing", "still", "dead_axis", "saturated", "wrong_unit"),
    *("swapped_axes", "one_move"),
)


@dataclass(frozen=True)
class Planned:
    """One recording of the fleet, with what is planted in it."""

    serial: str
    date: str
    station: str
    operator: str
    batch: str
    role: str
    number: int
    seed: int
    shift_deg: float = 0.0
    drift_mps2: float = 0.0
    odd: str | None = None
    bad: str | None = None
    control: bool = False

    @property
    def file(self) -> str:
        kind = f"{self.bad}-" if self.bad in ("poisoned", "hanging") else ""
        return f"{self.date}/{kind}{self.serial}-{self.seed}.npz"


@dataclass
class Truth:
    """What is planted."""

    drifting: list[str] = field(default_factory=list)
    drift_parameter: str = "accel_bias_z"
    drift_per_month: float = DRIFT_MPS2_PER_MONTH
    stable: list[str] = field(default_factory=list)
    shifted: dict[str, object] = field(default_factory=dict)
    odd: dict[str, str] = field(default_factory=dict)
    bad: dict[str, str] = field(default_factory=dict)
    poisoned: list[str] = field(default_factory=list)
    grr: list[str] = field(default_factory=list)


def plan(units: int, seed: int = 42) -> tuple[list[Planned], Truth]:
    """The recordings and what is planted in them; its parts are in proportion to the number of units."""
    random = np.random.default_rng(seed)
    share = units / 2000
    # Units with something planted are drawn without overlap, so that each fault stands alone.
    drawn = iter(random.permutation(units).tolist())

    def some(count: float) -> list[int]:
        return [next(drawn) for _ in range(max(1, round(count * share)))]

    drifting, stable, grr = some(40), some(80), some(10)
    odd = dict(zip((next(drawn) for _ in ODD), ODD, strict=True))
    bad = {number: BAD_KINDS[index % len(BAD_KINDS)] for index, number in enumerate(some(20))}
    poisoned = [next(drawn) for _ in range(2)]
    bad |= dict.fromkeys(poisoned, "poisoned")
    shift_day = (FIRST_DAY + timedelta(days=PRODUCTION_DAYS // 2)).isoformat()
    planned: list[Planned] = []

    def add(number: int, day: date, role: str, station: str, operator: str, drift: float = 0.0) -> None:
        day_text = day.isoformat()
        is_shifted = station == STATIONS[1] and day_text == shift_day
        planned.append(
            Planned(
                *(f"{number:05}", day_text, station, operator),
                BATCHES[number * len(BATCHES) // units],
                *(role, number, len(planned) + 1),
                SHIFT_DEG if is_shifted else 0.0,
                drift,
                odd.get(number),
                bad.get(number),
            )
        )

    for number in range(units):
        day = FIRST_DAY + timedelta(days=number * PRODUCTION_DAYS // units)
        add(number, day, "production", STATIONS[number % 2], OPERATORS[random.integers(3)])
    last = FIRST_DAY + timedelta(days=PRODUCTION_DAYS)
    for month in range(1, MONTHS):
        for number in (*drifting, *stable):
            drift = month * DRIFT_MPS2_PER_MONTH if number in drifting else 0.0
            day = last + timedelta(days=round(30.4 * month))
            add(number, day, "ageing", STATIONS[number % 2], OPERATORS[month % 3], drift)
    for number in grr:
        for operator in OPERATORS:
            for _ in range(3):
                add(number, last + timedelta(days=1), "grr", STATIONS[0], operator)
    truth = Truth(
        drifting=[f"{n:05}" for n in sorted(drifting)],
        stable=[f"{n:05}" for n in sorted(stable)],
        shifted={"station": STATIONS[1], "date": shift_day, "deg": SHIFT_DEG},
        odd={f"{n:05}": name for n, name in odd.items()},
        bad={f"{n:05}": kind for n, kind in bad.items()},
        poisoned=[f"{n:05}" for n in sorted(poisoned)],
        grr=[f"{n:05}" for n in sorted(grr)],
    )
    return planned, truth


def write(folder: Path, units: int, seed: int = 42) -> Truth:
    """Write the fleet; recordings that exist are kept."""
    planned, truth = plan(units, seed)
    for day in {each.date for each in planned}:
        (folder / day).mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor() as pool:
        # Consumed, so that an error of a process is raised here.
        list(pool.map(write_one, [folder] * len(planned), planned, chunksize=20))
    write_manifest(folder / "manifest.csv", planned)
    (folder / "truth.json").write_text(json.dumps(truth.__dict__, indent=1) + "\n", encoding="utf-8")
    write_poison(folder / "sitecustomize")
    return truth


def write_manifest(path: Path, planned: list[Planned]) -> None:
    """Write the manifest of recordings."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("serial", "date", "station", "operator", "batch", "files", "control", "role"))
        for each in planned:
            about = (each.serial, each.date, each.station, each.operator, each.batch)
            writer.writerow((*about, each.file, "", each.role))


def write_poison(folder: Path) -> None:
    """A start file of Python that ends workers of a fleet when they open a file named poisoned-*.

    With it first in PYTHONPATH, a worker ends by the signal of a segmentation fault, as in the code of a
    library. With a file named hanging-* it waits, as for a disk that does not answer.
    """
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(POISON, encoding="utf-8")


POISON = """import os, signal, sys, time

# Processes that hash files but do not calibrate: the parent, and the nanny and scheduler of Dask.
CALCULATES = "imucal.fleet.task"
PARENT = "imucal.fleet.store"


def _end(event, arguments):
    if event != "open" or CALCULATES not in sys.modules or PARENT in sys.modules:
        return
    if "poisoned-" in str(arguments[0]):
        os.kill(os.getpid(), signal.SIGSEGV)
    if "hanging-" in str(arguments[0]):
        time.sleep(3600)


sys.addaudithook(_end)
"""


def unit_of(number: int, seed: int, odd: str | None = None) -> imucal.Unit:
    """A unit of the fleet; the same number gives the same unit."""
    random = np.random.default_rng([seed, number])

    def sensor(name: str) -> imucal.Sensor:
        bias, scale, misalignment = SPREADS[name]
        sensitivity = np.eye(3) + np.diag(random.normal(0, scale, 3))
        sensitivity += (1 - np.eye(3)) * random.normal(0, misalignment, (3, 3))
        if name == "accel":
            # In the body frame of a calibration it is symmetric.
            sensitivity = (sensitivity + sensitivity.T) / 2
        offset = random.normal(0, bias, 3)
        if odd is not None and odd.startswith(name):
            kind, place = odd.removeprefix(f"{name}_").split("_")
            row, column = "xyz".index(place[0]), "xyz".index(place[-1])
            if kind == "bias":
                offset[row] = ODD[odd] * bias
            else:
                spread = scale if row == column else misalignment
                sensitivity[row, column] = float(row == column) + ODD[odd] * spread
        return imucal.Sensor(sensitivity=sensitivity, bias=offset, noise_density=DENSITIES[name])

    return imucal.Unit(sensor("accel"), sensor("gyro"))


def write_one(folder: Path, each: Planned) -> None:
    path = folder / each.file
    if path.exists() or each.bad == "missing":
        return
    if each.bad in ("empty", "not_a_recording"):
        path.write_bytes(b"" if each.bad == "empty" else b"<html>404 not found</html>")
        return
    columns = _columns(each)
    with path.open("wb") as file:
        np.savez_compressed(file, **columns)
    if each.bad == "truncated":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _columns(each: Planned) -> dict[str, np.ndarray]:
    unit = unit_of(each.number, 42, each.odd)
    gyro, accel = unit.gyroscope, unit.accelerometer
    turn = np.radians(each.shift_deg)
    about_z = np.array([[1.0, -turn, 0.0], [turn, 1.0, 0.0], [0.0, 0.0, 1.0]])
    unit = imucal.Unit(
        imucal.Sensor(
            sensitivity=accel.sensitivity,
            bias=accel.bias + np.array([0.0, 0.0, each.drift_mps2]),
            noise_density=accel.noise_density,
        ),
        imucal.Sensor(
            sensitivity=gyro.sensitivity @ about_z, bias=gyro.bias, noise_density=gyro.noise_density
        ),
    )
    moves = 1 if each.bad == "one_move" else MOVES
    program: imucal.Program | imucal.Static = imucal.Program.random(
        moves=moves, seed=each.seed, move_s=MOVE_S, hold_s=HOLD_S
    )
    if each.bad == "still":
        program = imucal.Static(duration_s=50.0)
    recording = imucal.simulate(program, seed=each.seed, unit=unit, rate_hz=RATE_HZ).recording
    force, rate = recording.specific_force.astype("f4"), recording.angular_rate.astype("f4")
    if each.bad == "dead_axis":
        force[:, 1] = 0.0
    if each.bad == "saturated":
        rate = np.clip(rate, -0.6, 0.6)
    if each.bad == "wrong_unit":
        rate = np.degrees(rate)
    if each.bad == "swapped_axes":
        rate = rate[:, [1, 0, 2]]
    return {"time_s": recording.time_s, "accel_mps2": force, "gyro_radps": rate}


def rows_of(truth: Truth) -> Iterator[str]:
    """What is planted, in words."""
    yield f"{len(truth.drifting)} units whose {truth.drift_parameter} drifts, {len(truth.stable)} stable ones"
    yield f"{len(truth.odd)} odd units: {', '.join(truth.odd.values())}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--units", type=int, default=2000)
    given = parser.parse_args()
    truth = write(given.folder, given.units)
    print("\n".join(rows_of(truth)))


if __name__ == "__main__":
    main()
