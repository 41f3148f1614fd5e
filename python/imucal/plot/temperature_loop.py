"""Plot of the residuals at rest over temperature, separately for heating and cooling."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucal.plot.style import BLUE, GREEN, VERMILION, plotly, styled
from imucal.units import datasheet

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap.temperature_loop import TemperatureLoop

__all__ = ["temperature_loop"]


def temperature_loop(loop: TemperatureLoop) -> Figure:
    """Residuals of each axis of a sensor at rest over temperature, without and with the effects.

    Residuals without the effects have different colours for heating and cooling.

    Raises ImucalError if plotly is not installed.
    """
    _, make_subplots = plotly()
    scale = datasheet("", "rad/s" if loop.sensor == "gyroscope" else "m/s^2")
    heating = loop.direction >= 0.0
    looks = (
        ("without effects, heating", loop.before, heating, VERMILION, "triangle-up"),
        ("without effects, cooling", loop.before, ~heating, BLUE, "triangle-down"),
        ("with effects", loop.after, np.ones_like(heating), GREEN, "circle"),
    )
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for axis in range(3):
        for name, values, own, colour, symbol in looks:
            figure.add_scatter(
                x=loop.degc[own], y=scale.factor * values[own, axis], mode="markers", name=name,
                legendgroup=name, showlegend=axis == 0, marker={"color": colour, "symbol": symbol, "size": 6},
                hovertemplate=f"%{{x:.4g}} °C<br>{name}: %{{y:.3g}}<extra></extra>", row=axis + 1, col=1,
            )  # fmt: skip
        figure.update_yaxes(title_text=f"{'xyz'[axis]}, {scale.unit}", row=axis + 1, col=1)
    figure.update_xaxes(title_text="temperature, °C", row=3, col=1)
    return styled(figure, 640)
