"""The page of results, and the same for programs."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from gap.gates import gates, has_wrong_name, is_alone, is_solved, verdicts
from gap.judge import Mark
from gap.rates import Rate
from gap.sizes import SIZES, typical
from gap.suite import TOOL, suite
from gap.worth import rows as rows_of_worth

LEVELS = ("1x", "2x", "5x", "10x", "typical")
INTRODUCTION = """# Finding hidden effects

Written by `make gap-benchmark`: {cases} with an effect or fault hidden in simulated data, or with none.
All random numbers follow from the seed {seed} and the names of the cases. The search gets a recording and a
control recording with different moves and noise. The truth is compared only after the search has returned
its result. Unit, noise and program are those of the paper: 46 rests, 320 s, 100 Hz.

* Data: A is rotated by hand, A' on a stand (the force inside moves takes part), and C has encoders. T has
  a temperature that rises and falls by 30 K.
* Limit: the smallest root mean square of the parameters that one recording shows with 90 % power at a
  family-wise alpha of 0.01, [predicted independently of the search](../../benches/gap/limits.py), for the
  noise of the unit and, in C, of encoders (0.005 deg). Hidden effects have multiples of this limit, in a
  random direction of their parameters.
* Equals: effects that a recording cannot tell apart. An answer that names them is `ambiguous`. A gate
  counts such an answer only if its label says so.
* Rates are followed by counts and their 95 % interval (Clopper and Pearson).
* Gap closed: a fit with the true effects reduces chi2 of the control recording, computed by
  `imucal.evaluate`. The figure is the share of this reduction that the result of the search achieves. It
  is given if the reduction is at least a third of chi2.
"""


def page(marks: Sequence[Mark], seed: int) -> str:
    """The page of results.

    seed  of the benchmark
    """
    mine = [mark for mark in marks if mark.tool == TOOL]
    sections = [
        INTRODUCTION.format(cases=_how_many(len(mine)), seed=seed),
        _gates(mine),
        _tools(marks),
        _effects(mine),
        _worth(mine),
        _confusion(mine),
        _clean(mine),
        _other(mine),
        _times(marks),
    ]
    return "\n".join(sections)


def _how_many(cases: int) -> str:
    whole = len(suite(1.0))
    return f"{cases} cases" if cases >= whole else f"{cases} of {whole} cases, taken in a mixed order,"


def table(heading: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (heading, rule, *rows)) + "\n"


def _gates(marks: Sequence[Mark]) -> str:
    rows = [(g.what, g.aim, g.found, "met" if g.met else "**missed**") for g in gates(marks)]
    words = "\nSingle effects that answers name with equals, and the number of these answers: "
    return "## Gates\n\n" + table(("", "aim", "found", ""), rows) + words + _with_equals(marks) + ".\n"


def _with_equals(marks: Sequence[Mark]) -> str:
    """The effects that were not named alone, by their size."""
    said = []
    for level in LEVELS[1:]:
        of = [m for m in marks if m.group == "single" and m.level == level]
        counts = Counter(m.label for m in of if m.first and not is_alone(m))
        names = ", ".join(f"`{name}` {count}" for name, count in counts.most_common())
        said.append(f"{level} {names or 'none'}")
    return "; ".join(said)


def _tools(marks: Sequence[Mark]) -> str:
    """The textbook ways on the cases that they were asked."""
    tools = list(dict.fromkeys(mark.tool for mark in marks))
    if len(tools) < 2:
        return ""
    asked = {m.key for m in marks if m.tool != TOOL}
    rows = []
    for tool, only_alone in [(tools[0], False), (tools[0], True), *((tool, False) for tool in tools[1:])]:
        of = [m for m in marks if m.tool == tool and m.key in asked]
        single = [m for m in of if m.group == "single"]
        counts = is_alone if only_alone else lambda mark: True
        rows.append(
            (
                tool + " without answers that name equals" * only_alone,
                *(
                    _short([m.first and counts(m) for m in single if m.level == level])
                    for level in LEVELS[:4]
                ),
                _short([m.exact and counts(m) for m in single if m.level in ("5x", "10x")]),
                _short([m.exact and counts(m) for m in of if m.group == "pair"]),
                *(
                    ("-", "-", "-")
                    if only_alone
                    else (
                        _short(map(has_wrong_name, single)),
                        _short([m.false_alarm for m in of if m.group == "clean"]),
                        _short(verdicts(of, "outside")),
                    )
                ),
            )
        )
    heading = (
        "", "first at 1x", "2x", "5x", "10x", "exact at 5x, 10x", "pairs exact", "wrong names",
        "false alarms", "outside: unknown",
    )  # fmt: skip
    words = (
        "All methods get the same cases, whitened residuals and Jacobian columns. The textbook methods\n"
        "cannot report that an effect is unknown or that two effects are equivalent. A wrong answer\n"
        "contains a name that was not hidden; of equals, one has to be.\n\n"
    )
    return "## Comparison with textbook methods\n\n" + words + table(heading, rows)


def _short(flags: Iterable[bool | None]) -> str:
    rate = Rate.count(flags)
    return f"{100 * rate.value:.1f} %" if rate.of else "-"


def _effects(marks: Sequence[Mark]) -> str:
    """First names effect by effect, and the tool's own limits, in clean runs, beside those of the table."""
    rows = []
    for name, size in SIZES.items():
        mine = [m for m in marks if m.group == "single" and m.label == name]
        found = [_count(m.first for m in mine if m.level == level) for level in LEVELS]
        exact = _count(m.exact for m in mine if m.level in ("5x", "10x"))
        usual = f"{typical(name) / size.here:.1f}"
        limits = " / ".join(_limit(marks, name, kind) for kind in ("A", "A'", "C"))
        rows.append((f"`{name}`", size.kind, *found, exact, usual, limits))
    heading = (
        "first name right, alone or before its equals", "data", *LEVELS,
        "exact, alone or with equals, 5x and 10x", "typical / limit",
        "limit by the tool / predicted: A / A' / C",
    )  # fmt: skip
    return "## Effect by effect\n\n" + table(heading, rows)


