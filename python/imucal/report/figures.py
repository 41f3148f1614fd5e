"""Plotly figures.

Colours are Okabe and Ito's, told apart by colour-blind readers and visible on white and on black; every curve
also has its own marker, for paper without colour. Backgrounds are transparent and text has no colour of its
own: the page's style sheet sets both, for light, dark and print.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from imucal.errors import ImucalError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from plotly.graph_objects import Figure

BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"


def carried_gravity_figure(
    axis: Literal["x", "y", "z"],
    rest_time_s: ArrayLike,
    measured: ArrayLike,
    carried_uncalibrated: ArrayLike,
    carried_calibrated: ArrayLike,
) -> Figure:
    """Gravity along one body axis at the rests of a control record (figures 2 to 4 of the paper).

    Above: gravity as the accelerometer measures it at each rest, and as the gyroscope carries it there from
    the first rest, uncalibrated and calibrated. Below: what is left between carried and measured after
    calibration, which is too small to be seen above.

    Args:
        axis: The body axis shown.
        rest_time_s: (K,) middle of each rest, s.
        measured: (K, 3) calibrated accelerometer means, m/s^2, body frame.
        carried_uncalibrated: (K, 3) gravity carried by the raw gyroscope, m/s^2, body frame.
        carried_calibrated: (K, 3) gravity carried by the calibrated gyroscope, m/s^2, body frame.

    Raises:
        ImucalError: plotly is not installed.
        ValueError: the shapes do not fit together.
    """
    column = "xyz".index(axis)
    time = np.asarray(rest_time_s, dtype=float)
    series = [np.asarray(a, dtype=float) for a in (measured, carried_uncalibrated, carried_calibrated)]
    for values in series:
        if values.shape != (time.size, 3):
            raise ValueError(
                f"gravity at {time.size} rests has shape {values.shape}: ({time.size}, 3) is needed, "
                "one row per rest time"
            )
    gravity, uncalibrated, calibrated = (values[:, column] for values in series)

    go, make_subplots = plotly()
    figure = make_subplots(rows=2, shared_xaxes=True, row_heights=[0.7, 0.3], vertical_spacing=0.06)
    rest = np.arange(1, time.size + 1)

    def curve(name: str, values: np.ndarray, colour: str, symbol: str, dash: str | None, size: int) -> Any:
        return go.Scatter(
            x=time,
            y=values,
            name=name,
            customdata=rest,
            mode="markers" if dash is None else "lines+markers",
            marker={"color": colour, "symbol": symbol, "size": size},
            line={"color": colour, "dash": dash, "width": 1},
            hovertemplate=f"rest %{{customdata}}, %{{x:.1f}} s<br>{name}: %{{y:.4f}} m/s²<extra></extra>",
        )

    figure.add_trace(
        curve("carried, uncalibrated", uncalibrated, VERMILION, "triangle-up", "dot", 7), row=1, col=1
    )
    figure.add_trace(curve("measured", gravity, BLUE, "circle-open", None, 11), row=1, col=1)
    figure.add_trace(curve("carried, calibrated", calibrated, GREEN, "cross", "solid", 6), row=1, col=1)
    figure.add_trace(
        curve("calibrated minus measured", calibrated - gravity, GREEN, "diamond", "solid", 6), row=2, col=1
    )
    figure.update_yaxes(title_text=f"gravity along {axis}, m/s²", row=1, col=1)
    figure.update_yaxes(title_text="difference, m/s²", row=2, col=1)
    figure.update_yaxes(automargin=True, title_standoff=10)
    figure.data[3].showlegend = False
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    return styled(figure)


def styled(figure: Figure) -> Figure:
    """The figure as all of them look."""
    return figure.update_layout(
        template="none",
        height=420,
        margin={"l": 60, "r": 10, "t": 10, "b": 50},
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.01, "x": 0},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"family": "system-ui, sans-serif", "size": 13},
    )


def plotly() -> tuple[Any, Any]:
    """The graph objects of plotly and `make_subplots`; ImucalError without plotly."""
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    except ImportError as error:
        raise ImucalError(
            'figures need plotly, which is not installed: pip install "imucal-rs[report]", '
            "or leave the report out"
        ) from error
    return go, make_subplots
