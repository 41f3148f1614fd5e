"""Plot of a temperature soak: mean readings over temperature with the model, or residuals over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from imucal.plot.style import BLUE, VERMILION, plotly, styled
from imucal.units import datasheet

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap.soak_result import Soak, SoakedSensor

__all__ = ["soak"]


def soak(found: Soak, sensor: SoakedSensor, over: Literal["temperature", "time"] = "temperature") -> Figure:
    """Mean reading of each epoch (interval) over temperature with the model, or residuals over time, by axis.

    A loop over temperature indicates a lag or hysteresis. Over time, the residuals of a cubic in the
    temperature are drawn for comparison.

    Raises ImucalError if plotly is not installed.
    """
    _, make_subplots = plotly()
    if over == "temperature":
        x, title = found.temperature_degc, "temperature, °C"
        lines = {
            "measured": (sensor.mean - sensor.constant, BLUE, "markers", "solid"),
            "model": (sensor.fitted - sensor.constant, VERMILION, "lines", "solid"),
        }
    else:
        x, title = found.time_s, "time, s"
        lines = {
            "one cubic": (sensor.mean - sensor.cubic, BLUE, "lines", "dot"),
            "model": (sensor.mean - sensor.fitted, VERMILION, "lines", "solid"),
        }
    scale = datasheet("", sensor.unit)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for axis in range(3):
        for name, (values, colour, mode, dash) in lines.items():
            figure.add_scatter(
                x=x, y=scale.factor * values[:, axis], mode=mode, name=name, legendgroup=name,
                showlegend=axis == 0, line={"color": colour, "width": 1.5, "dash": dash},
                marker={"color": colour, "size": 5}, row=axis + 1, col=1,
            )  # fmt: skip
        figure.update_yaxes(title_text=f"{'xyz'[axis]}, {scale.unit}", row=axis + 1, col=1)
    figure.update_xaxes(title_text=title, row=3, col=1)
    return styled(figure, 640)