def _worth(marks: Sequence[Mark]) -> str:
    """Claimed errors of the corrected control recording beside the true ones."""
    rows = rows_of_worth(marks)
    if not rows:
        return ""
    words = (
        "The errors are root mean squares of the corrected control recording minus the simulated truth, for\n"
        "means over 1 s of the signal that the effect disturbs, in SI units. The cases are those at 5 and\n"
        "10 times the limit in which an effect was named. The factor is the error with the plain\n"
        "calibration divided by that with the improved one. The search reports a factor and an interval\n"
        "that should contain the true factor in 95 %.\n\n"
    )
    heading = (
        "", "claims", "true error, median", "true factor, median", "claimed / true, median", "5 % to 95 %",
        "within 10 %", "interval holds",
    )  # fmt: skip
    return "## Predicted error of the correction\n\n" + words + table(heading, rows)


def _limit(marks: Sequence[Mark], name: str, kind: str) -> str:
    """The tool's limit over the predicted one in clean runs; those of temperature where it changes."""
    kind_of_run = kind + "T" * SIZES[name].kind.endswith("T")
    limits = [
        mark.said["smallest_visible"].get(name)
        for mark in marks
        if mark.group == "clean" and mark.label == "white" and mark.kind == kind_of_run
    ]
    known = [limit for limit in limits if limit is not None]
    return f"{np.median(known) / SIZES[name].limit[kind]:.2f}" if known and kind in SIZES[name].limit else "-"


def _count(flags: Any) -> str:
    rate = Rate.count(flags)
    return f"{rate.hits}/{rate.of}" if rate.of else "-"


