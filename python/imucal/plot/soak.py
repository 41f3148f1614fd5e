"""Plots of a soak: reading over temperature with the model, and the residuals in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucal.plot.style import BLUE, VERMILION, plotly, shown_unit, styled

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap.soak import Soak, SoakedSensor

__all__ = ["soak_law", "soak_residuals"]


def soak_law(found: Soak, sensor: SoakedSensor) -> Figure:
    """Mean reading of each epoch over temperature, with the model; loops are lag or hysteresis.

    Raises ImucalError without plotly.
    """
    return _panels(
        found.temperature_degc,
        sensor,
        {
            "measured": (sensor.mean - sensor.constant, BLUE, "markers"),
            "model": (sensor.fitted - sensor.constant, VERMILION, "lines"),
        },
        "temperature, °C",
    )


def soak_residuals(found: Soak, sensor: SoakedSensor) -> Figure:
    """Residuals of one cubic in the temperature and of the model over time.

    Raises ImucalError without plotly.
    """
    return _panels(
        found.time_s,
        sensor,
        {
            "one cubic": (sensor.mean - sensor.cubic, BLUE, "lines"),
            "model": (sensor.mean - sensor.fitted, VERMILION, "lines"),
        },
        "time, s",
    )


def _panels(x, sensor, lines, title) -> Figure:  # type: ignore[no-untyped-def]
    _, make_subplots = plotly()
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for axis in range(3):
        for name, (values, colour, mode) in lines.items():
            style = {"marker": {"color": colour, "size": 5}} if mode == "markers" else {}
            figure.add_scatter(
                x=x, y=values[:, axis], mode=mode, name=name, legendgroup=name, showlegend=axis == 0,
                line={"color": colour, "width": 1.5}, row=axis + 1, col=1, **style,
            )  # fmt: skip
        figure.update_yaxes(title_text=f"{'xyz'[axis]}, {shown_unit(sensor.unit)}", row=axis + 1, col=1)
    figure.update_xaxes(title_text=title, row=3, col=1)
    return styled(figure, 640)
