"""Monte Carlo accuracy over the Cramér-Rao bound: `make accuracy`, to docs/results/accuracy.md.

Every run simulates the paper's gyroscope program with its own moves and noise, calibrates, and compares
with the truth.
"""

import os

# Two processes share the machine; threads within them would only get in each other's way.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.stats import binom, chi2

import imucal
from bound import bound, paper_unit_noise

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / "docs" / "results" / "accuracy.md"
RATE_HZ = 200.0
LEVELS = {"68 %": 1.0, "95 %": 1.959964, "99.7 %": 2.967738}
EXPECTED = {"68 %": 0.682689, "95 %": 0.95, "99.7 %": 0.997}
# Bands hold this share of perfect estimators.
BAND = 0.99


@dataclass(frozen=True)
class Trial:
    """One run: error, stated standard deviation, and standard deviation of the bound, (21,) each."""

    error: np.ndarray
    std: np.ndarray
    bound: np.ndarray


def trial(seed: int) -> Trial:
    simulation = imucal.simulate("random", seed=seed, rate_hz=RATE_HZ)
    result = imucal.calibrate(simulation.recording)
    truth = {parameter.name: parameter.value for parameter in simulation.truth.calibration.parameters}
    return Trial(
        np.array([p.value - truth[p.name] for p in result.parameters]),
        np.array([np.nan if p.std is None else p.std for p in result.parameters]),
        np.sqrt(np.diag(bound(simulation, paper_unit_noise(RATE_HZ)))),
    )


def trials(runs: int, processes: int) -> list[Trial]:
    with ProcessPoolExecutor(processes) as pool:
        return list(track(pool.map(trial, range(1, runs + 1)), "calibrating", total=runs))


def binomial_band(runs: int, share: float) -> tuple[float, float]:
    low, high = binom.interval(BAND, runs, share)
    return low / runs, high / runs


def report(done: list[Trial], names: list[str], units: list[str]) -> str:
    """The page; figures outside their band are bold and counted."""
    runs = len(done)
    error, std, limit = (np.array([getattr(t, field) for t in done]) for field in ("error", "std", "bound"))
    rmse = np.sqrt((error**2).mean(axis=0))
    # Runs differ in their moves, so variances are averaged.
    stated, least = np.sqrt((std**2).mean(axis=0)), np.sqrt((limit**2).mean(axis=0))
    score = error / std
    mean_square = (score**2).mean(axis=0)
    square_band = tuple(chi2.interval(BAND, runs) / np.float64(runs))
    inside = {level: (np.abs(score) <= limit_sigma).mean(axis=0) for level, limit_sigma in LEVELS.items()}
    bands = {level: binomial_band(runs, share) for level, share in EXPECTED.items()}
    misses = 0

    def judged(value: float, band: tuple[float, float], text: str) -> str:
        nonlocal misses
        if band[0] <= value <= band[1]:
            return text
        misses += 1
        return f"**{text}**"

    rows = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        cells = [
            name,
            unit,
            f"{rmse[i]:.2e}",
            f"{stated[i]:.2e}",
            f"{rmse[i] / stated[i]:.3f}",
            f"{least[i]:.2e}",
            f"{rmse[i] / least[i]:.3f}",
            judged(mean_square[i], square_band, f"{mean_square[i]:.3f}"),
            *(judged(inside[level][i], bands[level], f"{100 * inside[level][i]:.1f}") for level in LEVELS),
        ]
        rows.append("| " + " | ".join(cells) + " |")
    header = "| parameter | unit | RMSE | stated σ | RMSE / σ | bound | RMSE / bound | (error / σ)² | "
    header += " | ".join(LEVELS) + " |"
    checked = len(names) * (1 + len(LEVELS))
    band_row = "; ".join(
        [f"(error / σ)² {square_band[0]:.3f} to {square_band[1]:.3f}"]
        + [f"{level} {100 * low:.1f} to {100 * high:.1f}" for level, (low, high) in bands.items()]
    )
    introduction = f"""# Accuracy

Written by `make accuracy`: {runs} simulated runs of the paper's gyroscope program and unit (45 moves of 2 s,
holds of 5 s, {RATE_HZ:g} Hz, datasheet white noise, counts), seeds 1 to {runs}, each with its own moves.

* stated σ: the standard deviation that imucal gives, root mean square over the runs.
* bound: the Cramér-Rao bound of the same runs, by [benches/bound.py](../../benches/bound.py), which shares no
  derivative with the estimator. RMSE / bound is 1 for the best unbiased estimator; the RMSE itself is
  uncertain by {100 / np.sqrt(2 * runs):.1f} % (1 σ).
* (error / σ)²: mean over the runs, 1 if the stated σ is true.
* 68 %, 95 %, 99.7 %: share of the runs with the truth inside the stated interval of that level.

Figures outside the band that holds {100 * BAND:.0f} % of perfect estimators are bold. The bands: {band_row}.
"""
    efficiency = rmse / least
    # Parameters of one run hang together, runs do not.
    of_run = (score**2).mean(axis=1)
    pooled, pooled_error = of_run.mean(), of_run.std(ddof=1) / np.sqrt(runs)
    conclusion = f"""
{misses} of {checked} figures are outside their band; of a perfect estimator
{(1 - BAND) * checked:.1f} would be.
RMSE / bound is {np.min(efficiency):.3f} to {np.max(efficiency):.3f}, median {np.median(efficiency):.3f}.
Over all parameters (error / σ)² is {pooled:.3f} +- {pooled_error:.3f} (1 σ): the stated σ are
{100 * (1 / np.sqrt(pooled) - 1):+.1f} % off.
The largest |error| / σ of all {runs * len(names)} is {np.max(np.abs(score)):.2f}.
"""
    rule = "|---|---|" + "---:|" * (header.count("|") - 3)
    return "\n".join([introduction, header, rule, *rows, conclusion])


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=400)
    arguments.add_argument("--processes", type=int, default=2)
    arguments.add_argument("--output", type=Path, default=REPORT)
    given = arguments.parse_args()
    done = trials(given.runs, given.processes)
    truth = imucal.simulate("random", seed=1, rate_hz=RATE_HZ).truth.calibration.parameters
    text = report(done, [p.name for p in truth], [p.unit for p in truth])
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(text, encoding="utf-8")
    print(text)
    print(f"written to {given.output}")


if __name__ == "__main__":
    main()
