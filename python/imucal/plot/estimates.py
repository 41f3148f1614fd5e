"""Plots of the parameters of a calibration, their standard deviations, and their limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from imucal.effects.table import has_parameter
from imucal.plot.style import (
    BAND,
    BLUE,
    GREEN,
    GREY,
    VERMILION,
    plotly,
    rows_of,
    shown_unit,
    stacked_panels,
    styled,
)
from imucal.units import Scale, datasheet

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.calibration.calibration import Calibration
    from imucal.calibration.triad import Parameter
    from imucal.estimation.result import CalibrationResult
    from imucal.limits.judgement import Check, Judgement

__all__ = ["limits", "parameters", "sigmas"]

# Heights, in pixels, of the row of a parameter, the row of a check, the title and labels of a panel, and the
# margin of the figure.
ROW_PX: Final = 24
CHECK_PX: Final = 29
PANEL_PX: Final = 62
MARGIN_PX: Final = 40
# A check compares a value with its limit. A value beyond this multiple of its limit is drawn at this
# multiple.
EDGE: Final = 1.5


def parameters(result: CalibrationResult | Calibration) -> Figure:
    """Every parameter with an error bar of +-1 sigma; parameters with different units are in separate panels.

    Raises ImucalError if plotly is not installed.
    """

    def trace(go: Any, panel: list[Parameter]) -> Any:
        return go.Scatter(
            x=[_scale(p).shown(p.value) for p in panel],
            y=[p.name for p in panel],
            error_x={
                "type": "data",
                "array": [_std(p) or 0.0 for p in panel],
                "color": BLUE,
                "thickness": 1.5,
            },
            mode="markers",
            marker={"color": BLUE, "symbol": "circle", "size": 7},
            text=[_words(p) for p in panel],
            hovertemplate="%{text}<extra></extra>",
        )

    return _panels(result, trace)


def sigmas(result: CalibrationResult | Calibration) -> Figure:
    """The standard deviation of every parameter; parameters with different units are in separate panels.

    Raises ImucalError if plotly is not installed.
    """

    def trace(go: Any, panel: list[Parameter]) -> Any:
        return go.Bar(
            x=[_std(p) for p in panel],
            y=[p.name for p in panel],
            orientation="h",
            marker={"color": BLUE},
            width=0.6,
            text=[_words(p) for p in panel],
            textposition="none",
            hovertemplate="%{text}<extra></extra>",
        )

    return _panels(result, trace)


def limits(judgement: Judgement) -> Figure:
    """Every checked value relative to its limits, with error bars of +-1 sigma; -1 to 1 is allowed.

    A one-sided maximum is at 1, and a value that satisfies a one-sided minimum is drawn at 0. Values beyond
    1.5 and missing values are drawn at the edge. Raises ImucalError if plotly is not installed.
    """
    go, _ = plotly()
    checks = judgement.checks
    figure = go.Figure()
    figure.add_vrect(x0=-1, x1=1, fillcolor=BAND, line={"color": GREY, "width": 1}, layer="below")
    looks = (("passed", True, GREEN, "circle", 9), ("failed", False, VERMILION, "x", 11))
    for name, passed, colour, symbol, size in looks:
        own = [check for check in checks if check.passed == passed]
        if not own:
            continue
        figure.add_scatter(
            x=[max(-EDGE, min(EDGE, _position(check))) for check in own],
            y=[check.what for check in own],
            error_x={"type": "data", "array": [_spread(check) for check in own], "thickness": 1.5},
            name=name,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": size},
            text=[_checked(check) for check in own],
            hovertemplate="%{text}<extra></extra>",
        )
    order = list(dict.fromkeys(check.what for check in checks))
    figure.update_yaxes(
        rows_of(order),
        tickvals=order,
        # Long names of figures of merit are broken into two lines, so that they fit on the screen of a phone.
        ticktext=[what.replace("_set ", "_set<br>") for what in order],
        tickfont={"size": 11},
    )
    figure.update_xaxes(range=[-EDGE - 0.1, EDGE + 0.1], tickvals=[-1, 0, 1], title_text="share of the limit")
    return styled(figure, 2 * MARGIN_PX + 20 + CHECK_PX * max(len(order), 2))


def _panels(result: CalibrationResult | Calibration, trace: Callable[[Any, list[Parameter]], Any]) -> Figure:
    """A figure with one panel for each kind of parameter; `trace` draws the parameters of a panel."""
    from imucal.calibration.calibration import Calibration

    calibration = result if isinstance(result, Calibration) else result.calibration
    kinds: dict[str, list[Parameter]] = {}
    for parameter in calibration.parameters:
        kinds.setdefault(_kind(parameter, calibration), []).append(parameter)
    go, _ = plotly()
    rows = {title: len(panel) for title, panel in kinds.items()}
    figure, height = stacked_panels(rows, row_px=ROW_PX, panel_px=PANEL_PX)
    for row, panel in enumerate(kinds.values(), start=1):
        figure.add_trace(trace(go, panel), row=row, col=1)
        figure.update_yaxes(rows_of([p.name for p in panel]), row=row, col=1)
    figure.update_xaxes(nticks=4, tickangle=0, tickfont={"size": 11})
    return styled(figure, height + 2 * MARGIN_PX)


def _kind(parameter: Parameter, calibration: Calibration) -> str:
    """Title of the panel of a parameter; parameters with the same title share an axis."""
    sensor, _, rest = parameter.name.partition("_")
    unit = f", {shown_unit(_scale(parameter).unit)}".removesuffix(", ")
    effect = next((e.name for e in calibration.effects if has_parameter(e.name, parameter.name)), None)
    if effect is not None:
        return f"{effect}{unit}"
    if rest.startswith("bias"):
        return f"{sensor} bias{unit}"
    on_diagonal = "scale error" if _scale(parameter).zero else "scale"
    what = on_diagonal if rest[-1] == rest[-2] else "misalignment"
    return f"{sensor} {what}{unit}"


def _scale(parameter: Parameter) -> Scale:
    """The unit in which datasheets give a parameter, with the conversion to it."""
    return datasheet(parameter.name, parameter.unit)


def _std(parameter: Parameter) -> float | None:
    return None if parameter.std is None else abs(_scale(parameter).factor) * parameter.std


def _words(p: Parameter) -> str:
    scale, std = _scale(p), _std(p)
    unit = shown_unit(scale.unit)
    spread = "1 σ unknown" if std is None else f"1 σ {std:.3g} {unit}"
    return f"{p.name}<br>{scale.shown(p.value):.7g} {unit}<br>{spread}"


def _position(check: Check) -> float:
    """Position of a check on the axis: the used share of the permitted deviation (`Check.used`).

    The position is negative for a value in the lower half of its permitted range.
    """
    if check.value is not None and check.low is not None and check.high is not None:
        return check.used if 2 * check.value >= check.low + check.high else -check.used
    return check.used


def _spread(check: Check) -> float:
    """The standard deviation of a checked value, divided by half the width of its permitted range."""
    if not check.std or check.low is None or check.high is None:
        return 0.0
    return 2 * check.std / (check.high - check.low)


def _checked(check: Check) -> str:
    unit = shown_unit(check.unit)
    lines = [check.what, f"{check.value_text} {unit}", f"limit: {check.limit_text} {unit}"]
    if check.std:
        lines.insert(2, f"1 σ {check.std:.3g} {unit}")
    lines += [text for text in (check.problem, check.warning) if text]
    return "<br>".join(lines)
