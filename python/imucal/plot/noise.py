"""Plots of the Allan deviation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from imucal.arrays import FloatArray
from imucal.plot.style import BLUE, GREEN, GREY, INK, VERMILION, plotly, shown_unit, styled
from imucal.units import datasheet

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.noise_analysis.noise import AxisNoise, NoiseResult

__all__ = ["allan", "marks", "slopes"]

LOOKS = (("x", VERMILION, "circle"), ("y", GREEN, "square"), ("z", BLUE, "diamond"))
# Allan deviation of flicker noise divided by its coefficient B, the bias instability: sqrt(2 ln 2 / pi).
FLAT: Final = math.sqrt(2.0 * math.log(2.0) / math.pi)
# Averaging times, s, at which the asymptotes of white noise and random walk have the values N and K.
TAU_N_S: Final = 1.0
TAU_K_S: Final = 3.0
# For each noise figure: its name, its letter, the exponent of the averaging time in its asymptote, and the
# text of the legend.
KINDS: Final = (
    ("noise_density", "N", -0.5, "slope −1/2: white noise N"),
    ("bias_instability", "B", 0.0, "slope 0: bias instability B"),
    ("random_walk", "K", 0.5, "slope +1/2: random walk K"),
)
DASHES: Final = ("dot", "dash", "dashdot")


def marks(axis: AxisNoise) -> dict[str, tuple[float, float]]:
    """For each of N, B and K that has a value: averaging time, s, and Allan deviation at which it is read.

    N is read at 1 s and K at 3 s, where their asymptotes have the values N and K. 0.664 B is read at the
    minimum of the model.
    """
    found = {}
    density, instability, walk = axis.noise_density.value, axis.bias_instability.value, axis.random_walk.value
    if density is not None:
        found["N"] = (TAU_N_S, density)
    if instability is not None:
        found["B"] = (float(axis.taus_s[int(np.argmin(axis.model))]), FLAT * instability)
    if walk is not None:
        found["K"] = (TAU_K_S, walk)
    return found


def slopes(axes: tuple[AxisNoise, ...]) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Asymptotes over the averaging times for N, B and K, each of which is a geometric mean over the axes."""
    taus = axes[0].taus_s
    ends = np.array([taus[0], taus[-1]])
    lines = {}
    for name, letter, slope, _ in KINDS:
        values = [axis.figures[name].value for axis in axes]
        known = [value for value in values if value is not None and value > 0.0]
        if known:
            mean = float(np.exp(np.mean(np.log(known))))
            at = {"N": TAU_N_S, "B": 1.0, "K": TAU_K_S}[letter]
            level = FLAT * mean if letter == "B" else mean
            lines[letter] = (ends, level * (ends / at) ** slope)
    return lines


def allan(noise: NoiseResult, sensor: Literal["accel", "gyro"]) -> Figure:
    """Allan deviation over averaging time for the three axes of a sensor, in deg/h or µg.

    Points with 95 % confidence intervals are measured; lines are the identified noise model. Straight lines
    are the asymptotes of white noise, bias instability and random walk for the mean of the axes. Stars mark
    the points at which N, B and K of each axis are read.

    Raises ImucalError without plotly, and InputError for a sensor that the recording does not have.
    """
    go, _ = plotly()
    figure = go.Figure()
    si_unit = (noise.accel_unit if sensor == "accel" else noise.gyro_unit) or ""
    scale = datasheet("bias_instability", si_unit)
    factor, unit = scale.factor, shown_unit(scale.unit)
    axes = noise.triad(sensor)
    lines = slopes(axes)
    for (_, letter, _, words), dash in zip(KINDS, DASHES, strict=True):
        if letter in lines:
            at, values = lines[letter]
            figure.add_scatter(
                x=at, y=factor * values, name=words, mode="lines", hoverinfo="skip",
                line={"color": GREY, "width": 1.5, "dash": dash},
            )  # fmt: skip
    lettered: set[str] = set()
    for (axis, colour, symbol), of_axis in zip(LOOKS, axes, strict=True):
        error = {
            "type": "data",
            "symmetric": False,
            "array": factor * (of_axis.high - of_axis.deviations),
            "arrayminus": factor * (of_axis.deviations - of_axis.low),
            "thickness": 1,
            "width": 2,
        }
        figure.add_scatter(
            x=of_axis.taus_s, y=factor * of_axis.deviations, error_y=error, name=axis, mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 6},
            hovertemplate=f"%{{x:.4g}} s<br>{axis}: %{{y:.4g}} {unit}<extra></extra>",
        )  # fmt: skip
        figure.add_scatter(
            x=of_axis.taus_s, y=factor * of_axis.model, mode="lines", line={"color": colour, "width": 1},
            showlegend=False, hoverinfo="skip",
        )  # fmt: skip
        for letter, (tau, value) in marks(of_axis).items():
            figure.add_scatter(
                x=[tau], y=[factor * value], name=f"{letter} of {axis}", mode="markers+text",
                # Only one star of the three axes is labelled with the letter, because these stars often
                # overlap.
                text=["" if letter in lettered else letter], textposition="top right", textfont={"size": 14},
                marker={"color": colour, "symbol": "star", "size": 13, "line": {"color": INK, "width": 1}},
                showlegend=False, hovertemplate=f"{letter} of {axis}<extra></extra>",
            )  # fmt: skip
            lettered.add(letter)
    # The range of the y-axis is determined by the points without their confidence intervals, because the
    # intervals at the longest averaging times are very wide.
    everything = factor * np.concatenate([axis.deviations for axis in axes])
    positive = everything[everything > 0]
    axis_style: dict[str, Any] = {"type": "log", "dtick": 1}
    figure.update_xaxes(title_text="averaging time, s", **axis_style)
    figure.update_yaxes(title_text=f"Allan deviation, {unit}", **axis_style)
    if positive.size:
        low, high = np.log10(positive.min()), np.log10(positive.max())
        figure.update_yaxes(range=[low - 0.5, high + 0.5])
        figure.update_xaxes(range=[math.log10(axes[0].taus_s[0]) - 0.2, math.log10(axes[0].taus_s[-1]) + 0.2])
    figure = styled(figure, 480)
    # Tick labels are decimal numbers, such as 0.01 and 1000.
    return figure.update_layout(
        xaxis={"exponentformat": "none"}, yaxis={"exponentformat": "none"}, margin={"t": 78}
    )
