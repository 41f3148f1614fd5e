"""Run it all; `python -m plan --help` with this folder's parent on the path."""

import os

# Two processes share the machine: threads of NumPy within them would only get in each other's way.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from engine import add_arguments, engine_of, own_runs, own_seeds
from plan.agreement import PROGRAMS, Agreement, case_of, errors_of, planned
from plan.duration import curve, durations, visible
from plan.page import figure, gates, page

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
RUNS = 1000


def calls() -> dict[str, Callable[[int], Any]]:
    """The function of each program, which takes a seed."""
    return {name: partial(errors_of, name) for name in PROGRAMS}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=own_runs, default=RUNS, help="simulated runs of each program")
    add_arguments(arguments)
    arguments.add_argument("--output", type=Path, default=RESULTS, help="folder of plan.md and plan.svg")
    given = arguments.parse_args()
    with engine_of(given, "plan") as engine:
        searched = engine.call(durations, name="durations")
        points = engine.call(curve, name="curve")
        agreements = []
        for number, name in enumerate(
            track(PROGRAMS, "calibrations", disable=not sys.stderr.isatty()), start=1
        ):
            case = case_of(name)
            minutes = sum(planned(motion).minutes for motion in case.motions)
            # The case has its program with it, so that no process searches for it again.
            found = list(engine.map(case.errors, own_seeds(number, given.runs), name=name))
            agreements.append(Agreement.of(case, minutes, found))
            print(f"{name}: worst {agreements[-1].worst:.3f}", file=sys.stderr, flush=True)
        found_durations, found_points = searched(), points()
    text = page(agreements, found_durations, found_points, visible(found_durations))
    (given.output / "plan.md").write_text(text, encoding="utf-8")
    (given.output / "plan.svg").write_text(figure(found_points), encoding="utf-8")
    if given.output == RESULTS:
        engine.publish(RESULTS / "plan.md")
    print(text)
    return 0 if all(met for *_, met in gates(agreements, found_durations)) else 1


if __name__ == "__main__":
    sys.exit(main())
