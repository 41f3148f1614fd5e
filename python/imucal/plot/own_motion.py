"""Plots for a search for missing effects: residuals at the rests and moves of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.plot.style import BAND, BLUE, GREEN, VERMILION, plotly, styled
from imucal.plot.thinning import evenly
from imucal.units import DEGREE_RAD, STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap.laws.law import Law
    from imucal.gap.own_motion import MoveSignals, OwnMotion

__all__ = ["Dependence", "dependences", "law_points", "move_signals", "residual_against"]

# Maximum number of samples that are drawn of each signal during a move.
SAMPLES: Final = 800
# A residual is drawn against a variable if a cubic in the variable explains at least this share of its
# variance.
LEAST_SHARE: Final = 0.3
# Minimum number of rests or moves for the dependence of a residual on a variable to be drawn. A cubic fits
# fewer points by chance.
LEAST_POINTS: Final = 8
# The residual |f| - g of a rest is attributed to an axis if the cosine of the angle between the axis and the
# vertical exceeds this value. The cosine of 26 deg is 0.9.
VERTICAL: Final = 0.9
MG: Final = 1e3 / STANDARD_GRAVITY_MPS2
DPS: Final = 1.0 / DEGREE_RAD


@dataclass(frozen=True, eq=False)
class Dependence:
    """A residual and the variable on which it depends most, with one value per rest or move.

    residual, variable  names with units
    is_control          (K,) whether the rest or move is from a control recording, which the fits did not use
    at                  (K,) values of the variable
    before, after       (K,) the residual without and with the effects
    share               share of the variance of `before` that a cubic in the variable explains
    """

    residual: str
    variable: str
    is_control: Any
    at: FloatArray
    before: FloatArray
    after: FloatArray
    share: float


def move_signals(signals: MoveSignals, *, has_effects: bool = True, is_hand_moved: bool = False) -> Figure:
    """The signal of the accelerometer in one move, and the signal predicted from the gyroscope.

    The plot shows the body axis with the largest residual after the move. The lower panel shows the residual,
    measured minus predicted.

    With `has_effects`, the signal predicted with the found effects is also drawn.

    With `is_hand_moved`, the range of the lower panel is set by the residuals at the rests, because during
    the move the accelerometer also measures the acceleration of the hand.

    Raises ImucalError if plotly is not installed.
    """
    _, make_subplots = plotly()
    figure = make_subplots(rows=2, shared_xaxes=True, row_heights=[0.6, 0.4], vertical_spacing=0.06)
    after_move = signals.time_s >= signals.end_s
    axis = int(np.argmax(np.abs(signals.residual_before[after_move].mean(axis=0))))
    kept = evenly(len(signals.time_s), SAMPLES)
    time = signals.time_s[kept]
    without = " without effects" if has_effects else ""
    curves = [
        ("measured", signals.measured_after, BLUE, "solid", 1),
        (f"predicted{without}", signals.predicted_before, VERMILION, "dot", 1),
    ]
    residuals = [(f"residual{without}", signals.residual_before, VERMILION, "solid", 2)]
    if has_effects:
        curves.append(("predicted with effects", signals.predicted_after, GREEN, "dash", 1))
        residuals.append(("residual with effects", signals.residual_after, GREEN, "solid", 2))
    for name, values, colour, dash, row in [*curves, *residuals]:
        figure.add_scatter(
            x=time, y=values[kept, axis], name=name, mode="lines", row=row, col=1,
            line={"color": colour, "dash": dash, "width": 1.5 if row == 2 or name == "measured" else 2},
            showlegend=row == 1, hovertemplate=f"%{{x:.2f}} s<br>{name}: %{{y:.4g}} m/s²<extra></extra>",
        )  # fmt: skip
    for row in (1, 2):
        figure.add_vrect(
            x0=signals.start_s, x1=signals.end_s, fillcolor=BAND, line_width=0, layer="below", row=row, col=1
        )
    figure.update_yaxes(title_text=f"force along {'xyz'[axis]}, m/s²", row=1, col=1)
    figure.update_yaxes(title_text="residual, m/s²", row=2, col=1)
    if is_hand_moved:
        at_rest = (signals.time_s < signals.start_s) | after_move
        drawn = np.concatenate([values[at_rest, axis] for _, values, *_ in residuals])
        edge = 1.6 * float(np.abs(drawn).max())
        figure.update_yaxes(range=[-edge, edge], row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    return styled(figure, 430)


def dependences(motion: OwnMotion) -> list[Dependence]:
    """Each residual with the variable that explains most of its variance, the best explained first.

    Residuals are the rate at rest about each axis, the norm of gravity at rest, and the rate in moves about
    each axis. Residuals of which no variable explains at least 30 % of the variance are omitted.
    """
    rests, moves = motion.rests, motion.moves
    variables = {
        **{f"up along {a}, g": rests.up[:, k] for k, a in enumerate("xyz")},
        "time, s": rests.time_s,
        **{_column(name): values for name, values in rests.columns.items()},
    }
    found = []
    residuals: list[tuple[str, FloatArray, FloatArray]] = [
        (f"rate at rest about {a}, deg/s", DPS * rests.rate_before[:, k], DPS * rests.rate_after[:, k])
        for k, a in enumerate("xyz")
    ]
    residuals.append(("|f| − g at rest, mg", MG * rests.norm_before, MG * rests.norm_after))
    for name, before, after in residuals:
        shares = {key: _share(at, before) for key, at in variables.items()}
        best = max(shares, key=shares.__getitem__)
        found.append(Dependence(name, best, rests.is_control, variables[best], before, after, shares[best]))
    for k, a in enumerate("xyz"):
        own = moves.axis == k
        at = DPS * moves.rate[own]
        before, after = DPS * moves.error_before[own], DPS * moves.error_after[own]
        name, variable = f"rate in moves about {a}, deg/s", f"rate about {a}, deg/s"
        found.append(Dependence(name, variable, moves.is_control[own], at, before, after, _share(at, before)))
    return sorted((one for one in found if one.share >= LEAST_SHARE), key=lambda one: -one.share)


def residual_against(shown: Sequence[Dependence], *, has_effects: bool = True) -> Figure:
    """Residuals against the variables that explain them, one panel each, without and with the effects.

    Filled markers are recordings of the fit, open ones control recordings.

    Raises InputError without any residual to show, ImucalError if plotly is not installed.
    """
    if not shown:
        raise InputError("no residual depends on a variable")
    _, make_subplots = plotly()
    rows = len(shown)
    titles = [one.residual for one in shown]
    figure = make_subplots(rows=rows, vertical_spacing=0.36 / rows, subplot_titles=titles)
    looks = [("without effects", "before", VERMILION, "triangle-up")]
    if has_effects:
        looks.append(("with effects", "after", GREEN, "circle"))
    for row, one in enumerate(shown, start=1):
        for name, key, colour, symbol in looks:
            for control in (False, True):
                own = np.flatnonzero(np.asarray(one.is_control) == control)
                if len(own) == 0:
                    continue
                own = own[evenly(len(own))]
                label = f"{name}, control" if control else name
                figure.add_scatter(
                    x=one.at[own], y=getattr(one, key)[own], name=label, legendgroup=label, mode="markers",
                    marker={"color": colour, "symbol": f"{symbol}-open" if control else symbol, "size": 7},
                    showlegend=not any(trace.name == label for trace in figure.data), row=row, col=1,
                    hovertemplate=f"%{{x:.4g}}<br>{label}: %{{y:.3g}}<extra></extra>",
                )  # fmt: skip
        figure.update_xaxes(title_text=one.variable, row=row, col=1)
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    figure = styled(figure, 90 + 215 * rows)
    return figure.update_layout(margin={"t": 76}, legend={"yref": "container", "y": 1.0, "yanchor": "top"})


def law_points(motion: OwnMotion, law: Law) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Points to draw beside the curve of a law, by axis: values of its variable, and errors of the sensor.

    Each point shows the error of one axis at a rest or in a move. The error is the value of the law plus the
    residual that remains with the law, in SI units. There are no points for a law of several variables, or of
    a variable that is not known for rests or moves.
    """
    curve = law.curve
    if curve is None:
        return {}
    rests, moves = motion.rests, motion.moves
    points = {}
    for k, axis in enumerate("xyz"):
        at = _at_rests(motion, curve.variable, k)
        if law.sensor == "gyroscope" and curve.variable in ("w", "w_norm"):
            own = moves.axis == k
            at = moves.rate[own] if curve.variable == "w" else np.abs(moves.rate[own])
            residual = moves.error_after[own]
        elif at is not None and law.sensor == "gyroscope":
            residual = rests.rate_after[:, k]
        elif at is not None:
            own = np.abs(rests.up[:, k]) > VERTICAL
            at, residual = at[own], (rests.norm_after * np.sign(rests.up[:, k]))[own]
        else:
            continue
        covered = (at >= curve.at[0]) & (at <= curve.at[-1])
        if covered.any():
            own_at = at[covered]
            points[axis] = (own_at, residual[covered] + np.interp(own_at, curve.at, curve.value[axis]))
    return points


def _at_rests(motion: OwnMotion, variable: str, axis: int) -> FloatArray | None:
    rests = motion.rests
    if variable == "f":
        force: FloatArray = STANDARD_GRAVITY_MPS2 * rests.up[:, axis]
        return force
    if variable == "time_s":
        return rests.time_s
    return rests.columns.get(variable)


def _share(at: FloatArray, values: FloatArray) -> float:
    """Share of the variance of `values` that a cubic in `at` explains."""
    known = np.isfinite(at) & np.isfinite(values)
    if known.sum() < LEAST_POINTS or np.ptp(at[known]) == 0.0:
        return 0.0
    x = (at[known] - at[known].mean()) / np.ptp(at[known])
    y = values[known] - values[known].mean()
    total = float(y @ y)
    columns = np.vander(x, 4)
    residual = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return 1.0 - float(residual @ residual) / total if total > 0.0 else 0.0


def _column(name: str) -> str:
    return {"temp_degc": "temperature, °C"}.get(name, name.replace("_rad", ", rad"))
