"""Coverage of the intervals, and effects named by mistake, for units whose noise is below a step of the
converter: `make rounding`, to docs/results/rounding.md.

Every seed draws another unit, so that its biases lie anywhere between two steps.
"""

import os

# One thread per process, because two processes share the machine.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import dataclasses
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from rich.progress import track

import imucal
from engine import add_arguments, engine_of
from sections import write_section

REPORT: Final = Path(__file__).parents[1] / "docs/results/rounding.md"
RATE_HZ: Final = 100.0
DEG: Final = math.pi / 180.0
GRAVITY_MPS2: Final = 9.80665
# Number of standard deviations in a 95 % interval.
INTERVAL: Final = 1.96


@dataclass(frozen=True)
class Case:
    """A unit of a profile with another step (deg/s or g; None: that of the profile), behind a filter."""

    name: str
    profile: str
    gyro_lsb_dps: float | None = None
    accel_lsb_g: float | None = None
    filter_hz: float | None = None


CASES: Final = (
    Case("LSM6DSO, ±2000 deg/s, 5 Hz", "lsm6dso", gyro_lsb_dps=0.07, filter_hz=5.0),
    Case("LSM6DSO, ±2000 deg/s, 10 Hz", "lsm6dso", gyro_lsb_dps=0.07, filter_hz=10.0),
    Case("LSM6DSO, ±2000 deg/s, 40 Hz", "lsm6dso", gyro_lsb_dps=0.07, filter_hz=40.0),
    Case("MPU-6050, ±2000 deg/s, 5 Hz", "mpu6050", gyro_lsb_dps=1 / 16.4, filter_hz=5.0),
    Case("LSM6DSO, accelerometer of 8 bit, ±2 g", "lsm6dso", accel_lsb_g=1 / 64),
)


@dataclass(frozen=True)
class Result:
    """Errors over standard deviations of the parameters; codes of the findings; conclusion of `find_gap`."""

    z: dict[str, float]
    verdict: str
    findings: list[str]
    gap: str | None


def unit_of(case: Case, seed: int) -> imucal.Unit:
    unit = imucal.Unit.random(case.profile, seed)
    accelerometer, gyroscope = unit.accelerometer, unit.gyroscope
    if case.gyro_lsb_dps is not None:
        gyroscope = dataclasses.replace(gyroscope, lsb=case.gyro_lsb_dps * DEG)
    if case.accel_lsb_g is not None:
        accelerometer = dataclasses.replace(accelerometer, lsb=case.accel_lsb_g * GRAVITY_MPS2, bits=8)
    return imucal.Unit(accelerometer, gyroscope)


def run_of(case: Case, unit: imucal.Unit, poses: int, seed: int) -> imucal.Simulation:
    motion = imucal.Tumble(seed=seed, poses=poses, hold_s=3.0, move_s=1.5)
    return imucal.simulate(motion, seed=seed, unit=unit, rate_hz=RATE_HZ, filter_hz=case.filter_hz)


def trial(case: Case, asked: tuple[int, bool]) -> Result | None:
    """The calibration of one unit, judged against its truth; None if the recording is refused.

    asked  seed, and whether `find_gap` judges the recording, too
    """
    seed, with_gap = asked
    unit = unit_of(case, seed)
    run = run_of(case, unit, 20, 2 * seed)
    try:
        result = imucal.calibrate(run.recording)
    except imucal.ImucalError as error:
        print(f"{case.name}, seed {seed}: {error}", flush=True)
        return None
    truth = {}
    for name, sensor in (("accel", unit.accelerometer), ("gyro", unit.gyroscope)):
        for i, x in enumerate("xyz"):
            truth[f"{name}_bias_{x}"] = sensor.bias[i]
            truth |= {f"{name}_sensitivity_{x}{y}": sensor.sensitivity[i, j] for j, y in enumerate("xyz")}
    z = {p.name: (p.value - truth[p.name]) / p.std for p in result.parameters if p.std}
    conclusion = None
    if with_gap:
        control = run_of(case, unit, 14, 2 * seed + 1)
        gap = imucal.find_gap(run.recording, control=control.recording)
        effects = ", ".join(effect["name"] for effect in gap.effects)
        conclusion = gap.verdict + (f": {effects}" if effects else "")
    return Result(z, str(result.verdict), [finding.code for finding in result.findings], conclusion)


