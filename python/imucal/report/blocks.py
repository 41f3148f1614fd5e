"""Parts that several pages have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from imucal import plot
from imucal.plot.sphere import up_at_rests
from imucal.report.page import Shown, Tab
from imucal.report.tables import checks_table, heading, item_list, paragraph, table

if TYPE_CHECKING:
    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.result import CalibrationResult
    from imucal.finding import Finding
    from imucal.limits.judgement import Judgement

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
# Each control recording has three figures; the others are drawn by `imucal.plot.carried_gravity`.
MOST_RECORDINGS = 3


def carried_tab(judged: Evaluation) -> Tab:
    """Figures 2 to 4 of the paper, for each recording."""
    content: list[Shown | str] = [
        paragraph(
            "The gyroscope carries gravity from the first rest of the run to every later one, and its errors "
            "add up, as they do for a user. The upper plot compares that with what the accelerometer "
            "measures at each rest; the lower one shows what is left after calibration."
        )
    ]
    several = len(judged.carried) > 1
    for recording in range(min(len(judged.carried), MOST_RECORDINGS)):
        if several:
            content.append(heading(f"Recording {recording + 1} of {len(judged.carried)}"))
        for axis in AXES:
            figure = plot.carried_gravity(judged, axis, recording)
            caption = (
                f"Gravity along body {axis} at the rests{_thinned(judged.carried[recording]['time_s'])}."
            )
            content.append(Shown(f"carried-{recording}-{axis}", figure, caption))
    return Tab("Carried gravity", tuple(content))


def residuals(result: CalibrationResult | Evaluation, name: str) -> Iterator[Shown]:
    """Residuals of all rests and of all moves."""
    if result.rests:
        yield Shown(
            f"{name}-rests",
            plot.rest_residuals(result),
            "Length of gravity at each rest after calibration, minus local gravity"
            + _thinned(result.rests)
            + _out_of_sight(result.rests),
        )
    if result.moves:
        yield Shown(
            f"{name}-moves",
            plot.move_residuals(result),
            "Angle between gravity as the gyroscope carries it over a move and as it is measured after it"
            + _thinned(result.moves)
            + _out_of_sight(result.moves),
        )


def coverage_tab(result: CalibrationResult | Evaluation) -> Tab:
    """The sphere, and the same in numbers for where it cannot be turned."""
    up = up_at_rests(result)
    nearest = abs(up).argmax(axis=1)
    rows = []
    for index, axis in enumerate(AXES):
        signs = up[nearest == index, index]
        rows.append([axis, str(int((signs > 0).sum())), str(int((signs < 0).sum()))])
    return Tab(
        "Coverage",
        (
            Shown(
                "coverage",
                plot.coverage(result),
                "Which way was up at each rest, in the body frame: turn the ball. Poses far from all points "
                f"are not covered.{f' {plot.MOST} rests are drawn.' if len(up) > plot.MOST else ''}",
            ),
            heading("Rests by the body axis nearest to the vertical"),
            table(["axis", "up", "down"], rows),
        ),
    )


def limits_tabs(judgement: Judgement | None) -> tuple[Tab, ...]:
    """The checks against limits, drawn and as a table; no tab without any."""
    if judgement is None:
        return ()
    content = (
        Shown(
            "limits",
            plot.limits(judgement),
            "Each value in its range, with a bar of 1 σ: −1 and 1 are the ends of the range, a largest value "
            "ends at 1.",
        ),
        checks_table(judgement),
        *([heading("Near a limit"), item_list(judgement.warnings)] if judgement.warnings else ()),
    )
    return (Tab("Limits", content),)


def finding_texts(findings: Sequence[Finding]) -> list[str]:
    """One sentence for each finding."""
    return [finding.line for finding in findings]


def _out_of_sight(items: Sequence[Mapping[str, Any]]) -> str:
    if all(item["excluded"] is None for item in items):
        return "."
    return ". The axis is that of what is used: a double click shows what was left out, too."


def _thinned(items: Sequence[object]) -> str:
    return (
        "" if len(items) <= plot.MOST else f" ({plot.MOST} of {len(items)} are drawn, the worst among them)"
    )
