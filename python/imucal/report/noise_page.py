"""The page of a unit's noise: Allan plots and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.report.figures import BLUE, GREEN, VERMILION, plotly, styled
from imucal.report.page import Section, write_page
from imucal.report.tables import rounded_to, table

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.noise import NoiseFigure, NoiseResult

TRIADS = {"accel": "Accelerometer", "gyro": "Gyroscope"}
LOOKS = (("x", VERMILION, "circle"), ("y", GREEN, "square"), ("z", BLUE, "diamond"))
SHOWN = ("noise_density", "bias_instability", "random_walk", "quantisation")


def allan_figure(noise: NoiseResult, sensor: str) -> Figure:
    """Allan deviation over averaging time of the three axes of "accel" or "gyro".

    Points with their 95 % bands are the recording's, lines are the identified noise.

    Raises:
        ImucalError: plotly is not installed.
    """
    go, _ = plotly()
    figure = go.Figure()
    unit = noise.accel_unit if sensor == "accel" else noise.gyro_unit
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
    # The bands of the longest times reach far up; the points are what is looked at.
    everything = np.concatenate([axis.deviations for axis in noise.triad(sensor)])
    positive = everything[everything > 0]
    axis_style: dict[str, Any] = {"type": "log", "exponentformat": "power", "dtick": 1}
    figure.update_xaxes(title_text="averaging time, s", **axis_style)
    figure.update_yaxes(title_text=f"Allan deviation, {unit.replace('^2', '²')}", **axis_style)
    if positive.size:
        low, high = np.log10(positive.min()), np.log10(positive.max())
        figure.update_yaxes(range=[low - 0.5, high + 0.5])
    return styled(figure)


def write_noise_page(path: str | Path, noise: NoiseResult) -> None:
    """Write the page of one recording's noise.

    Args:
        path: The HTML file.
        noise: What `imucal.noise` found.

    Raises:
        ImucalError: plotly is not installed, or the file cannot be written.
    """
    rows = [
        [f"{name} {figure.replace('_', ' ')}", *_cells(getattr(axis, figure))]
        for name, axis in noise.axes.items()
        for figure in SHOWN
        if figure != "quantisation" or axis.quantisation.value is not None
    ]
    sections = [
        Section(
            name,
            figures=(
                (
                    allan_figure(noise, sensor),
                    "Overlapping Allan deviation with 95 % bands; lines: the identified noise.",
                ),
            ),
        )
        for sensor, name in TRIADS.items()
    ]
    figures = Section(
        "Figures",
        text="A kind of noise that the recording does not show has no value: the band ends where the "
        "recording excludes it. The Allan deviation of a bias instability is flat at 0.664 of it.",
        tables=(table(["", "value", "1 σ", "95 % from", "to", "unit"], rows),),
    )
    remarks = " ".join(str(finding) for finding in noise.findings)
    write_page(path, f"Noise of {noise.name}", [*sections, figures], verdict=noise.heading(), beside=remarks)


def _cells(figure: NoiseFigure) -> list[str]:
    unit = figure.unit.replace("^2", "²")
    band = [f"{figure.low:.3g}", f"{figure.high:.3g}", unit]
    if figure.value is None or figure.std is None:
        return ["not seen", "-", *band]
    return [rounded_to(figure.value, figure.std), f"{figure.std:.2g}", *band]
