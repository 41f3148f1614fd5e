"""The tables."""

from collections.abc import Sequence
from typing import Any

from accuracy.contaminated import Contamination
from accuracy.gates import Gate


def table(heading: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (heading, rule, *rows)) + "\n"


def gates_table(gates: Sequence[Gate]) -> str:
    return table(
        ("", "aim", "found", ""), [(g.what, g.aim, g.found, "met" if g.met else "**missed**") for g in gates]
    )


def contaminated_section(all_of_them: Sequence[Contamination]) -> str:
    rows = []
    for one in all_of_them:
        worst = one.ratio.max()
        rows.append(
            (
                one.name,
                one.runs,
                len(one.refused),
                f"{one.pooled:.3f} ± {one.pooled_error:.3f}",
                f"{worst:.3f} ± {one.ratio_error:.3f}",
                f"{one.worst_run:.1f}",
                f"{100 * one.recall:.1f} % ({one.named.found}/{one.named.bad})" if one.named.bad else "-",
                f"{100 * one.false:.2f} % ({one.named.false}/{one.named.good})",
            )
        )
    heading = (
        "fault", "runs", "no result", "RMSE / bound", "worst parameter", "worst run", "bad ones named",
        "good ones named",
    )  # fmt: skip
    gates = [gate for one in all_of_them for gate in one.gates()]
    return "\n".join([table(heading, rows), gates_table(gates)])