def answer_in_words(mark: Mark) -> str:
    """What was said, short enough to be counted."""
    verdict, names = mark.said["verdict"], mark.said["names"]
    if verdict == "named":
        return " + ".join(names)
    if verdict == "ambiguous":
        return " or ".join([*names, *mark.said["ambiguous_with"]])
    if verdict in ("unknown", "stochastic"):
        return f"{verdict} ({mark.said['generic']})"
    return f"{verdict} ({' + '.join(names)})" if names else verdict.split(":")[0]


def _confusion(marks: Sequence[Mark]) -> str:
    """Hidden against said, at five times the limit and more."""
    rows = []
    for name in SIZES:
        of = [m for m in marks if m.group == "single" and m.label == name and m.level in ("5x", "10x")]
        rows.append((f"`{name}`", len(of), _answers(of)))
    heading = ("hidden", "runs", "said")
    return "## Confusion, at 5 and 10 times the limit\n\n" + table(heading, rows)


def _answers(marks: Sequence[Mark], most: int = 6) -> str:
    counted = Counter(answer_in_words(mark) for mark in marks).most_common()
    words = [f"{said} {count}" for said, count in counted[:most]]
    rest = sum(count for _, count in counted[most:])
    return "; ".join([*words, *([f"others {rest}"] if rest else [])])


def _clean(marks: Sequence[Mark]) -> str:
    rows = []
    of = [m for m in marks if m.group == "clean"]
    for label, level in dict.fromkeys((m.label, m.level) for m in of):
        mine = [m for m in of if (m.label, m.level) == (label, level)]
        alarms = Rate.count(m.false_alarm for m in mine)
        rows.append(
            (
                f"{label} {level}".strip(),
                alarms,
                _count([bool(m.said["names"]) for m in mine]),
                _answers(mine),
            )
        )
    return "## Clean runs\n\n" + table(("noise", "false alarms", "with a name", "said"), rows)


def _other(marks: Sequence[Mark]) -> str:
    """Everything but single effects and clean runs."""
    rows = []
    of = [m for m in marks if m.group not in ("single", "clean")]
    for group, label in dict.fromkeys((m.group, m.label) for m in of):
        mine = [m for m in of if (m.group, m.label) == (group, label)]
        right = Rate.count(verdicts(mine, group))
        has_part = any(m.block_ok is not None for m in mine)
        block = _count(m.verdict_ok and m.block_ok is True for m in mine) if has_part else "-"
        exact, advice = _count(m.exact for m in mine), _count(map(is_solved, mine))
        said = "" if group in ("pair", "triple") else _answers(mine, 4)
        rows.append((group, label, right, exact, block, advice, said))
    heading = (
        "",
        "hidden",
        "verdict right",
        "exact, alone or with equals",
        "right part of the model",
        "solved by the advised motion",
        "said",
    )
    return "## Everything else\n\n" + table(heading, rows)


def _times(marks: Sequence[Mark]) -> str:
    rows = []
    for tool in dict.fromkeys(mark.tool for mark in marks):
        for kind in ("A", "A'", "C"):
            seconds = [
                m.said["seconds"] for m in marks if m.tool == tool and m.kind.removesuffix("T") == kind
            ]
            if seconds:
                rows.append((tool, kind, f"{np.median(seconds):.2f}", f"{np.max(seconds):.2f}"))
    return "## Times\n\n" + table(("", "data", "median, s", "longest, s"), rows)


def record(marks: Sequence[Mark]) -> dict[str, Any]:
    """All cases, for programs; the limits of the tool are in the page."""
    cases = []
    for mark in marks:
        case = asdict(mark)
        case["said"].pop("smallest_visible")
        if case["advised"] is not None:
            case["advised"].pop("smallest_visible")
        cases.append(_finite(case))
    return {
        "schema": "imucal.gap-benchmark/1",
        "gates": [asdict(gate) for gate in gates([m for m in marks if m.tool == TOOL])],
        "cases": cases,
    }


def _finite(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not isfinite(value) else value
