"""Benchmark of sensors that remember the temperature: names, and the accuracy of the time constants.

`make thermal-benchmark` writes docs/results/thermal.md. The cases are those of `thermal_cases`.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.progress import track
from scipy.stats import norm

import imucal
from engine import add_arguments, engine_of
from gap.law_cases import NONCENTRALITY, TIMES
from gap.rates import Rate
from gap.thermal_cases import CLEAN, FAMILIES, pose

REPORT: Final = Path(__file__).parents[2] / "docs/results/thermal.md"
# Cases 0 to 299 of each family were used while the search was written, so that they prove nothing about it.
FIRST: Final = 300
# Maximum relative error of a time constant to count as near the truth.
NEAR: Final = 0.1


def asked(case: tuple[str, int]) -> dict[str, Any]:
    """One case: the names, the time constant and the figures on the control recording."""
    family, index = case
    measured, control, truth, clean = pose(family, index)
    start = time.perf_counter()
    gap = imucal.find_gap(measured, control=control)
    row: dict[str, Any] = {
        "family": family, "index": index, "verdict": gap.verdict,
        "seconds": round(time.perf_counter() - start, 2),
        "named": [str(effect["name"]) for effect in gap.effects if effect["parameters"]],
        "counts": [len(effect["parameters"]) for effect in gap.effects if effect["parameters"]],
        "laws": [law.formula for law in gap.laws],
        "remainder": gap.remainder.kind if gap.remainder else "",
    }  # fmt: skip
    if truth is None:
        return row
    taus = [
        (own["value"], own["std"])
        for effect in gap.effects
        if effect["name"] in truth.names
        for own in effect["parameters"]
        if own["name"].endswith("tau")
    ]
    floor_of = imucal.calibrate(clean[0]).calibration
    floor = float(imucal.evaluate(floor_of, clean[1]).figures.chi2_per_dof)
    return row | {
        "truth": sorted(truth.names), "tau_s": truth.tau_s, "found_tau_s": taus[0][0] if taus else None,
        "tau_std_s": taus[0][1] if taus else None, "tau_bound_s": truth.tau_bound_s,
        "before": gap.gap["before"], "after": gap.gap["after"], "floor": floor,
    }  # fmt: skip


def is_right(row: dict[str, Any]) -> bool:
    """Whether the truth is named, alone or beside the temperature of its sensor, and no law joined."""
    (truth,) = row["truth"]
    beside = truth[: truth.index("_temperature")] + "_temperature"
    return set(row["named"]) - {beside} == {truth} and not row["laws"]


def has_degree(row: dict[str, Any], degree: int) -> bool:
    """Whether the polynomial of this degree is named alone; with degree 0, whether nothing is named."""
    if degree == 0:
        return not row["named"] and not row["laws"]
    is_bias = [name.endswith("_bias_temperature") for name in row["named"]] == [True]
    return is_bias and row["counts"] == [3 * degree] and not row["laws"]


def error_of(row: dict[str, Any]) -> float:
    return abs(row["found_tau_s"] / row["tau_s"] - 1.0)


def is_near(row: dict[str, Any]) -> bool:
    """Whether the estimate of tau is within 10 % of the truth."""
    return error_of(row) < NEAR


def is_covered(row: dict[str, Any]) -> bool:
    """Whether the truth is within two standard deviations of the estimate of tau."""
    return abs(row["found_tau_s"] - row["tau_s"]) < 2.0 * row["tau_std_s"]


def page(rows: list[dict[str, Any]]) -> str:
    """The page of results."""
    return "\n".join(_parts(rows))


def _parts(rows: list[dict[str, Any]]) -> Iterator[str]:
    hidden, clean = [r for r in rows if "truth" in r], [r for r in rows if "truth" not in r]
    floor = 2.0 / np.sqrt(TIMES**2 * NONCENTRALITY)
    most = 2.0 * norm.cdf(NEAR / floor) - 1.0
    yield INTRODUCTION.format(
        cases=len(rows), hidden=len(hidden), clean=len(clean), floor=100.0 * floor, most=100.0 * most
    )
    yield "## Families\n"
    yield (
        "| family | named, and nothing else | named | verdict `named` | control gap closed, median |\n"
        "| --- | ---: | ---: | ---: | ---: |"
    )
    for family in dict.fromkeys(row["family"] for row in hidden):
        own = [row for row in hidden if row["family"] == family]
        closed = [(r["before"] - r["after"]) / (r["before"] - r["floor"]) for r in own]
        yield (
            f"| {family} | {Rate.count(map(is_right, own))} | "
            f"{Rate.count(set(row['truth']) <= set(row['named']) for row in own)} | "
            f"{Rate.count(row['verdict'] == 'named' for row in own)} | {np.median(closed):.3f} |"
        )
    yield "\n## Time constants\n"
    yield (
        "| family | within 10 % | within two sigma | within 10 % or two sigma | median error | "
        "Cramér-Rao bound, median | within 10 % at this bound |\n"
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    )
    for family in dict.fromkeys(row["family"] for row in hidden if row["tau_s"] and row["found_tau_s"]):
        timed = [row for row in hidden if row["family"] == family and row["tau_s"] and row["found_tau_s"]]
        bounds = np.array([row["tau_bound_s"] / row["tau_s"] for row in timed])
        yield (
            f"| {family} | {Rate.count(map(is_near, timed))} | {Rate.count(map(is_covered, timed))} | "
            f"{Rate.count(is_near(row) or is_covered(row) for row in timed)} | "
            f"{100 * np.median([error_of(row) for row in timed]):.1f} % | {100 * np.median(bounds):.1f} % | "
            f"{100 * np.mean(2.0 * norm.cdf(NEAR / bounds) - 1.0):.0f} % |"
        )
    if not clean:
        return
    yield "\n## Without a memory\n"
    yield "| family | cases | memory named | laws | right effect and degree, and nothing else |"
    yield "| --- | ---: | ---: | ---: | ---: |"
    for family in dict.fromkeys(row["family"] for row in clean):
        own = [row for row in clean if row["family"] == family]
        false = Rate.count(any("_temperature_" in name for name in row["named"]) for row in own)
        laws = sum(bool(row["laws"]) for row in own)
        right = Rate.count(has_degree(row, CLEAN[family]) for row in own)
        yield f"| {family} | {len(own)} | {false} | {laws} | {right} |"
    yield ""


INTRODUCTION = """# Sensors that remember the temperature

