"""Plots of the Allan deviation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from imucal.plot.style import BLUE, GREEN, VERMILION, plotly, shown_unit, styled

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["allan"]

LOOKS = (("x", VERMILION, "circle"), ("y", GREEN, "square"), ("z", BLUE, "diamond"))


def allan(noise: NoiseResult, sensor: Literal["accel", "gyro"]) -> Figure:
    """Allan deviation over averaging time for the three axes of a sensor.

    Points with 95 % confidence intervals are measured, lines are the identified noise model.

    Raises ImucalError without plotly, and InputError for a sensor that the recording does not have.
    """
    go, _ = plotly()
    figure = go.Figure()
    unit = shown_unit((noise.accel_unit if sensor == "accel" else noise.gyro_unit) or "")
    for (axis, colour, symbol), of_axis in zip(LOOKS, noise.triad(sensor), strict=True):
        error = {
            "type": "data",
            "symmetric": False,
            "array": of_axis.high - of_axis.deviations,
            "arrayminus": of_axis.deviations - of_axis.low,
            "thickness": 1,
            "width": 2,
        }
        figure.add_scatter(
            x=of_axis.taus_s,
            y=of_axis.deviations,
            error_y=error,
            name=axis,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 6},
            hovertemplate=f"%{{x:.4g}} s<br>{axis}: %{{y:.4g}} {unit}<extra></extra>",
        )
        line = {"color": colour, "width": 1}
        figure.add_scatter(
            x=of_axis.taus_s, y=of_axis.model, mode="lines", line=line, showlegend=False, hoverinfo="skip"
        )
    # The range of the axis is set by the points, because the intervals at the longest times are very wide.
    everything = np.concatenate([axis.deviations for axis in noise.triad(sensor)])
    positive = everything[everything > 0]
    axis_style: dict[str, Any] = {"type": "log", "dtick": 1}
    figure.update_xaxes(title_text="averaging time, s", **axis_style)
    figure.update_yaxes(title_text=f"Allan deviation, {unit}", **axis_style)
    if positive.size:
        low, high = np.log10(positive.min()), np.log10(positive.max())
        figure.update_yaxes(range=[low - 0.5, high + 0.5])
    return styled(figure, 420)
