"""Plots of the effects that a search has found: closed share of the gap, size, and rivals.

The gap is the part of the residuals that exceeds their noise. An effect closes the share of the gap by which
it reduces the residuals. Rivals are effects that explain the residuals about as well.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from imucal.errors import InputError
from imucal.gap.sizes import for_people
from imucal.plot.style import (
    BLUE,
    GREEN,
    GREY,
    PAPER,
    VERMILION,
    plotly,
    rows_of,
    shown_unit,
    stacked_panels,
    styled,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap import Gap

__all__ = ["candidate_probabilities", "effect_sizes", "probabilities", "waterfall", "waterfall_steps"]

KINDS: Final = {
    "rest_norm": "|f| − g at rest",
    "move_direction": "gravity direction after moves",
    "rest_rate": "rate at rest",
}
# Heights, in pixels, of the row of a share, of the row of a parameter, and of a panel's title with labels.
ROW_PX: Final = 34
SIZE_ROW_PX: Final = 24
PANEL_PX: Final = 66
# A candidate is drawn if its probability is at least LEAST. At most MOST candidates are drawn.
LEAST: Final = 1e-3
MOST: Final = 6
# Half width of a 95 % interval, in standard deviations.
INTERVAL_95: Final = 1.96


def waterfall_steps(gap: Gap) -> dict[str, list[tuple[str, float]]]:
    """Share of the gap that each effect and law closes, and the remaining share, by kind of residual.

    Shares are computed from control or held-out residuals. Kinds without a gap are omitted.
    """
    closers = [(str(e["name"]), e.get("closed") or {}) for e in gap.effects]
    closers += [(law.name, law.closed) for law in gap.laws]
    steps = {}
    for kind in KINDS:
        own = [(name, float(closed[kind])) for name, closed in closers if closed.get(kind) is not None]
        if own:
            steps[kind] = [*own, ("left", 1.0 - sum(share for _, share in own))]
    return steps


def waterfall(gap: Gap) -> Figure:
    """Waterfall chart for each kind of residual: the share of its gap that each effect closes.

    Raises InputError if no effect closes a gap, ImucalError if plotly is not installed.
    """
    steps = waterfall_steps(gap)
    if not steps:
        raise InputError("no effect closes a part of the gap")
    go, _ = plotly()
    rows = {KINDS[kind]: len(own) + 1 for kind, own in steps.items()}
    figure, height = stacked_panels(rows, row_px=ROW_PX, panel_px=PANEL_PX)
    for row, own in enumerate(steps.values(), start=1):
        names = ["gap", *(name for name, _ in own)]
        # The remaining share is clipped at zero, because the scatter of control or held-out data may make it
        # slightly negative.
        left = max(own[-1][1], 0.0)
        text = ["100 %", *(f"−{100 * share:.0f} %" for _, share in own[:-1]), f"{100 * left:.0f} %"]
        figure.add_trace(
            go.Waterfall(
                orientation="h",
                y=names,
                x=[100.0, *(-100.0 * share for _, share in own[:-1]), 100.0 * left],
                measure=["absolute", *["relative"] * (len(own) - 1), "total"],
                text=text,
                textposition="none",
                increasing={"marker": {"color": VERMILION}},
                decreasing={"marker": {"color": GREEN}},
                totals={"marker": {"color": BLUE}},
                connector={"line": {"color": GREY, "width": 1}},
                hovertemplate="%{y}: %{text}<extra></extra>",
            ),
            row=row,
            col=1,
        )
        # The shares are written in the labels, because a short bar has no room for text.
        labels = [f"{name}<br>{share}" for name, share in zip(names, text, strict=True)]
        figure.update_yaxes(rows_of(names), ticktext=labels, row=row, col=1)
    figure.update_xaxes(rangemode="tozero", ticksuffix=" %")
    return styled(figure, height + 60)


def effect_sizes(gap: Gap) -> Figure:
    """Every parameter of the found effects with its 68 % and 95 % interval. Zero means no effect.

    The intervals are computed from the covariance of the fit, for a quadratic log-likelihood. Raises
    InputError without effects, ImucalError if plotly is not installed.
    """
    groups: dict[str, list[tuple[str, float, float]]] = {}
    for effect in gap.effects:
        for p in effect["parameters"]:
            value, unit = for_people(p["value"], p["unit"])
            std = abs(for_people(p["std"] or 0.0, p["unit"])[0])
            title = f"{effect['name']}, {shown_unit(unit)}".removesuffix(", ")
            groups.setdefault(title, []).append((p["name"], value, std))
    if not groups:
        raise InputError("there is no effect to show")
    rows = {title: len(own) for title, own in groups.items()}
    figure, height = stacked_panels(rows, row_px=SIZE_ROW_PX, panel_px=PANEL_PX)
    for row, own in enumerate(groups.values(), start=1):
        names = [name for name, _, _ in own]
        for factor, thickness in ((INTERVAL_95, 1.2), (1.0, 4.0)):
            figure.add_scatter(
                x=[value for _, value, _ in own],
                y=names,
                error_x={
                    "type": "data",
                    "array": [factor * std for _, _, std in own],
                    "color": BLUE,
                    "thickness": thickness,
                    "width": 0,
                },
                mode="markers",
                marker={"color": BLUE, "symbol": "circle", "size": 7},
                text=[f"{name}<br>{value:.4g} ± {std:.2g}" for name, value, std in own],
                hovertemplate="%{text}<extra></extra>",
                row=row,
                col=1,
            )
        figure.add_vline(x=0, line={"color": GREY, "width": 1, "dash": "dash"}, row=row, col=1)
        figure.update_yaxes(rows_of(names), row=row, col=1)
    return styled(figure, height + 50)


def candidate_probabilities(gap: Gap) -> dict[str, float]:
    """Probability of each candidate, and of no effect, under equal prior probabilities."""
    nats = {"no effect": 0.0, **{str(s["name"]): float(s["log_bayes_factor"]) for s in gap.ranking}}
    largest = max(nats.values())
    weights = {name: math.exp(value - largest) for name, value in nats.items()}
    total = sum(weights.values())
    return {name: weight / total for name, weight in sorted(weights.items(), key=lambda item: -item[1])}


def probabilities(gap: Gap) -> Figure:
    """Probabilities of the candidates under equal prior probabilities. Candidates below 0.1 % are omitted.

    Raises InputError without a ranking, ImucalError if plotly is not installed.
    """
    if not gap.ranking:
        raise InputError("there is no ranking: the search ended before candidates were scored")
    go, _ = plotly()
    every = candidate_probabilities(gap)
    shown = [name for name, share in every.items() if share >= LEAST][:MOST]
    added = {str(effect["name"]) for effect in gap.effects}
    figure = go.Figure()
    figure.add_bar(
        x=[100 * every[name] for name in shown],
        y=shown,
        orientation="h",
        width=0.6,
        marker={"color": [BLUE if name in added else GREY for name in shown]},
        text=[f"{100 * every[name]:.3g} %" for name in shown],
        textposition="auto",
        # In the light and the dark theme, text in the background colour of the page is legible on the bars.
        insidetextfont={"color": PAPER},
        hovertemplate="%{y}: %{text}<extra></extra>",
    )
    figure.update_yaxes(rows_of(shown))
    figure.update_xaxes(range=[0, 105], title_text="probability, %")
    return styled(figure, 100 + ROW_PX * max(len(shown), 2))
