"""Plots of a fleet: yield over time, and the distribution of a parameter over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.plot.style import BLUE, GREEN, GREY, VERMILION, plotly, shown_unit, styled

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.arrays import FloatArray

__all__ = ["MOST_BINS", "over_time", "yield_over_time"]

# Maximum number of time bins, so that the size of a figure does not grow with the number of units.
MOST_BINS: Final = 60
SERIES: Final = (("good", GREEN, "circle"), ("incomplete", BLUE, "square"), ("poor", VERMILION, "diamond"))
STATIONS: Final = ((BLUE, "circle"), (VERMILION, "square"), (GREEN, "diamond"), (GREY, "x"))


def yield_over_time(days: Sequence[str], counts: Mapping[str, Sequence[int]]) -> Figure:
    """Number of units by verdict and day, or by bins of several days.

    days     first day of each bin
    counts   for each verdict (good, incomplete, poor, no_result), the number of units in each bin
    """
    go, _ = plotly()
    figure = go.Figure()
    for name, colour in (*((name, colour) for name, colour, _ in SERIES), ("no_result", GREY)):
        if any(counts.get(name, ())):
            figure.add_bar(x=list(days), y=list(counts[name]), name=name, marker={"color": colour})
    figure.update_layout(barmode="stack")
    figure.update_yaxes(title_text="units")
    return styled(figure, 300)


def over_time(
    times: Sequence[str],
    quantiles: Mapping[str, FloatArray],
    centre: float,
    limits: tuple[float | None, float | None],
    unit: str,
) -> Figure:
    """Median of a parameter over time for each station, with the range of the middle 90 % of the units.

    times       first day of each bin
    quantiles   5 %, 50 % and 95 % quantiles by station, (bins, 3); NaN if a bin has no unit
    centre      mean over all units
    limits      minimum and maximum; None for a side without a limit
    """
    go, _ = plotly()
    figure = go.Figure()
    for k, (station, values) in enumerate(quantiles.items()):
        colour, symbol = STATIONS[k % len(STATIONS)]
        known = np.isfinite(values[:, 1])
        low, median, high = (_rounded(values[known, column]) for column in range(3))
        figure.add_scatter(
            x=[time for time, is_known in zip(times, known, strict=True) if is_known],
            y=median,
            error_y={
                "type": "data",
                "symmetric": False,
                "array": [a - b for a, b in zip(high, median, strict=True)],
                "arrayminus": [a - b for a, b in zip(median, low, strict=True)],
                "thickness": 1,
                "width": 0,
            },
            name=station or "no station",
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 6},
        )
    figure.add_hline(y=centre, line={"color": GREY, "width": 1})
    for limit in limits:
        if limit is not None:
            figure.add_hline(y=limit, line={"color": VERMILION, "width": 1, "dash": "dash"})
    figure.update_yaxes(title_text=shown_unit(unit))
    return styled(figure, 260)


def _rounded(values: FloatArray) -> list[float]:
    """Values rounded to five significant digits, which is finer than the resolution of a screen."""
    return [float(f"{value:.5g}") for value in values.tolist()]
