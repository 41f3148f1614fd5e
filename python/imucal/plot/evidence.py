"""Plots of a search for a missing effect: residuals, evidence of the candidates, and figures of merit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.plot.style import BLUE, GREEN, GREY, VERMILION, plotly, rows_of, styled
from imucal.plot.thinning import evenly
from imucal.units import DEGREE_RAD, SHOWN, STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.gap import Gap
    from imucal.gap.laws.law import Law

__all__ = ["before_and_after", "channel_name", "disagreement", "figure_sets", "law", "ranking", "shown"]

# Half width of a 95 % interval, in standard deviations.
INTERVAL_95: Final = 1.96

MG: Final = SHOWN["m/s^2"][0]
LAW_MARKERS: Final = ("circle", "triangle-up", "square")
# For each variable in the formula of a law: factor to the unit of datasheets, and title of its plot axis.
VARIABLES: Final = {
    "w": (1.0 / DEGREE_RAD, "rate about the axis, deg/s"),
    "w_norm": (1.0 / DEGREE_RAD, "magnitude of the rate, deg/s"),
    "f": (1.0 / STANDARD_GRAVITY_MPS2, "force along the axis, g"),
    "temp_degc": (1.0, "temperature, °C"),
    "time_s": (1.0, "time, s"),
    "rest_s": (1.0, "time since the last move, s"),
    **{f"stand_{k}_rad": (1.0 / DEGREE_RAD, f"angle of motor {k}, deg") for k in (1, 2, 3)},
}

# Number of candidates shown in the ranking.
CANDIDATES: Final = 15
ROW_PX: Final = 26
FIGURES: Final = {
    "chi2_per_dof": "χ² per degree of freedom",
    "gravity_norm_rms_mps2": "|f| − g at rest, rms, mg",
    "gravity_direction_rms_deg": "direction error per move, rms, deg",
}
# Names of the kinds of residuals in plots; the body axis is appended.
CHANNELS: Final = {
    "rest_norm": "|f| − g at rest",
    "rest_rate": "rate at rest about",
    "move_direction": "direction after moves about",
    "move_force": "force during moves along",
}
SETS: Final = {"control_set": "control", "held_out": "held out", "calibration_set": "calibration"}


def disagreement(gap: Gap) -> Figure:
    """Residuals of each kind and axis in `gap.where`, divided by their noise, without and with the effects.

    Residuals from noise alone have the value 1.

    Raises InputError if there are no residuals, ImucalError if plotly is not installed.
    """
    where = getattr(gap, "where", None)
    if not where or not where["channels"]:
        raise InputError("there are no residuals to show: the recordings were refused")
    go, _ = plotly()
    figure = go.Figure()
    rows = where["channels"]
    names = [channel_name(row) for row in rows]
    looks = [("without effects", "times_noise", VERMILION, "triangle-up", 11)]
    if gap.has_effects:
        looks.append(("with the found effects", "times_noise_after", GREEN, "circle", 9))
    for name, key, colour, symbol, size in looks:
        figure.add_scatter(
            x=[row[key] for row in rows],
            y=names,
            name=name,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": size},
            hovertemplate=f"%{{y}}, {name}<br>%{{x:.3g}} times noise<extra></extra>",
        )
    figure.add_vline(x=1, line={"color": GREY, "width": 1, "dash": "dash"}, layer="below")
    figure.update_yaxes(rows_of(names))
    figure.update_xaxes(title_text="rms residual / noise", rangemode="tozero")
    return styled(figure, 110 + ROW_PX * len(rows))


def channel_name(row: Mapping[str, Any]) -> str:
    """The name of the kind of residual in a row of `gap.where`, with the axis of the row."""
    name = CHANNELS.get(row["channel"], row["channel"].replace("_", " "))
    return name if row["axis"] is None else f"{name} {row['axis']}"


def ranking(gap: Gap) -> Figure:
    """Log Bayes factors, in nats, of the 15 best candidates relative to the model without effects.

    Filled bars are effects added to the model, striped bars their rivals.

    Raises InputError if there is no ranking, ImucalError if plotly is not installed.
    """
    if not gap.ranking:
        raise InputError(
            "there is no ranking: faults of the data ended the search before candidates were scored"
        )
    go, _ = plotly()
    best = gap.ranking[:CANDIDATES]
    picked = {effect["name"] for effect in gap.effects}
    rivals = set(gap.ambiguous_with)
    looks = (
        ("added to the model", picked, BLUE, ""),
        ("rival of the found effect", rivals, VERMILION, "/"),
        ("other candidate", {score["name"] for score in best} - picked - rivals, GREY, ""),
    )
    figure = go.Figure()
    for name, members, colour, shape in looks:
        own = [score for score in best if score["name"] in members]
        if own:
            figure.add_bar(
                x=[score["log_bayes_factor"] for score in own],
                y=[score["name"] for score in own],
                name=name,
                orientation="h",
                width=0.65,
                marker={"color": colour, "pattern": {"shape": shape}},
                text=[_evidence(score) for score in own],
                textposition="none",
                hovertemplate="%{text}<extra></extra>",
            )
    order = [score["name"] for score in best]
    figure.update_yaxes(rows_of(order))
    figure.update_xaxes(title_text="log Bayes factor, nats")
    figure.update_layout(barmode="overlay")
    return styled(figure, 110 + ROW_PX * len(order))


def law(found: Law, points: Mapping[str, tuple[FloatArray, FloatArray]] | None = None) -> Figure:
    """The curve of a law over its variable, one for each axis, with a 95 % band.

    The band is computed from the standard deviations of the law's parameters.

    A law is a formula for residuals that no effect of the catalogue describes.

    points  values of the variable and errors of the sensor by axis, such as those of `law_points`

    Raises InputError for a law of several variables, ImucalError if plotly is not installed.
    """
    curve = found.curve
    if curve is None:
        raise InputError(f"{found.name} depends on {' and '.join(found.variables)}, so it is no curve")
    go, _ = plotly()
    figure = go.Figure()
    factor, unit = SHOWN["rad/s" if found.sensor == "gyroscope" else "m/s^2"]
    at, at_title = _in_shown_units(curve.variable, np.array(curve.at))
    looks = zip("xyz", (BLUE, VERMILION, GREEN), ("solid", "dash", "dot"), LAW_MARKERS, strict=True)
    for axis, colour, dash, symbol in looks:
        value, std = factor * np.array(curve.value[axis]), factor * np.array(curve.std[axis])
        for sign in (1.0, -1.0):
            figure.add_scatter(
                x=at,
                y=value + sign * INTERVAL_95 * std,
                mode="lines",
                line={"width": 0, "color": colour},
                fill="tonexty" if sign < 0 else None,
                opacity=0.3,
                hoverinfo="skip",
                showlegend=False,
            )
        figure.add_scatter(
            x=at,
            y=value,
            name=axis,
            mode="lines",
            line={"color": colour, "dash": dash},
            hovertemplate=f"{at_title}: %{{x:.4g}}, {axis}: %{{y:.3g}} {unit}<extra></extra>",
        )
        if points and axis in points:
            own_at, own = points[axis]
            kept = evenly(len(own))
            figure.add_scatter(
                x=_in_shown_units(curve.variable, own_at)[0][kept],
                y=factor * own[kept],
                name=f"{axis}, measured",
                mode="markers",
                marker={"color": colour, "symbol": symbol, "size": 7},
                hovertemplate=f"{at_title}: %{{x:.4g}}, {axis}: %{{y:.3g}} {unit}<extra></extra>",
            )
    figure.update_xaxes(title_text=at_title)
    figure.update_yaxes(title_text=f"error, {unit}")
    return styled(figure, 360).update_layout(legend={"traceorder": "normal"})


def _in_shown_units(variable: str, values: FloatArray) -> tuple[FloatArray, str]:
    """The values of a law's variable, in the unit of datasheets, and the title of its plot axis."""
    factor, unit = VARIABLES.get(variable, (1.0, variable))
    return factor * values, unit


