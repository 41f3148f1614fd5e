"""Benchmark of units with strong effects, with variations in time, and of two sessions.

`make units-benchmark` writes docs/results/units.md. The cases are those of `unit_cases`.
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

from rich.progress import track

import imucal
from engine import add_arguments, engine_of
from gap.rates import Rate
from gap.unit_cases import FAMILIES, SESSIONS, STRONG, Truth, pose

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "docs" / "results" / "units.md"
FIGURES: Final = ("gravity_norm_rms_mps2", "gravity_direction_rms_deg")
# Control errors within this factor of those of a fit with the true effects count as taken away.
NEAR: Final = 1.1

Row = dict[str, Any]


def asked(case: tuple[str, int]) -> Row:
    """One case: what imucal says, beside the truth."""
    family, index = case
    measured, control, truth = pose(family, index)
    start = time.perf_counter()
    gap = imucal.find_gap(measured, control=control)
    seconds = time.perf_counter() - start
    remainder = gap.remainder
    session = remainder.session if remainder else None
    named = [str(effect["name"]) for effect in gap.effects if effect["parameters"]]
    return {
        "family": family, "index": index, "verdict": gap.verdict, "named": named,
        "ambiguous": list(gap.ambiguous_with), "laws": [law.formula for law in gap.laws],
        "remainder": remainder.kind if remainder else "", "block": remainder.block if remainder else None,
        "pattern": remainder.pattern if remainder else None, "cause": session.cause if session else None,
        "faults": [str(effect["name"]) for effect in gap.effects if not effect["parameters"]],
        "truth": list(truth.effects), "is_random": truth.is_random, "blocks": list(truth.blocks),
        "errors": _errors(gap, measured, control, truth), "asks_for_more": "record more" in gap.summary(),
        "seconds": round(seconds, 2),
    }  # fmt: skip


def _errors(
    gap: imucal.Gap, measured: imucal.Recording, control: imucal.Recording, truth: Truth
) -> list[float | None] | None:
    """Control errors over those of a fit with the true effects; None if the catalogue lacks the truth.

    An error is None if no move of the control recording can be judged.
    """
    known = {effect.name for effect in imucal.effects.catalogue()}
    if not truth.effects or not set(truth.effects) <= known or gap.control_set is None:
        return None
    fitted = imucal.calibrate(measured, effects=truth.effects).calibration
    best = imucal.evaluate(fitted, control).figures
    pairs = [(gap.control_set["after"][name], getattr(best, name)) for name in FIGURES]
    return [after / least if after is not None and least else None for after, least in pairs]


def is_named(row: Row) -> bool:
    """Whether the effects of the truth, and no others, were named, alone or with rivals."""
    return set(row["named"]) == set(row["truth"]) and row["verdict"] in ("named", "ambiguous")


def is_taken_away(row: Row) -> bool:
    return row["errors"] is not None and all(error is not None and error <= NEAR for error in row["errors"])


def is_stochastic(row: Row) -> bool:
    """Whether the remainder is `stochastic`. A verdict `data_fault` does not count as this answer."""
    return row["remainder"] == "stochastic" and row["verdict"] != "data_fault"


def is_wrong(row: Row) -> bool:
    """A name, stated with certainty, that is not the truth's."""
    return row["verdict"] == "named" and bool(set(row["named"]) - set(row["truth"]))


def is_explained(row: Row) -> bool:
    """Whether the answer is right: the true effects, or a remainder in a right part of the model."""
    if row["truth"]:
        return is_named(row) or (not row["named"] and row["verdict"] == "unknown")
    if row["blocks"] == ["noise"]:
        return row["verdict"] in ("nothing_missing", "data_fault") and row["faults"] in (
            [],
            ["noise_grows_in_motion"],
        )
    is_there = row["block"] in row["blocks"] or bool(row["laws"])
    return not row["named"] and is_there


def page(rows: list[Row]) -> Iterator[str]:
    yield INTRODUCTION.format(cases=len(rows))
    yield from _gates(rows)
    yield "\n## Families\n"
    yield "| family | cases | names right | errors within 10 % | wrong name | answers |"
    yield "| --- | ---: | ---: | ---: | ---: | --- |"
    for family in dict.fromkeys(row["family"] for row in rows):
        own = [row for row in rows if row["family"] == family]
        has_names = bool(own[0]["truth"])
        cells = [
            family, len(own), sum(map(is_named, own)) if has_names else "-",
            sum(map(is_taken_away, own)) if any(row["errors"] for row in own) else "-",
            sum(map(is_wrong, own)), _answers(own),
        ]  # fmt: skip
        yield f"| {' | '.join(map(str, cells))} |"
    yield ""


