"""Run the benchmark; `python -m gap --help` with this folder's parent on the path."""

import os

# Two processes share the machine: threads of NumPy within them would only get in each other's way.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import json
import sys
import traceback
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from answers import plain, read, say_origin
from engine import add_arguments, engine_of
from gap.gates import gates
from gap.judge import Mark
from gap.page import page, record
from gap.suite import SEED, TOOL, run, suite

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "docs" / "results" / "gap.md"
QUICK_SHARE = 0.0
# Shares whose answers are kept, so that the page can be made of them again.
KEPT_SHARES = (1.0, 0.5)


def job(share: float, with_baselines: bool, asked: tuple[int, int]) -> list[Mark]:
    """One case by seed and number: cases hold functions, which do not travel between processes."""
    seed, index = asked
    case = suite(share, seed)[index]
    try:
        return run(case, with_baselines)
    except Exception:
        # One case must not end a run of an hour; which one it was is what is needed.
        print(f"{case.group}, {case.label}, {case.level}, {case.kind}, {case.index}", file=sys.stderr)
        traceback.print_exc()
        raise


def chosen(share: float, only: dict[str, list[str]], quick: bool) -> list[int]:
    """Numbers of the cases to run."""
    if quick:
        # One case in so many: all groups, not all cells.
        return [i for group in dict.fromkeys(c.group for c in suite(share)) for i in _few(share, group)]
    return [
        i
        for i, case in enumerate(suite(share))
        if all(not wanted or getattr(case, name) in wanted for name, wanted in only.items())
    ]


def write_again(path: Path) -> None:
    """Write the page of the kept answers."""
    origin, kept = read("gap")
    rows = list(kept)
    [seed] = {row.argument[0] for row in rows}
    marks = in_order(mark_of(mark) for row in rows for mark in row.answer)
    path.write_text(page(marks, seed), encoding="utf-8")
    say_origin(path, "gap", origin, len(rows))


def mark_of(row: dict[str, Any]) -> Mark:
    """A mark as it is kept."""
    row = _with_numbers(row)
    return Mark(**{**row, "scores": tuple(row["scores"]), "truth": tuple(row["truth"])})


def _with_numbers(value: Any) -> Any:
    """Kept numbers that are not finite are words."""
    if isinstance(value, dict):
        return {key: _with_numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_with_numbers(each) for each in value]
    return float(value) if value in ("nan", "inf", "-inf") else value


def in_order(marks: Iterable[Mark]) -> list[Mark]:
    """By the order of their cases."""
    order = {case.key: place for place, case in enumerate(suite(1.0))}
    return sorted(marks, key=lambda mark: order[mark.key])


def _few(share: float, group: str, count: int = 1) -> list[int]:
    mine = [i for i, case in enumerate(suite(share)) if case.group == group and case.level != "1x"]
    return mine[:: max(1, len(mine) // count)][:count]


def calls() -> dict[str, Callable[[tuple[int, int]], list[Mark]]]:
    """The function of the cases of each share, which takes the seed and the number of a case."""
    return {
        name_of(with_baselines, share): partial(job, share, with_baselines)
        for with_baselines in (True, False)
        for share in KEPT_SHARES
    }


def name_of(with_baselines: bool, share: float) -> str:
    """The name of the calls."""
    return f"share {share}, baselines {with_baselines}"


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument(
        "--share", type=float, default=1.0, help="share of each cell, at least one case of it"
    )
    arguments.add_argument("--group", action="append", default=[], help="only this group (several times)")
    arguments.add_argument("--label", action="append", default=[], help="only this label (several times)")
    arguments.add_argument("--level", action="append", default=[], help="only this level (several times)")
    arguments.add_argument(
        "--quick", action="store_true", help="a few cases of each group, to standard output"
    )
    arguments.add_argument("--no-baselines", action="store_true")
    arguments.add_argument("--seed", type=int, default=SEED, help="of all cases")
    add_arguments(arguments)
    arguments.add_argument(
        "--most", type=int, help="ask so many at the most; the page says how many there are"
    )
    arguments.add_argument("--output", type=Path, default=REPORT)
    arguments.add_argument("--kept", action="store_true", help="make the page again from its kept answers")
    given = arguments.parse_args()
    if given.kept:
        write_again(given.output)
        return 0
    share = QUICK_SHARE if given.quick else given.share
    only = {"group": given.group, "label": given.label, "level": given.level}
    # Mixed, so that a run that is broken off has seen a bit of everything.
    numbers = sorted(chosen(share, only, given.quick), key=lambda i: suite(share)[i].mixed)
    numbers = numbers[: given.most]
    work = partial(job, share, not given.no_baselines)
    with engine_of(given, "gap") as engine:
        name = name_of(not given.no_baselines, share)
        asked = [(given.seed, number) for number in numbers]
        # A case takes seconds, so each is a task of its own.
        found = engine.map(work, asked, name=name, per_task=1)
        done = list(track(found, "asking", total=len(numbers), disable=given.quick))
    # With the digits that are kept, so that the page can be made again.
    marks = in_order(mark_of(plain(mark)) for of_case in done for mark in of_case)
    text = page(marks, given.seed)
    print(text)
    if not given.quick:
        given.output.parent.mkdir(parents=True, exist_ok=True)
        given.output.write_text(text, encoding="utf-8")
        table = given.output.with_suffix(".json")
        table.write_text(json.dumps(record(marks), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        # A part of the groups does not have all answers.
        if given.output == REPORT and share in KEPT_SHARES and len(numbers) == len(suite(share)):
            engine.publish(REPORT)
        print(f"written to {given.output} and {table.name}")
    # The page prints what is missed; only a tool that answers nothing is a failure of the run.
    return 0 if any(gate.of for gate in gates([m for m in marks if m.tool == TOOL])) else 1


if __name__ == "__main__":
    sys.exit(main())
