"""How often `imucal noise` confuses noise, a bump and warming up: `make accuracy`, to docs/results/noise.md.

Units at rest are simulated with noise of several kinds; a step or a warm-up is added to two of the six axes.
"""

import os

# One thread per process, because several processes share the machine.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.progress import track

import imucal
from allan import REPORT
from engine import add_arguments, engine_of
from sections import write_section

SECTION = "Steps and drifts of a unit at rest"
RATE_HZ = 100.0
DURATION_S = 300.0
# Seeds of the kinds of units begin at multiples of 10,000 behind this one.
FIRST_SEED = 500_001
# Noise density of all axes, SI units; a sample has ten times this standard deviation.
DENSITY = 1e-3
ANSWERS = ("neither", "step", "drift", "both")


@dataclass(frozen=True)
class Case:
    """Noise of all axes, and the size of a step or of a warm-up in two of them, in SI units."""

    name: str
    expected: str
    instability: float = 0.0
    walk: float = 0.0
    step: float = 0.0
    warm_up: float = 0.0


CASES = (
    Case("white noise", "neither"),
    Case("flicker noise, B = 0.03 sample sigma", "neither", instability=3e-4),
    Case("random walk, 1e-4 per sqrt(s)", "neither", walk=1e-4),
    Case("random walk, 1e-3 per sqrt(s)", "neither", walk=1e-3),
    Case("flicker noise and random walk", "neither", instability=3e-4, walk=1e-4),
    Case("step of 0.5 sample sigma", "step", step=5e-3),
    Case("step of 0.5 sample sigma, random walk of 2e-5", "step", walk=2e-5, step=5e-3),
    Case("step of 2 sample sigma, random walk of 1e-4", "step", walk=1e-4, step=2e-2),
    Case("step of 2 sample sigma, flicker noise", "step", instability=3e-4, step=2e-2),
    Case("warm-up by 1 sample sigma", "drift", warm_up=1e-2),
    Case("warm-up by 3 sample sigma, random walk of 2e-5", "drift", walk=2e-5, warm_up=3e-2),
)


def trial(case: Case, seed: int) -> tuple[str, float | None]:
    """The answer, and the error of the time of a single step, s."""
    sensor = imucal.Sensor(
        noise_density=DENSITY, bias_instability=case.instability, random_walk=np.full(3, case.walk)
    )
    run = imucal.simulate(
        imucal.Static(DURATION_S), unit=imucal.Unit(sensor, sensor), rate_hz=RATE_HZ, seed=seed
    ).recording
    # The time of the step, or the time constant of the warm-up.
    at_s = DURATION_S * (0.1 + 0.8 * np.random.default_rng(seed).random())
    time_s = run.time_s
    change = case.step * (time_s >= at_s) + case.warm_up * (1.0 - np.exp(-time_s / at_s))
    force, rate = run.specific_force.copy(), run.angular_rate.copy()
    force[:, 1] += change
    rate[:, 2] -= change
    found = imucal.noise(imucal.Recording(time_s, force, rate), threads=1)
    answer = ANSWERS[bool(found.steps) + 2 * bool(found.drifts)]
    error_s = abs(found.steps[0].time_s - at_s) if len(found.steps) == 1 and case.step else None
    return answer, error_s


def calls() -> dict[str, Callable[[int], tuple[str, float | None]]]:
    """The function of each kind of unit, which takes a seed."""
    return {case.name: partial(trial, case) for case in CASES}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=200)
    add_arguments(arguments)
    given = arguments.parse_args()
    rows = []
    with engine_of(given, "noise-steps") as engine:
        for number, case in enumerate(track(CASES, "identifying")):
            # Each case has its own seeds, so that the errors of the cases are independent.
            first = FIRST_SEED + 10_000 * (number + 1)
            seeds = range(first, first + given.runs)
            found = list(engine.map(calls()[case.name], seeds, name=case.name))
            counts = Counter(answer for answer, _ in found)
            cells = [
                f"**{counts[answer]}**" if answer == case.expected else str(counts[answer])
                for answer in ANSWERS
            ]
            errors_s = [error_s for _, error_s in found if error_s is not None]
            median = f"{np.median(errors_s):.2f}" if errors_s else "-"
            rows.append("| " + " | ".join([case.name, *cells, median]) + " |")
    body = f"""
Written by `make accuracy`: {given.runs} simulated units at rest of each kind, {DURATION_S:g} s at
{RATE_HZ:g} Hz. All six axes have the same noise; a step at a random time, or a warm-up with a random time
constant of 30 to 270 s, is added to two of them. Sample sigma is the standard deviation of the white noise of
a sample. Each row counts the answers of `imucal noise`; the right ones are bold. A false step or drift in any
of the six axes counts.

| unit at rest | neither | step | drift | both | median error of the time, s |
|---|---:|---:|---:|---:|---:|
{chr(10).join(rows)}
"""
    write_section(REPORT, "Noise", SECTION, body)
    engine.publish(REPORT)


if __name__ == "__main__":
    main()
