"""Run it all, or a part; `python -m accuracy --help` with this folder's parent on the path."""

import os

# Two processes share the machine: threads of NumPy within them would only get in each other's way.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from accuracy.contaminated import Contamination, spoilt
from accuracy.faults import FAULTS
from accuracy.figures import SceneFigures
from accuracy.page import page
from accuracy.scene import CONDITIONS, HELD, PAPER
from accuracy.trial import trial
from engine import Engine, add_arguments, engine_of, own_runs, own_seeds

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "docs" / "results" / "accuracy.md"
RUNS = {"paper": 4000, "hand-held": 1000, "conditions": 1000, "contaminated": 100}
SCENES = {"paper": (PAPER,), "hand-held": (HELD,), "conditions": CONDITIONS}


def many(engine: Engine, runs: int, name: str) -> list[Any]:
    """The answers of a condition."""
    functions = calls()
    seeds = own_seeds(1 + list(functions).index(name), runs)
    done = engine.map(functions[name], seeds, name=name)
    return list(track(done, name, total=runs, disable=not sys.stderr.isatty()))


def calls() -> dict[str, Callable[[int], Any]]:
    """The function of each condition, which takes a seed."""
    scenes = [scene for of_part in SCENES.values() for scene in of_part]
    trials = {scene.name: partial(trial, scene) for scene in scenes}
    return {**trials, **{name: partial(spoilt, name) for name in FAULTS}}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("parts", nargs="*", help=f"of {', '.join(RUNS)}; all without any")
    arguments.add_argument("--runs", type=own_runs, help="seeds of each kind, instead of the full numbers")
    add_arguments(arguments)
    arguments.add_argument("--output", type=Path, help="the page; a part goes to standard output alone")
    given = arguments.parse_args()
    parts = given.parts or list(RUNS)
    unknown = [part for part in parts if part not in RUNS]
    if unknown:
        arguments.error(f"{unknown[0]!r} is no part: give one or more of {', '.join(RUNS)}")
    start_s = time.monotonic()
    scenes, contaminations = [], []
    with engine_of(given, "accuracy") as engine:
        for part in parts:
            runs = given.runs or RUNS[part]
            for scene in SCENES.get(part, ()):
                trials = many(engine, runs, scene.name)
                scenes.append(SceneFigures(scene, trials))
            for name in FAULTS if part == "contaminated" else ():
                done = many(engine, runs, name)
                contaminations.append(Contamination.of(name, done))
    text = page(scenes, contaminations, time.monotonic() - start_s)
    print(text)
    output = given.output or (None if given.parts or given.runs else REPORT)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text, encoding="utf-8")
        if output == REPORT:
            engine.publish(REPORT)
        print(f"written to {output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
