"""Monte Carlo runs of one sensor: `make one-sensor`, to docs/results/one-sensor.md.

An accelerometer alone is calibrated from rests in random poses, by the norm of gravity. A gyroscope is
calibrated with the accelerometer's calibration of another recording as a prior. Every run has another unit,
with misalignments of several degrees, and the noise of the paper's unit.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import imucal
from accuracy.bound import PARAMETERS, SYMMETRIC, Noise, bound
from engine import add_arguments, engine_of
from faces import random_unit
from sections import write_section

REPORT = Path(__file__).resolve().parent.parent / "docs" / "results" / "one-sensor.md"
RUNS = 200
RATE_HZ = 100.0
ACCEL = 9
HALF_WIDTH_95 = 1.959964
# Moves of each condition; a run begins with a rest.
MOVES = {"accelerometer alone": (13, 23, 45), "gyroscope, accelerometer given": (8, 13, 23)}


@dataclass(frozen=True)
class Trial:
    """Errors, stated standard deviations and the Cramér-Rao bound of the parameters; the verdict."""

    error: np.ndarray
    std: np.ndarray
    bound: np.ndarray
    verdict: str


def run_of(seed: int, moves: int, unit: imucal.Unit) -> imucal.Simulation:
    program = imucal.Program.random(seed=seed, moves=moves, hold_s=3.0)
    return imucal.simulate(program, seed=seed, unit=unit, rate_hz=RATE_HZ)


def accel_information(truth: imucal.Truth, noise: Noise) -> np.ndarray:
    """Information on the nine parameters in the means of the rests, whose directions are unknown."""
    total = np.zeros((ACCEL, ACCEL))
    sensitivity = truth.calibration.accelerometer.sensitivity
    for start_s, end_s in truth.rests:
        first, end = np.searchsorted(truth.time_s, (start_s, end_s))
        force = truth.specific_force[first:end].mean(axis=0)
        by_parameters = np.zeros((3, ACCEL))
        by_parameters[:, :3] = np.eye(3)
        for column, (i, j) in enumerate(SYMMETRIC, start=3):
            by_parameters[i, column] = force[j]
            by_parameters[j, column] = force[i]
        # A change of the direction moves the mean within a plane, whose normal remains.
        _, _, rows = np.linalg.svd(force[None, :])
        across = sensitivity @ rows[1:].T
        normal = np.cross(across[:, 0], across[:, 1])
        seen = normal / np.linalg.norm(normal) @ by_parameters
        total += np.outer(seen, seen) * (end - first) / noise.accel**2
    return total


def accelerometer_trial(moves: int, seed: int) -> Trial | str:
    unit = random_unit(np.random.default_rng((seed, moves)))
    run = run_of(seed, moves, unit)
    lowest = np.linalg.inv(accel_information(run.truth, Noise.of(unit, RATE_HZ)))
    try:
        result = imucal.calibrate(run.recording.of_sensor("accelerometer"))
    except imucal.ImucalError as error:
        return str(error)
    return _against(result, run.truth, slice(0, ACCEL), lowest)


def gyroscope_trial(moves: int, seed: int) -> Trial | str:
    unit = random_unit(np.random.default_rng((seed, moves)))
    noise = Noise.of(unit, RATE_HZ)
    before, run = run_of(seed + 1000, 45, unit), run_of(seed, moves, unit)
    information = np.linalg.inv(bound(run.truth, noise))
    information[:ACCEL, :ACCEL] += accel_information(before.truth, noise)
    try:
        given = imucal.calibrate(before.recording.of_sensor("accelerometer")).calibration
        result = imucal.calibrate(run.recording, calibration=given)
    except imucal.ImucalError as error:
        return str(error)
    return _against(result, run.truth, slice(ACCEL, PARAMETERS), np.linalg.inv(information))


def _against(
    result: imucal.CalibrationResult, truth: imucal.Truth, part: slice, covariance: np.ndarray
) -> Trial:
    true = {parameter.name: parameter.value for parameter in truth.calibration.parameters}
    parameters = [p for p in result.parameters if p.name in list(true)[part]]
    names = list(true)[part]
    lowest = np.sqrt(np.diag(covariance))
    lowest = lowest[part] if len(lowest) == PARAMETERS else lowest
    by_name = {parameter.name: parameter for parameter in parameters}
    return Trial(
        np.array([by_name[name].value - true[name] for name in names]),
        np.array([by_name[name].std for name in names]),
        lowest,
        str(result.verdict),
    )


TRIALS = {
    "accelerometer alone": accelerometer_trial,
    "gyroscope, accelerometer given": gyroscope_trial,
}


@dataclass(frozen=True)
class Figures:
    """Runs of a condition: verdicts, coverage of 95 % intervals, and RMSE over the bound."""

    runs: int
    refused: int
    good: int
    inside: float
    of_one: tuple[float, float]
    ratio: float
    of_worst: float

    @classmethod
    def of(cls, trials: list[Trial | str]) -> "Figures":
        done = [trial for trial in trials if isinstance(trial, Trial)]
        error, std, lowest = (
            np.array([getattr(trial, name) for trial in done]) for name in ("error", "std", "bound")
        )
        inside = np.abs(error / std) < HALF_WIDTH_95
        relative = np.sqrt(((error / lowest) ** 2).mean(axis=0))
        return cls(
            len(trials),
            len(trials) - len(done),
            sum(trial.verdict == "good" for trial in done),
            float(inside.mean()),
            (float(inside.mean(axis=0).min()), float(inside.mean(axis=0).max())),
            float(np.sqrt(((error / lowest) ** 2).mean())),
            float(relative.max()),
        )


def calls() -> dict[str, Callable[[int], Trial | str]]:
    """The function of each condition, which takes a seed."""
    return {
        f"{sensor}, {moves} moves": partial(trial, moves)
        for sensor, trial in TRIALS.items()
        for moves in MOVES[sensor]
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=RUNS)
    add_arguments(parser)
    given = parser.parse_args()
    rows = []
    with engine_of(given, "one-sensor") as engine:
        for sensor in TRIALS:
            for moves in MOVES[sensor]:
                seeds, name = range(1, given.runs + 1), f"{sensor}, {moves} moves"
                found = list(engine.map(calls()[name], seeds, name=name))
                figures = Figures.of(found)
                low, high = figures.of_one
                rows.append(
                    f"| {sensor} | {moves + 1} | {figures.runs} | {figures.refused} | {figures.good} | "
                    f"{figures.inside:.1%} | {low:.1%} to {high:.1%} | {figures.ratio:.3f} | "
                    f"{figures.of_worst:.3f} |"
                )
                print(rows[-1], flush=True)
    head = (
        "| sensor | rests | runs | refused | good | within 95 % | of one parameter | RMSE / bound | largest |"
    )
    body = f"""Seeds 1 to {given.runs} for each condition, another unit in each run. The accelerometer's
nine parameters follow from its recording alone. The gyroscope's twelve parameters follow from a recording of
both sensors, with the calibration of the accelerometer from 46 rests of another recording as a prior.

* within 95 %: share of the stated 95 % intervals that contain the truth, over all parameters, and the
  smallest and the largest share of one parameter.
* RMSE / bound: root mean square error, each run relative to its own Cramér-Rao bound, over all parameters and
  the largest of one parameter.

{head}
|---|{"---:|" * 8}
""" + "\n".join(rows)
    write_section(REPORT, "One sensor", "Coverage and errors", body)
    engine.publish(REPORT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
