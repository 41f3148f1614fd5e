"""Plot of the poses at rest: the directions of gravity on a sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.plot.style import BALL, BLUE, GREEN, GREY, INK, PAPER, VERMILION, plotly, styled
from imucal.plot.thinning import evenly

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.result import CalibrationResult

__all__ = ["body_axes", "circles", "coverage", "scene", "up_at_rests"]


def coverage(result: CalibrationResult | Evaluation) -> Figure:
    """A sphere that can be rotated, with a point for the up direction of each rest in the body frame.

    Poses far from all points are not covered. Effects that are observable only in such poses are not
    estimated.

    Raises ImucalError if plotly is not installed.
    """
    go, _ = plotly()
    figure = go.Figure([_ball(go), circles(go), *body_axes(go)])
    series = _series(result)
    for name, up, words, colour, symbol, size in series:
        kept = evenly(len(up))
        figure.add_scatter3d(
            x=up[kept, 0],
            y=up[kept, 1],
            z=up[kept, 2],
            name=name,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": size, "line": {"color": PAPER, "width": 0.5}},
            text=[words[i] for i in kept],
            hovertemplate="%{text}<br>up (%{x:.2f}, %{y:.2f}, %{z:.2f})<extra></extra>",
        )
    figure.update_layout(scene=scene())
    return styled(figure, 480).update_layout(margin={"l": 0, "r": 0, "t": 34, "b": 0})


def scene() -> dict[str, Any]:
    """The layout of a view of a sphere: no box around it, and equal axes."""
    nothing = {"visible": False, "showspikes": False, "range": [-1.3, 1.3]}
    return {
        "xaxis": nothing,
        "yaxis": nothing,
        "zaxis": nothing,
        "aspectmode": "cube",
        "bgcolor": PAPER,
        "camera": {"eye": {"x": 1.0, "y": 0.91, "z": 0.68}},
        "dragmode": "orbit",
    }


def up_at_rests(result: CalibrationResult | Evaluation) -> FloatArray:
    """The up direction at each rest in the body frame, unit vectors (K, 3)."""
    from imucal.estimation.evaluate import Evaluation

    if isinstance(result, Evaluation):
        force = [np.asarray(carried.measured, dtype=float).reshape(-1, 3) for carried in result.carried]
        up = np.concatenate([np.empty((0, 3)), *force])
    else:
        raw = np.array([rest.mean_specific_force for rest in result.rests]).reshape(-1, 3)
        triad = result.calibration.accelerometer
        up = np.linalg.solve(triad.sensitivity, (raw - triad.bias).T).T
    unit: FloatArray = up / np.linalg.norm(up, axis=1, keepdims=True)
    return unit


def _series(result: CalibrationResult | Evaluation) -> list[tuple[str, FloatArray, list[str], str, str, int]]:
    """Name, directions, hover texts, colour, symbol and size of each series of points."""
    from imucal.estimation.evaluate import Evaluation

    if isinstance(result, Evaluation):
        up = up_at_rests(result)
        return [("control rests", up, _numbered(len(up), "control rest"), GREEN, "diamond", 5)]
    up = up_at_rests(result)
    words = [
        f"rest {number} of {rest.recording}<br>{rest.place}"
        + (f"<br>excluded: {rest.excluded}" if rest.excluded else "")
        for number, rest in enumerate(result.rests)
    ]
    out = np.array([rest.excluded is not None for rest in result.rests], dtype=bool)
    looks = (("rests", ~out, BLUE, "circle", 6), ("excluded", out, VERMILION, "x", 6))
    series = [
        (name, up[own], [words[i] for i in np.flatnonzero(own)], colour, symbol, size)
        for name, own, colour, symbol, size in looks
        if own.any()
    ]
    return series if result.control is None else [*series, *_series(result.control)]


def _numbered(count: int, word: str) -> list[str]:
    return [f"{word} {number}" for number in range(count)]


def _ball(go: Any) -> Any:
    """A ball slightly smaller than the sphere of the points, which hides the points on its far side."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, 25), np.linspace(0, 2 * np.pi, 49), indexing="ij")
    return go.Surface(
        x=0.97 * np.sin(polar) * np.cos(azimuth),
        y=0.97 * np.sin(polar) * np.sin(azimuth),
        z=0.97 * np.cos(polar),
        colorscale=[[0, BALL], [1, BALL]],
        showscale=False,
        hoverinfo="skip",
        lighting={"ambient": 0.85, "diffuse": 0.2, "specular": 0.0},
        contours={axis: {"highlight": False} for axis in "xyz"},
    )


def circles(go: Any, radius: float = 0.98) -> Any:
    """Circles of latitude and longitude on a sphere, 30 deg apart."""
    turn = np.linspace(0, 2 * np.pi, 73)
    flat, up = np.cos(turn), np.sin(turn)
    circles = [
        *(np.array([flat * np.cos(a), flat * np.sin(a), up]) for a in np.radians(np.arange(0, 180, 30))),
        *(
            np.array([np.cos(a) * flat, np.cos(a) * up, np.full_like(turn, np.sin(a))])
            for a in np.radians(np.arange(-60, 61, 30))
        ),
    ]
    gap = np.full((3, 1), np.nan)
    x, y, z = radius * np.concatenate([part for circle in circles for part in (circle, gap)], axis=1)
    line = {"color": GREY, "width": 1}
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines", line=line, opacity=0.5, hoverinfo="skip", showlegend=False
    )


def body_axes(go: Any) -> list[Any]:
    """The body axes, labelled at both ends."""
    ends = np.concatenate([np.eye(3), -np.eye(3)])
    names = [f"{sign}{axis}" for sign in "+−" for axis in "xyz"]
    spokes = np.concatenate([[end, 1.18 * end, np.full(3, np.nan)] for end in ends]).T
    common = {"hoverinfo": "skip", "showlegend": False}
    return [
        go.Scatter3d(
            x=spokes[0], y=spokes[1], z=spokes[2], mode="lines", line={"color": INK, "width": 3}, **common
        ),
        go.Scatter3d(
            x=1.27 * ends[:, 0],
            y=1.27 * ends[:, 1],
            z=1.27 * ends[:, 2],
            mode="text",
            text=names,
            textfont={"size": 15, "color": INK},
            **common,
        ),
    ]