Written by `make thermal-benchmark`: {cases} cases with fixed seeds, none of which was used while the search
was written. {hidden} of them have a bias that depends on the temperature history, and {clean} have none. The
recordings are made without the simulator of the product: 46 rests, 320 s, 100 Hz, noise of a consumer sensor,
two cycles of 15 to 30 K with faster swings of 2 to 5 K. A lag is the convolution of the temperature with an
exponential of 12 to 40 s, and a lead is the opposite response. A hysteresis is the mean of relays that
switch 0.4 to 1.2 K above and below each temperature. The size is five times the detection limit: the part of
the error that no straight line in the temperature describes has a chi2, after the 21 base parameters are
fitted, of 25 times the noncentrality 27. In a strong family the size is 20 times the detection limit.

* Rate: the bias follows the exact derivative of the temperature. The rate of the catalogue has a delay of
  1 s.
* Named, and nothing else: the effects are the truth alone, or with `*_bias_temperature` of the same
  sensor.
* Verdict `named`: the verdict is `ambiguous` if an alias describes the recording nearly as well.
* Cramér-Rao bound: the smallest standard deviation of tau that an unbiased estimate can have, relative to
  tau. The base parameters, the coefficients of the lag and those of the temperature are estimated, too.
* Within 10 % at this bound: the share of the cases in which an estimate with this standard deviation is
  within 10 % of the truth. No temperature program brings this share near 95 % at five times the limit: with
  the same noise throughout a recording, the standard deviation of tau is at least {floor:.1f} % of tau,
  and the share is at most {most:.0f} %. The reason: the low-pass filter of the lag is G = (1 + U) / 2,
  where the all-pass filter U keeps the norm, and the derivative of the lag h with respect to log(tau) is G h.
  The part of G h that the coefficients of h and of T do not describe is the same part of U h' / 2, where h'
  is the part of h that T does not describe. The norm of U h' / 2 is half of the norm of h', and chi2 of h'
  is 25 * 27.
* Control gap closed: reduction of chi2 of the control recording, relative to the same recordings without the
  error.
"""


def calls() -> dict[str, Callable[[tuple[str, int]], Any]]:
    """The function of all cases."""
    return {"thermal": asked}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cases", type=int, default=40, help="cases of each family with a memory")
    arguments.add_argument("--clean", type=int, default=100, help="cases of each family without a memory")
    add_arguments(arguments)
    arguments.add_argument("--output", type=Path, default=REPORT)
    given = arguments.parse_args()
    order = (*FAMILIES, *CLEAN)
    # All families advance together, so that a run that is broken off has seen each of them.
    cases = [
        (family, index)
        for index in range(FIRST, FIRST + max(given.cases, given.clean))
        for family in order
        if index < FIRST + (given.clean if family in CLEAN else given.cases)
    ]
    with engine_of(given, "thermal") as engine:
        answers = engine.map(asked, cases, name="thermal", per_task=1)
        rows = list(track(answers, "thermal", total=len(cases), disable=not sys.stderr.isatty()))
    rows.sort(key=lambda row: (order.index(row["family"]), row["index"]))
    text = page(rows)
    print(text)
    given.output.write_text(text, encoding="utf-8")
    if given.output == REPORT:
        engine.publish(REPORT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
