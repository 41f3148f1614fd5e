"""Plots of the residuals at rests and after moves, with the range that noise explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.estimation.rests import FittedMove, FittedRest, Move, Rest
from imucal.plot.style import BAND, BLUE, GREY, VERMILION, plotly, styled
from imucal.plot.thinning import numbers, thinned
from imucal.units import SHOWN

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.result import CalibrationResult

__all__ = ["move_residuals", "rest_residuals"]

MG: Final = SHOWN["m/s^2"][0]
# Bounds, in standard deviations, that contain 95 % of the residuals if there is only noise. The first bound
# is for a normal variable. The second bound is for the norm of a vector of two normal variables (Rayleigh
# distribution).
NORMAL_95: Final = 1.960
LENGTH_95: Final = math.sqrt(-2.0 * math.log(0.05))


def rest_residuals(result: CalibrationResult | Evaluation) -> Figure:
    """Norm of the force minus gravity at each rest, mg.

    The band contains 95 % of the residuals that noise alone causes. Raises ImucalError without plotly.
    """
    rests = result.rests
    words = [f"rest {number} of {rest.recording}<br>{rest.place}" for number, rest in enumerate(rests)]
    errors, sigmas = MG * numbers(rests, "norm_error_mps2"), MG * numbers(rests, "norm_sigma_mps2")
    return _figure("rest", rests, words, errors, sigmas, ("|f| − g", "mg"), (-NORMAL_95, NORMAL_95))


def move_residuals(result: CalibrationResult | Evaluation) -> Figure:
    """Angle between propagated and measured gravity after each move, deg, over the number of the move.

    The band contains 95 % of the residuals that noise alone causes. Raises ImucalError without plotly.
    """
    moves = result.moves
    words = [
        f"move {number} of {move.recording}<br>rest {move.from_rest} to rest {move.to_rest}, "
        f"{move.duration_s:.1f} s"
        for number, move in enumerate(moves)
    ]
    errors, sigmas = numbers(moves, "direction_error_deg"), numbers(moves, "direction_sigma_deg")
    return _figure("move", moves, words, errors, sigmas, ("direction error", "deg"), (0.0, LENGTH_95))


def _figure(
    what: str,
    items: Sequence[Rest] | Sequence[Move],
    words: Sequence[str],
    errors: FloatArray,
    sigmas: FloatArray,
    title: tuple[str, str],
    band: tuple[float, float],
) -> Figure:
    go, _ = plotly()
    name, unit = title
    out = np.array([item.excluded is not None for item in items], dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        importance = np.where(out, np.inf, np.abs(errors) / sigmas)
    kept = np.array(thinned(importance), dtype=int)

    figure = go.Figure()
    for edge in band:
        figure.add_scatter(
            x=kept,
            y=edge * sigmas[kept],
            mode="lines",
            line={"color": GREY, "width": 0, "shape": "hvh"},
            fill=None if edge == band[0] else "tonexty",
            fillcolor=BAND,
            name="95 % of noise residuals",
            showlegend=edge != band[0],
            hoverinfo="skip",
        )
    looks = ((~out, "used", BLUE, "circle", 7), (out, "excluded", VERMILION, "x", 9))
    for chosen, label, colour, symbol, size in looks:
        own = kept[chosen[kept]]
        if len(own) == 0:
            continue
        figure.add_scatter(
            x=own,
            y=errors[own],
            name=label,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": size},
            text=[_hover(words[i], items[i], sigmas[i], unit) for i in own],
            hovertemplate=f"%{{text}}<br>{name} %{{y:.4g}} {unit}<extra></extra>",
        )
    figure.update_xaxes(title_text=f"number of the {what}")
    figure.update_yaxes(title_text=f"{name}, {unit}", range=_range(errors[~out], sigmas[~out], band))
    return styled(figure, 340)


def _hover(words: str, item: Rest | Move, sigma: float, unit: str) -> str:
    lines = [words]
    if np.isfinite(sigma):
        lines.append(f"1 σ of noise {sigma:.3g} {unit}")
    if isinstance(item, (FittedRest, FittedMove)) and item.p_value is not None:
        lines.append(f"p {item.p_value:.2g} for noise only")
    if item.excluded is not None:
        lines.append(f"excluded: {item.excluded}")
    return "<br>".join(lines)


def _range(errors: FloatArray, sigmas: FloatArray, band: tuple[float, float]) -> list[float] | None:
    """Axis range for the residuals that the fit uses. A double click also shows excluded residuals."""
    seen = np.concatenate([errors, band[0] * sigmas, band[1] * sigmas])
    seen = seen[np.isfinite(seen)]
    if seen.size == 0:
        return None
    low, high = float(seen.min()), float(seen.max())
    margin = 0.06 * (high - low)
    return [low - margin, high + margin]
