"""Tabs and figures that several report pages share, such as the residuals and the coverage of poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Sized
from typing import TYPE_CHECKING, Literal

import imucal.plot as plot
from imucal.plot.sphere import up_at_rests
from imucal.report.page import Shown, Tab
from imucal.report.tables import checks_table, heading, item_list, paragraph, table

if TYPE_CHECKING:
    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.rests import Move, Rest
    from imucal.estimation.result import CalibrationResult
    from imucal.finding import Finding
    from imucal.limits.judgement import Judgement

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
# Maximum number of control recordings with plots on a page (three plots each). For further recordings,
# `imucal.plot.propagated_gravity` draws these plots.
MOST_RECORDINGS = 3


def propagated_tab(judged: Evaluation) -> Tab:
    """Tab with the plots of propagated gravity for each control recording.

    The plots are those of figures 2 to 4 of the paper that docs/model.md cites.
    """
    content: list[Shown | str] = [
        paragraph(
            "The gyroscope propagates gravity from the first rest of the run to every later rest, so its "
            "errors accumulate as in navigation. The upper plot compares propagated gravity with the "
            "accelerometer's measurement at each rest; the lower plot shows the difference after calibration."
        )
    ]
    several = len(judged.carried) > 1
    for recording in range(min(len(judged.carried), MOST_RECORDINGS)):
        if several:
            content.append(heading(f"Recording {recording + 1} of {len(judged.carried)}"))
        for axis in AXES:
            figure = plot.propagated_gravity(judged, axis, recording)
            caption = f"Gravity along body {axis} at the rests{_thinned(judged.carried[recording].time_s)}."
            content.append(Shown(f"carried-{recording}-{axis}", figure, caption))
    return Tab("Propagated gravity", tuple(content))


def residuals(result: CalibrationResult | Evaluation, name: str) -> Iterator[Shown]:
    """Plots of the residuals of all rests and of all moves; `name` begins their identifiers in the page."""
    if result.rests:
        yield Shown(
            f"{name}-rests",
            plot.rest_residuals(result),
            "Norm of specific force at each rest after calibration, minus local gravity"
            + _thinned(result.rests)
            + _out_of_sight(result.rests),
        )
    if result.moves:
        yield Shown(
            f"{name}-moves",
            plot.move_residuals(result),
            "Angle between gravity propagated by the gyroscope over a move and gravity measured after it"
            + _thinned(result.moves)
            + _out_of_sight(result.moves),
        )


def coverage_tab(result: CalibrationResult | Evaluation) -> Tab:
    """Tab with the sphere of poses, and a table of the poses for readers without the interactive figure."""
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
                "Up direction at each rest, in the body frame (drag to rotate). Regions without points are "
                "poses that were not "
                f"recorded.{f' {plot.MOST} rests are drawn.' if len(up) > plot.MOST else ''}",
                printed=False,
            ),
            heading("Rests by the body axis closest to the vertical"),
            table(["axis", "up", "down"], rows),
        ),
    )


def limits_tabs(judgement: Judgement | None) -> tuple[Tab, ...]:
    """Tab with the checks against limits as a plot and a table; empty if there are no limits."""
    if judgement is None:
        return ()
    content = (
        Shown(
            "limits",
            plot.limits(judgement),
            "Each value relative to its limits, with an error bar of ±1 σ: the allowed range is −1 to 1. If "
            "a value has only a maximum, the maximum is at 1.",
        ),
        checks_table(judgement),
        *([heading("Close to a limit"), item_list(judgement.warnings)] if judgement.warnings else ()),
    )
    return (Tab("Limits", content),)


def finding_texts(findings: Sequence[Finding]) -> list[str]:
    """One line of text for each finding."""
    return [finding.line for finding in findings]


def _out_of_sight(items: Sequence[Rest] | Sequence[Move]) -> str:
    if all(item.excluded is None for item in items):
        return "."
    return ". The axis range fits the used values: a double click also shows the excluded ones."


def _thinned(items: Sized) -> str:
    return "" if len(items) <= plot.MOST else f" ({plot.MOST} of {len(items)} are drawn, including the worst)"