def _gates(rows: list[Row]) -> Iterator[str]:
    yield "## Gates\n"
    yield "| | aim | found | |\n| --- | ---: | ---: | ---: |"
    known = [row for row in rows if row["errors"] is not None]
    strong = [row for row in rows if row["family"] in STRONG]
    sessions = [row for row in rows if row["family"] in SESSIONS]
    fixed = [row for row in rows if not row["is_random"] and row["family"] not in SESSIONS]
    taken = Rate.count(is_named(row) and is_taken_away(row) for row in known)
    yield _gate("known effects named, and control error within 10 % of a fit with the truth", 0.95, taken)
    yield _gate("strong effects named, or unknown", 0.95, Rate.count(map(is_explained, strong)))
    yield _gate("a wrong name, stated with certainty", -0.01, Rate.count(map(is_wrong, rows)))
    yield _gate("deterministic variations called stochastic", -0.05, Rate.count(map(is_stochastic, fixed)))
    walks = Rate.count(is_stochastic(row) for row in rows if row["is_random"])
    yield _gate("random walks called stochastic", 0.95, walks)
    nothing = Rate.count(row["verdict"] == "nothing_missing" for row in sessions)
    yield _gate("two sessions: nothing missing", -0.0, nothing)
    causes = {"temperature": "temperature", "switch-on": "switch_on"}
    right = Rate.count(row["cause"] == causes[row["blocks"][0]] for row in sessions)
    yield _gate("two sessions: cause right", 0.95, right)
    more = Rate.count(row["asks_for_more"] for row in rows)
    yield _gate("an answer that asks for more rests", -0.0, more)


def _gate(what: str, aim: float, found: Rate) -> str:
    """A row of the gates; a negative aim is an upper limit."""
    is_limit = str(aim).startswith("-")
    is_met = found.value <= -aim if is_limit else found.value >= aim
    words = f"at {'most' if is_limit else 'least'} {100 * abs(aim):.0f} %"
    return f"| {what} | {words} | {found} | {'met' if is_met else '**missed**'} |"


def _answers(rows: list[Row]) -> str:
    """The answers with their numbers, the most frequent first."""
    counts: dict[str, int] = {}
    for row in rows:
        remainder = f"{row['remainder']} ({row['block']}, {row['pattern']})" if row["block"] else ""
        names = " + ".join(row["named"]) + (
            f" or {' or '.join(row['ambiguous'])}" if row["ambiguous"] else ""
        )
        laws = f"law of {len(row['laws'])}" if row["laws"] else ""
        said = ", ".join(filter(None, (names, laws, *row["faults"], remainder))) or row["verdict"]
        counts[said] = counts.get(said, 0) + 1
    order = sorted(counts.items(), key=lambda item: -item[1])
    rest = sum(count for _, count in order[3:])
    shown = [f"{said} {count}" for said, count in order[:3]] + ([f"others {rest}"] if rest else [])
    return "; ".join(shown)


INTRODUCTION: Final = """# Units with strong effects, variations in time, and two sessions

Written by `make units-benchmark`: {cases} cases with fixed seeds. The recordings are made without the
simulator of the product: 46 rests, 320 s, 100 Hz, noise of a consumer sensor. The search gets a recording
and a control recording with different motion and noise.

* Names right: the named effects are those of the truth, alone or with rivals.
* Errors within 10 %: norm and direction of gravity on the control recording, relative to a calibration
  that is fitted with the true effects.
* Answers: named effects, then the remainder with its part of the model and its pattern.

The gates compare the found shares themselves; the intervals (95 %) show how much so many cases can tell.
"""


def calls() -> dict[str, Callable[[tuple[str, int]], Any]]:
    """The function of all cases."""
    return {"units": asked}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cases", type=int, default=40, help="cases of each family")
    arguments.add_argument("--family", action="append", default=[], help="only this family (several times)")
    add_arguments(arguments)
    arguments.add_argument("--output", type=Path, default=REPORT)
    given = arguments.parse_args()
    # All families advance together, so that a run that is broken off has seen each of them.
    cases = [(family, index) for index in range(given.cases) for family in given.family or FAMILIES]
    with engine_of(given, "units") as engine:
        answers = engine.map(asked, cases, name="units", per_task=1)
        rows = list(track(answers, "units", total=len(cases), disable=not sys.stderr.isatty()))
    order = list(FAMILIES)
    rows.sort(key=lambda row: (order.index(row["family"]), row["index"]))
    text = "\n".join(page(rows))
    print(text)
    given.output.write_text(text, encoding="utf-8")
    if given.output == REPORT:
        engine.publish(REPORT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
