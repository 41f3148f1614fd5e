"""The parameters of a calibration, how well they are known, and where they are between their limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from imucal.plot.style import BAND, BLUE, GREEN, GREY, VERMILION, plotly, rows_of, shown_unit, styled

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.calibration.calibration import Calibration, Parameter
    from imucal.estimation.result import CalibrationResult
    from imucal.limits.judgement import Check, Judgement

__all__ = ["limits", "parameters", "sigmas"]

SENSORS: Final = {"accel": "Accelerometer", "gyro": "Gyroscope"}
ROW_PX: Final = 24
CHECK_PX: Final = 29
PANEL_PX: Final = 62
MARGIN_PX: Final = 40
# Farther from its limit than this a value is drawn at the edge.
EDGE: Final = 1.5


def parameters(result: CalibrationResult | Calibration) -> Figure:
    """Every parameter with a bar of 1 sigma to both sides; kinds of different units have their own panels.

    Raises ImucalError without plotly.
    """

    def trace(go: Any, panel: list[Parameter]) -> Any:
        return go.Scatter(
            x=[p.value for p in panel],
            y=[p.name for p in panel],
            error_x={"type": "data", "array": [p.std or 0.0 for p in panel], "color": BLUE, "thickness": 1.5},
            mode="markers",
            marker={"color": BLUE, "symbol": "circle", "size": 7},
            text=[_words(p) for p in panel],
            hovertemplate="%{text}<extra></extra>",
        )

    return _panels(result, trace)


def sigmas(result: CalibrationResult | Calibration) -> Figure:
    """Bars of 1 sigma of every parameter; kinds of different units have their own panels.

    Raises ImucalError without plotly.
    """

    def trace(go: Any, panel: list[Parameter]) -> Any:
        return go.Bar(
            x=[p.std for p in panel],
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
    """Every check against its limits, with bars of 1 sigma: -1 and 1 are the ends of a range.

    A largest value ends at 1, a least one that is kept is at 0. What is farther out than 1.5, or has no
    value, is drawn at the edge. Raises ImucalError without plotly.
    """
    go, _ = plotly()
    checks = judgement.checks
    figure = go.Figure()
    figure.add_vrect(x0=-1, x1=1, fillcolor=BAND, line={"color": GREY, "width": 1}, layer="below")
    looks = (("kept", True, GREEN, "circle", 9), ("not kept", False, VERMILION, "x", 11))
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
        # The figures of a set have long names, and a phone is narrow.
        ticktext=[what.replace("_set ", "_set<br>") for what in order],
        tickfont={"size": 11},
    )
    figure.update_xaxes(range=[-EDGE - 0.1, EDGE + 0.1], tickvals=[-1, 0, 1], title_text="share of the limit")
    return styled(figure, 2 * MARGIN_PX + 20 + CHECK_PX * max(len(order), 2))


def _panels(result: CalibrationResult | Calibration, trace: Callable[[Any, list[Parameter]], Any]) -> Figure:
    """One panel below the other, one for each kind of parameter."""
    from imucal.calibration.calibration import Calibration

    calibration = result if isinstance(result, Calibration) else result.calibration
    kinds: dict[str, list[Parameter]] = {}
    for parameter in calibration.parameters:
        kinds.setdefault(_kind(parameter, calibration), []).append(parameter)
    go, make_subplots = plotly()
    rows = [len(panel) for panel in kinds.values()]
    height = sum(rows) * ROW_PX + len(rows) * PANEL_PX
    figure = make_subplots(
        rows=len(rows),
        row_heights=rows,
        # Titles and tick labels stand between the panels.
        vertical_spacing=PANEL_PX / height if len(rows) > 1 else 0.0,
        subplot_titles=list(kinds),
    )
    for row, panel in enumerate(kinds.values(), start=1):
        figure.add_trace(trace(go, panel), row=row, col=1)
        figure.update_yaxes(rows_of([p.name for p in panel]), row=row, col=1)
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    figure.update_layout(showlegend=False)
    return styled(figure, height + 2 * MARGIN_PX)


def _kind(parameter: Parameter, calibration: Calibration) -> str:
    """Parameters of one kind share an axis."""
    sensor, _, rest = parameter.name.partition("_")
    unit = f", {shown_unit(parameter.unit)}".removesuffix(", ")
    effect = next((e.name for e in calibration.effects if parameter.name.startswith(f"{e.name}_")), None)
    if effect is not None:
        return f"{effect}{unit}"
    if rest.startswith("bias"):
        return f"{SENSORS[sensor]} bias{unit}"
    what = "scale" if rest[-1] == rest[-2] else "misalignment"
    return f"{SENSORS[sensor]} {what}{unit}"


def _words(p: Parameter) -> str:
    unit = shown_unit(p.unit)
    spread = "1 σ not known" if p.std is None else f"1 σ {p.std:.3g} {unit}"
    return f"{p.name}<br>{p.value:.7g} {unit}<br>{spread}"


def _position(check: Check) -> float:
    """The share of the limit that is used, negative in the lower half of a range."""
    if check.value is not None and check.low is not None and check.high is not None:
        return check.used if 2 * check.value >= check.low + check.high else -check.used
    return check.used


def _spread(check: Check) -> float:
    """1 sigma in the same share."""
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