def shown(name: str, figures: Mapping[str, Any]) -> float | None:
    """The figure of merit `name`, in the unit that its title in `FIGURES` states; None if it is not known."""
    value: float | None = figures.get(name)
    return value if value is None or not name.endswith("_mps2") else MG * value


def figure_sets(gap: Gap) -> dict[str, Mapping[str, Any]]:
    """Figures of merit before and after the effects were added, by name of the set of recordings.

    Sets that the fit has not used come first.
    """
    return {word: getattr(gap, of) for of, word in SETS.items() if getattr(gap, of) is not None}


def before_and_after(gap: Gap) -> Figure:
    """Plot of the figures of merit of the control, held-out and calibration sets.

    The plot shows the values before and after the effects were added.

    Raises InputError if there are no figures of merit, ImucalError if plotly is not installed.
    """
    sets = figure_sets(gap)
    if not sets:
        raise InputError("there are no figures of merit: faults of the data ended the search before any fit")
    _, make_subplots = plotly()
    figure = make_subplots(rows=len(FIGURES), vertical_spacing=0.17, subplot_titles=list(FIGURES.values()))
    looks = (("before", VERMILION, "triangle-up", 11), ("after", GREEN, "circle", 10))
    for row, name in enumerate(FIGURES, start=1):
        for word, of in sets.items():
            figure.add_scatter(
                x=[shown(name, of[when]) for when in ("before", "after")],
                y=[word, word],
                mode="lines",
                line={"color": GREY, "width": 2},
                hoverinfo="skip",
                showlegend=False,
                row=row,
                col=1,
            )
        for when, colour, symbol, size in looks:
            figure.add_scatter(
                x=[shown(name, of[when]) for of in sets.values()],
                y=list(sets),
                name=when,
                mode="markers",
                marker={"color": colour, "symbol": symbol, "size": size},
                hovertemplate=f"%{{y}}, {when}: %{{x:.4g}}<extra></extra>",
                showlegend=row == 1,
                row=row,
                col=1,
            )
        figure.update_yaxes(rows_of(list(sets)), row=row, col=1)
    figure.update_xaxes(rangemode="tozero")
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    return styled(figure, 90 + 3 * (55 + 32 * len(sets))).update_layout(legend={"y": 1.08}, margin={"t": 60})


def _evidence(score: Any) -> str:
    return (
        f"{score['name']}<br>log Bayes factor {score['log_bayes_factor']:.1f}<br>"
        f"χ² {score['statistic']:.1f} with {score['dof']} degrees of freedom<br>p {score['p_value']:.2g}"
    )
