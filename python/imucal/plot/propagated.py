"""Gravity propagated by the gyroscope through a run: figures 2 to 4 of the paper cited in docs/model.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from imucal.errors import InputError
from imucal.plot.style import BLUE, GREEN, VERMILION, plotly, styled
from imucal.plot.thinning import thinned

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.estimation.evaluate import Evaluation

__all__ = ["propagated_gravity"]


def propagated_gravity(judged: Evaluation, axis: Literal["x", "y", "z"], recording: int = 0) -> Figure:
    """Gravity along one body axis at the rests of a control recording.

    The upper plot shows gravity at each rest, m/s^2: measured by the accelerometer, and propagated from the
    first rest with the gyroscope's rates, uncalibrated and calibrated. The lower plot shows propagated minus
    measured gravity after calibration, which is too small to be visible in the upper plot.

    judged     `CalibrationResult.control`, or the result of `imucal.evaluate`
    axis       body axis
    recording  index of the recording

    Raises InputError if there is no such recording or axis, ImucalError if plotly is not installed.
    """
    if not 0 <= recording < len(judged.carried):
        raise InputError(f"there is no recording {recording}: {len(judged.carried)} were evaluated")
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis is {axis!r}: give x, y or z")
    column = "xyz".index(axis)
    carried = judged.carried[recording]
    gravity, uncalibrated, calibrated = (
        getattr(carried, name)[:, column] for name in ("measured", "uncalibrated", "calibrated")
    )
    difference = calibrated - gravity
    kept = thinned(np.abs(difference))
    time = carried.time_s[kept]

    go, make_subplots = plotly()
    figure = make_subplots(rows=2, shared_xaxes=True, row_heights=[0.7, 0.3], vertical_spacing=0.07)

    def curve(
        name: str, values: Any, colour: str, symbol: str, dash: str | None, size: int, row: int
    ) -> None:
        figure.add_trace(
            go.Scatter(
                x=time,
                y=values[kept],
                name=name,
                customdata=kept,
                mode="markers" if dash is None else "lines+markers",
                marker={"color": colour, "symbol": symbol, "size": size},
                line={"color": colour, "dash": dash, "width": 1},
                showlegend=row == 1,
                hovertemplate=f"rest %{{customdata}}, %{{x:.1f}} s<br>{name}: %{{y:.5g}} m/s²<extra></extra>",
            ),
            row=row,
            col=1,
        )

    curve("propagated, uncalibrated", uncalibrated, VERMILION, "triangle-up", "dot", 7, 1)
    curve("measured", gravity, BLUE, "circle-open", None, 11, 1)
    curve("propagated, calibrated", calibrated, GREEN, "cross", "solid", 6, 1)
    curve("calibrated minus measured", difference, GREEN, "diamond", "solid", 6, 2)
    figure.update_yaxes(title_text=f"gravity along {axis}, m/s²", row=1, col=1)
    figure.update_yaxes(title_text="difference", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    return styled(figure, 400)
