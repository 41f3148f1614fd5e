"""Plot of a recording: its signals over time, with rests, saturated samples, and temperature."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.plot.style import BAND, BLUE, EXCLUDED, GREEN, GREY, VERMILION, plotly, shown_unit, styled
from imucal.units import SHOWN, STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from imucal.estimation.inspection import Inspection
    from imucal.recording.recording import Recording

__all__ = ["envelope", "recording_signals", "saturated_samples"]

# A signal is divided into this number of time intervals. Only the smallest and the largest sample of each
# interval are drawn. The number is about the width of a figure in pixels.
INTERVALS: Final = 700
# Maximum number of rests that are shaded.
RESTS: Final = 400
LOOKS: Final = (("x", BLUE), ("y", VERMILION), ("z", GREEN))
TRIAD_PX: Final = 230
COLUMN_PX: Final = 130


def recording_signals(recording: Recording, inspection: Inspection) -> Figure:
    """Specific force, angular rate and temperature over time, with the rests and the excluded rests shaded.

    A signal is drawn by its smallest and largest sample in each of 700 intervals of time. Crosses mark
    samples at the end of a sensor's range.

    Raises ImucalError if plotly is not installed.
    """
    _, make_subplots = plotly()
    triads = [
        (prefix, title, np.asarray(samples, dtype=float), *_scale(unit))
        for prefix, title, samples, unit in (
            ("accel", "specific force", recording.specific_force, recording.accel_unit),
            ("gyro", "angular rate", recording.angular_rate, recording.gyro_unit),
        )
        if samples is not None
    ]
    degc = recording.temperature_degc
    heights = [TRIAD_PX] * len(triads) + ([COLUMN_PX] if degc is not None else [])
    figure = make_subplots(
        rows=len(heights),
        shared_xaxes=True,
        row_heights=heights,
        vertical_spacing=0.05 if len(heights) > 1 else 0.0,
    )
    time = recording.time_s
    for row, (prefix, title, samples, factor, unit) in enumerate(triads, start=1):
        for axis, (name, colour) in enumerate(LOOKS):
            at, values = envelope(time, samples[:, axis])
            figure.add_scatter(
                x=at, y=factor * values, name=name, legendgroup=name, showlegend=row == 1, mode="lines",
                line={"color": colour, "width": 1}, row=row, col=1,
                hovertemplate=f"%{{x:.2f}} s<br>{title} {name}: %{{y:.4g}} {unit}<extra></extra>",
            )  # fmt: skip
        at, values = saturated_samples(recording, inspection, prefix)
        if len(at):
            figure.add_scatter(
                x=at, y=factor * values, name="saturated", legendgroup="saturated", mode="markers",
                showlegend=not any(trace.name == "saturated" for trace in figure.data),
                marker={"color": VERMILION, "symbol": "x", "size": 8}, row=row, col=1,
                hovertemplate="%{x:.2f} s: saturated<extra></extra>",
            )  # fmt: skip
        figure.update_yaxes(title_text=f"{title}, {unit}", row=row, col=1)
    if degc is not None:
        at, values = envelope(time, degc)
        figure.add_scatter(
            x=at, y=values, mode="lines", line={"color": GREY, "width": 1.5}, showlegend=False,
            row=len(heights), col=1, hovertemplate="%{x:.2f} s: %{y:.2f} °C<extra></extra>",
        )  # fmt: skip
        figure.update_yaxes(title_text="°C", row=len(heights), col=1)
    _shade(figure, inspection)
    figure.update_xaxes(title_text="time, s", row=len(heights), col=1)
    return styled(figure, sum(heights) + 90)


def envelope(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest of the samples in each interval of time, in order of time.

    A short signal is returned with all samples. Missing samples are omitted.
    """
    known = np.isfinite(values)
    time_s, values = time_s[known], values[known]
    if len(values) <= 2 * INTERVALS:
        return time_s, values
    edges = np.linspace(0, len(values), INTERVALS + 1).astype(int)
    chosen = [
        start + index
        for start, end in pairwise(edges.tolist())
        for index in sorted({int(np.argmin(values[start:end])), int(np.argmax(values[start:end]))})
    ]
    return time_s[chosen], values[chosen]


def saturated_samples(
    recording: Recording, inspection: Inspection, prefix: str
) -> tuple[FloatArray, FloatArray]:
    """Times and values of saturated samples of a sensor (`prefix`); at most two per interval of time.

    These are consecutive samples with the extreme value of a column that a finding reports as saturated.
    """
    columns = {
        column
        for finding in inspection.findings
        if finding.code == f"{prefix}_saturation"
        for column in finding.columns
    }
    samples = recording.specific_force if prefix == "accel" else recording.angular_rate
    times, values = [np.empty(0)], [np.empty(0)]
    for axis, name in enumerate("xyz"):
        if f"{prefix}_{name}" not in columns or samples is None:
            continue
        column = np.asarray(samples[:, axis], dtype=float)
        for extreme in (np.nanmin(column), np.nanmax(column)):
            there = column == extreme
            run = there & (np.append(there[1:], False) | np.append(False, there[:-1]))
            at, own = envelope(recording.time_s[run], column[run])
            times.append(at)
            values.append(own)
    return np.concatenate(times), np.concatenate(values)


def _scale(unit: str) -> tuple[float, str]:
    """Factor and unit in which a signal is drawn: g and deg/s, or counts."""
    if unit == "m/s^2":
        return 1.0 / STANDARD_GRAVITY_MPS2, "g"
    factor, shown = SHOWN.get(unit, (1.0, unit))
    return factor, shown_unit(shown)


def _shade(figure: Any, inspection: Inspection) -> None:
    """Draw the rests as bands over all panels, with entries for both colours in the legend."""
    for name, colour, is_excluded in (("rest", BAND, False), ("excluded rest", EXCLUDED, True)):
        own = [rest for rest in inspection.rests if (rest.excluded is not None) == is_excluded][:RESTS]
        for rest in own:
            # The band spans the whole height of the figure, so that one shape is sufficient for all panels.
            figure.add_shape(
                type="rect", xref="x", yref="paper", x0=rest.start_s, x1=rest.end_s, y0=0, y1=1,
                fillcolor=colour, line={"width": 0}, layer="below",
            )  # fmt: skip
        if own:
            figure.add_scatter(
                x=[None], y=[None], name=name, mode="markers",
                marker={"color": colour, "symbol": "square", "size": 12}, row=1, col=1,
            )  # fmt: skip
