"""Plots of a fit: gravity before and after calibration, histogram of residuals, and correlations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.plot.sphere import body_axes, circles, scene, up_at_rests
from imucal.plot.style import BLUE, GREEN, INK, PAPER, VERMILION, plotly, styled
from imucal.plot.thinning import evenly, numbers

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.calibration.calibration import Calibration
    from imucal.estimation.result import CalibrationResult

__all__ = [
    "correlations",
    "histogram",
    "largest_correlations",
    "norms_before_and_after",
    "sphere_before_and_after",
]

# The errors of all points are magnified by a common factor before they are drawn. The factor is chosen so
# that the largest drawn distance of a point from the sphere is this fraction of the radius of the sphere.
DRAWN_ERROR: Final = 0.4
# Bin edges of the histogram of a normal variable, in standard deviations. The outermost bins also contain all
# values beyond them.
EDGES: Final = np.arange(-4.0, 4.01, 0.5)
# Bin edges of the histogram of sqrt(x^2 + y^2), where x and y are standard normal variables.
LENGTH_EDGES: Final = np.arange(0.0, 5.01, 0.5)


def norms_before_and_after(result: CalibrationResult) -> tuple[FloatArray, FloatArray]:
    """Norm of the force at each used rest, divided by gravity, before and after calibration, (K,) each.

    For the norm before calibration, raw counts are converted to forces with a common scale and a common bias
    for all axes. The common scale is the mean of the calibrated scales of the axes, and the common bias is
    the mean of the calibrated biases.
    """
    used = [rest for rest in result.rests if rest.excluded is None]
    raw = np.array([rest.mean_specific_force for rest in used], dtype=float).reshape(-1, 3)
    triad, gravity = result.calibration.accelerometer, result.calibration.gravity_mps2
    before = raw
    if result.calibration.accel_unit == "lsb":
        before = (raw - triad.bias.mean()) / np.diag(triad.sensitivity).mean()
    after = gravity + numbers(used, "norm_error_mps2")
    norms: FloatArray = np.linalg.norm(before, axis=1)
    return norms / gravity, after / gravity


def sphere_before_and_after(result: CalibrationResult) -> tuple[Figure, float]:
    """Plot of the measured gravity at each rest, before and after calibration, with a sphere of radius g.

    The distance of a point from the sphere is the error |f| - g, magnified by a factor. Returns the plot and
    this factor.

    Raises ImucalError if plotly is not installed.
    """
    go, _ = plotly()
    used = np.array([rest.excluded is None for rest in result.rests], dtype=bool)
    # Coordinates are rounded to the resolution of a screen, to reduce the size of the page.
    up = up_at_rests(result)[used].round(4)
    before, after = norms_before_and_after(result)
    largest = float(np.max(np.abs(before - 1.0), initial=0.0))
    factor = DRAWN_ERROR / largest if largest > 0.0 else 1.0
    kept = evenly(len(up))
    figure = go.Figure([circles(go, 1.0), *body_axes(go)])
    for name, norms, colour, symbol in (
        ("before", before, VERMILION, "diamond"),
        ("after", after, GREEN, "circle"),
    ):
        points = ((1.0 + factor * (norms - 1.0))[kept, None] * up[kept]).round(4)
        if name == "before":
            # A line from the sphere to each point shows the sign of the error: outwards if |f| is above g.
            sticks = np.stack([up[kept], points, np.full_like(points, np.nan)], axis=1).reshape(-1, 3)
            figure.add_scatter3d(
                x=sticks[:, 0], y=sticks[:, 1], z=sticks[:, 2], mode="lines",
                line={"color": colour, "width": 2}, hoverinfo="skip", showlegend=False,
            )  # fmt: skip
        figure.add_scatter3d(
            x=points[:, 0], y=points[:, 1], z=points[:, 2], name=name, mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 4, "line": {"color": PAPER, "width": 0.5}},
            text=[f"|f| − g {1e3 * (norm - 1.0):.3g} mg" for norm in norms[kept]],
            hovertemplate=f"{name}<br>%{{text}}<extra></extra>",
        )  # fmt: skip
    figure.update_layout(scene=scene())
    return styled(figure, 440).update_layout(margin={"l": 0, "r": 0, "t": 34, "b": 0}), factor


def histogram(result: CalibrationResult) -> Figure:
    """Residuals of used rests and moves, divided by the standard deviation that noise causes.

    The curves are the distributions of residuals that consist of noise only. The residual of a rest is
    |f| - g, which is normally distributed. The residual of a move is the direction error, which is
    distributed like the length of a vector of two normal components.

    Raises InputError without residuals, ImucalError if plotly is not installed.
    """
    panels = []
    for title, items, error, sigma, edges, density in (
        ("|f| − g at the rests", result.rests, "norm_error_mps2", "norm_sigma_mps2", EDGES, _normal),
        (
            "direction after the moves",
            result.moves,
            "direction_error_deg",
            "direction_sigma_deg",
            LENGTH_EDGES,
            _rayleigh,
        ),
    ):
        used = [item for item in items if item.excluded is None]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = numbers(used, error) / numbers(used, sigma)
        ratios = ratios[np.isfinite(ratios)]
        if len(ratios):
            panels.append((title, ratios, edges, density))
    if not panels:
        raise InputError("there are no residuals with a known noise")
    _, make_subplots = plotly()
    figure = make_subplots(
        rows=len(panels), vertical_spacing=0.24, subplot_titles=[title for title, *_ in panels]
    )
    for row, (_, ratios, edges, density) in enumerate(panels, start=1):
        counts, _ = np.histogram(np.clip(ratios, edges[0], edges[-1]), edges)
        width = edges[1] - edges[0]
        figure.add_bar(
            x=edges[:-1] + width / 2, y=counts, width=width, name="measured", showlegend=row == 1,
            marker={"color": BLUE, "line": {"color": PAPER, "width": 1}}, row=row, col=1,
            hovertemplate="%{y} at %{x:.2f} σ<extra></extra>",
        )  # fmt: skip
        at = np.linspace(edges[0], edges[-1], 81)
        figure.add_scatter(
            x=at, y=len(ratios) * width * density(at), name="noise alone", mode="lines",
            line={"color": VERMILION, "width": 2}, showlegend=row == 1, hoverinfo="skip", row=row, col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text="number", row=row, col=1)
        figure.update_xaxes(title_text="residual / σ of noise", row=row, col=1)
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    return styled(figure, 90 + 230 * len(panels)).update_layout(
        bargap=0, margin={"t": 70}, legend={"yref": "container", "y": 1.0, "yanchor": "top"}
    )


def correlations(calibration: Calibration) -> Figure:
    """Correlation coefficients of the estimated parameters.

    Raises InputError for a calibration without covariance, ImucalError if plotly is not installed.
    """
    names, matrix = _correlation(calibration)
    # Labels are short, for the screen of a phone: T is the abbreviation of sensitivity.
    labels = [name.replace("_sensitivity_", " T ").replace("_", " ") for name in names]
    go, _ = plotly()
    figure = go.Figure(
        go.Heatmap(
            z=matrix[::-1],
            x=labels,
            y=labels[::-1],
            zmin=-1,
            zmax=1,
            colorscale=[[0, VERMILION], [0.5, PAPER], [1, BLUE]],
            colorbar={"thickness": 10, "tickvals": [-1, 0, 1], "outlinewidth": 0, "tickfont": {"color": INK}},
            hovertemplate="%{y}<br>%{x}<br>%{z:.2f}<extra></extra>",
        )
    )
    # All names are shown, even on a phone, so their text is small.
    ticks = {"tickmode": "array", "tickfont": {"size": 7}}
    figure.update_xaxes(**ticks, tickvals=labels, tickangle=-90)
    figure.update_yaxes(**ticks, tickvals=labels)
    return styled(figure, 230 + 14 * len(names))


def largest_correlations(calibration: Calibration, most: int = 5) -> list[tuple[str, str, float]]:
    """At most `most` pairs of parameters with a correlation beyond +-0.5, the strongest correlation first."""
    names, matrix = _correlation(calibration)
    pairs = [
        (names[i], names[k], float(matrix[i, k])) for i in range(len(names)) for k in range(i + 1, len(names))
    ]
    pairs = [pair for pair in pairs if abs(pair[2]) > 0.5]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:most]


def _correlation(calibration: Calibration) -> tuple[list[str], FloatArray]:
    if calibration.covariance is None:
        raise InputError("the calibration has no covariance")
    std = np.sqrt(np.diag(calibration.covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix: FloatArray = calibration.covariance / np.outer(std, std)
    return list(calibration.covariance_names), np.nan_to_num(matrix)


def _normal(at: FloatArray) -> Any:
    return np.exp(-0.5 * at**2) / math.sqrt(2.0 * math.pi)


def _rayleigh(at: FloatArray) -> Any:
    return at * np.exp(-0.5 * at**2)
