"""Coverage of the confidence intervals of noise figures: `make accuracy`, to docs/results/noise.md.

Units at rest with known noise are simulated and identified, and the figures are compared with the truth.
"""

import os

# One thread per process, because two processes share the machine.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.progress import track

import imucal
from accuracy.band import BESIDE, binomial
from allan import REPORT
from engine import add_arguments, engine_of
from sections import write_section

SECTION = "The figures and their bands"
RATE_HZ = 100.0
DURATION_S = 3600.0
# Seed of the first run of the first kind of unit.
FIRST_SEED = 200_001
DEG = math.pi / 180.0
MG = 9.80665e-3
FIGURES = ("noise_density", "bias_instability", "random_walk")
SENSORS = ("accelerometer", "gyroscope")


@dataclass(frozen=True)
class Case:
    """A unit with noise that its datasheet does not specify: flicker noise (mg, deg/h), random walk (SI)."""

    unit: str
    flicker: tuple[float, float] | None
    walk: tuple[float, float]


CASES = (
    Case("paper", (0.1, 20.0), (1e-4, 2e-5)),
    Case("mpu6050", (0.1, 15.0), (2e-4, 1e-5)),
    Case("lsm6dso", (0.04, 3.0), (4e-5, 3e-6)),
    Case("bmi088", (0.04, 2.0), (0.0, 0.0)),
    Case("adis16460", None, (2e-5, 2e-5)),
    Case("paper", (0.0, 0.0), (2e-5, 2e-5)),
    Case("mpu6050", (0.0, 0.0), (0.0, 0.0)),
)


def unit_of(case: Case) -> imucal.Unit:
    unit = imucal.Unit.named(case.unit)

    def sensor(name: str, flicker: float | None, walk: float) -> imucal.Sensor:
        of_datasheet = getattr(unit, name)
        instability = of_datasheet.bias_instability if flicker is None else flicker
        return dataclasses.replace(
            of_datasheet, bias_instability=instability, random_walk=np.full(3, walk), bias=np.zeros(3)
        )

    flicker = (None, None) if case.flicker is None else (case.flicker[0] * MG, case.flicker[1] * DEG / 3600)
    return imucal.Unit(
        sensor("accelerometer", flicker[0], case.walk[0]), sensor("gyroscope", flicker[1], case.walk[1])
    )


def trial(case: Case, seed: int) -> list[list[list[imucal.NoiseFigure]]]:
    """The figures of all units by sensor, axis and kind of noise."""
    run = imucal.simulate(imucal.Static(DURATION_S), unit=unit_of(case), rate_hz=RATE_HZ, seed=seed)
    found = imucal.noise(run.recording, threads=1)
    return [
        [[getattr(axis, figure) for figure in FIGURES] for axis in found.triad(triad)]
        for triad in ("accel", "gyro")
    ]


def truths(case: Case) -> list[list[float]]:
    unit = unit_of(case)
    sensors = [getattr(unit, sensor) for sensor in SENSORS]
    return [[s.noise_density, s.bias_instability, float(s.random_walk[0])] for s in sensors]


class Judge:
    """Rows of the table. Figures outside their tolerance are bold and counted."""

    def __init__(self) -> None:
        self.rows: list[str] = []
        self.checked = 0
        self.misses = 0
        self.bands = 0
        self.held = 0

    def judge(self, text: str, good: bool) -> str:
        self.checked += 1
        self.misses += not good
        return text if good else f"**{text}**"

    def add(self, name: str, truth: float, found: list[imucal.NoiseFigure]) -> None:
        trials = len(found)
        seen = [figure for figure in found if figure.value is not None]
        share = len(seen) / trials
        if truth == 0.0:
            # Absent noise may be detected in at most 5 % of the cases, plus the scatter of that number.
            most = binomial(trials, 0.05, BESIDE)[1]
            cells = ["0", self.judge(f"{100 * share:.1f}", share <= most), "-", "-", "-"]
        else:
            held = sum(figure.low <= truth <= figure.high for figure in found)
            self.bands += trials
            self.held += held
            inside = held / trials
            low, high = binomial(trials, 0.95, BESIDE)
            # Intervals that start at zero contain small true values more often than 95 %.
            good = low <= inside and (inside <= high or share < 1.0)
            spread = "-"
            size = "-"
            if share == 1.0:
                errors = np.array([(f.value - truth) / f.std for f in found])
                spread = f"{np.sqrt(np.mean(errors**2)):.2f}"
                size = f"{100 * np.sqrt(np.mean([f.std**2 for f in found])) / truth:.2g}"
            cells = [
                f"{truth:.3g}",
                f"{100 * share:.1f}",
                size,
                spread,
                self.judge(f"{100 * inside:.1f}", good),
            ]
        self.rows.append("| " + " | ".join([name, *cells]) + " |")


def calls() -> dict[str, Callable[[int], list[list[list[imucal.NoiseFigure]]]]]:
    """The function of each kind of unit, which takes a seed."""
    return {repr(case): partial(trial, case) for case in CASES}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=100)
    add_arguments(arguments)
    given = arguments.parse_args()
    judge = Judge()
    with engine_of(given, "noise-accuracy") as engine:
        for case in track(CASES, "identifying"):
            # Each case has its own seeds, so that the errors of the cases are independent.
            first = FIRST_SEED + 1000 * CASES.index(case)
            seeds = range(first, first + given.runs)
            runs = list(engine.map(calls()[repr(case)], seeds, name=repr(case)))
            for s, (sensor, of_sensor) in enumerate(zip(SENSORS, truths(case), strict=True)):
                for k, (figure, truth) in enumerate(zip(FIGURES, of_sensor, strict=True)):
                    found = [axis[k] for run in runs for axis in run[s]]
                    judge.add(f"{case.unit}, {sensor}, {figure}", truth, found)
    trials = 3 * given.runs
    low, high = binomial(trials, 0.95, BESIDE)
    band = f"{100 * low:.1f} to {100 * high:.1f}"
    expected = BESIDE * judge.checked
    of_hundred = f"{100 * (1 - BESIDE):.0f}"
    share = 100 * judge.held / judge.bands
    body = f"""
Written by `make accuracy`: {given.runs} simulated units at rest of each kind, {DURATION_S / 3600:g} h
at {RATE_HZ:g} Hz, in counts. The white noise is that of the datasheet over sqrt(2), and flicker noise and
random walk are those of the table. Each unit has three axes per sensor.

* seen: share of the axes on which the process is detected, %. The other axes have an upper bound. A
  process that is absent (truth 0) may be detected in 5 of 100 cases.
* σ: the reported standard deviation in % of the truth, if the process is detected on all axes. error / σ:
  root mean square; 1 if σ is correct.
* 95 %: share of the bands that contain the truth. For {trials} perfect bands this share is {band} % with
  a probability of {of_hundred} %; figures outside this range are bold. The share may be larger if a
  process is not detected on every axis, because its band then begins at zero.

| unit, sensor, figure | truth, SI | seen | σ, % | error / σ | 95 % |
|---|---:|---:|---:|---:|---:|
{chr(10).join(judge.rows)}

{judge.misses} of {judge.checked} figures are outside; {expected:.1f} are expected for perfect bands. Of
all {judge.bands} bands of processes that are present, {share:.2f} % contain the truth.
"""
    write_section(REPORT, "Noise", SECTION, body)
    engine.publish(REPORT)


if __name__ == "__main__":
    main()