def row(case: Case, results: list[Result]) -> str:
    def share(*starts: str) -> str:
        z = np.array([v for r in results for name, v in r.z.items() if name.startswith(starts)])
        return f"{100 * np.mean(np.abs(z) < INTERVAL):.1f}"

    gyro = np.array([v for r in results for name, v in r.z.items() if name.startswith("gyro_bias")])
    found = sum("noise_below_lsb" in r.findings for r in results)
    gaps = [r.gap for r in results if r.gap is not None]
    named = [gap for gap in gaps if gap.split(":")[0] in ("named", "ambiguous")]
    cells = [
        case.name,
        share("accel_bias", "gyro_bias"),
        share("accel_bias"),
        share("gyro_bias"),
        share("accel_sensitivity", "gyro_sensitivity"),
        f"{np.sqrt(np.mean(gyro**2)):.2f}",
        f"{np.max(np.abs(gyro)):.1f}",
        f"{100 * found / len(results):.0f}",
        f"{len(named)} of {len(gaps)}" if gaps else "-",
    ]
    return "| " + " | ".join(cells) + " |"


def calls() -> dict[str, Callable[[tuple[int, bool]], Result | None]]:
    """The function of each kind of unit, which takes a seed, and whether `find_gap` judges it."""
    return {case.name: partial(trial, case) for case in CASES}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=200)
    arguments.add_argument("--gaps", type=int, default=60, help="runs of each unit that `find_gap` judges")
    arguments.add_argument("--first", type=int, default=1001, help="first seed")
    add_arguments(arguments)
    arguments.add_argument("--dry", action="store_true", help="print the table without writing the page")
    given = arguments.parse_args()
    rows, gaps = [], Counter[str]()
    with engine_of(given, "rounding") as engine:
        for case in CASES:
            seeds = range(given.first, given.first + given.runs)
            asked = [(seed, seed < given.first + given.gaps) for seed in seeds]
            runs = engine.map(calls()[case.name], asked, name=case.name)
            tried = list(track(runs, case.name, total=given.runs))
            results = [result for result in tried if result is not None]
            rows.append(row(case, results))
            verdicts = Counter(result.verdict for result in results)
            gaps.update(result.gap for result in results if result.gap is not None)
            print(rows[-1], dict(verdicts), Counter(r.gap for r in results if r.gap is not None), flush=True)
    if given.dry:
        return
    named = sum(count for gap, count in gaps.items() if gap.split(":")[0] in ("named", "ambiguous"))
    conclusions = ", ".join(f"{gap} {count}" for gap, count in gaps.most_common())
    body = f"""
Written by `make rounding`: {given.runs} simulated units of each kind, drawn from the tolerances of the
profile, in counts. Each is moved by hand to 20 poses that are held for 3 s, at {RATE_HZ:g} Hz. `find_gap`
judges {given.gaps} of each kind with a control recording of 14 poses. No unit has an effect.

* biases, accelerometer, gyroscope, sensitivities: share of the 95 % intervals that hold the truth, %.
* error / σ: root mean square and largest value, gyroscope biases.
* finding: share of the runs with `noise_below_lsb`, %.
* named: `find_gap` names an effect.

| unit | biases | accelerometer | gyroscope | sensitivities | error / σ | largest | finding, % | named |
|---|---:|---:|---:|---:|---:|---:|---:|---:|
{chr(10).join(rows)}

Conclusions of `find_gap`: {conclusions}. {named} of {sum(gaps.values())} name an effect.
"""
    write_section(
        REPORT, "Rounding", "Intervals and named effects with noise below the step of the converter", body
    )
    engine.publish(REPORT)


if __name__ == "__main__":
    main()
