"""Plots of results as plotly figures, for notebooks and for the reports.

    import imucal, imucal.plot
    result = imucal.calibrate(run, control=control)
    imucal.plot.propagated_gravity(result.control, "x").show()
    imucal.plot.coverage(result).write_html("coverage.html")

A figure shows numbers of a result in their units and computes no estimates of its own. If there are more than
360 (`MOST`) rests or moves, a figure shows 360 of them. Figures of residuals preferably show those excluded
from the fit and those with the largest residuals.

plotly comes with the extra `imucal-rs[report]`. Without it, every function raises an `ImucalError` with the
install command.
"""

from imucal.plot.estimates import limits, parameters, sigmas
from imucal.plot.evidence import before_and_after, disagreement, law, ranking
from imucal.plot.fit_quality import (
    correlations,
    histogram,
    largest_correlations,
    norms_before_and_after,
    sphere_before_and_after,
)
from imucal.plot.noise import allan
from imucal.plot.own_motion import dependences, law_points, move_signals, residual_against
from imucal.plot.propagated import propagated_gravity
from imucal.plot.recording import recording_signals
from imucal.plot.residuals import move_residuals, rest_residuals
from imucal.plot.shares import effect_sizes, probabilities, waterfall, waterfall_steps
from imucal.plot.soak import soak
from imucal.plot.sphere import coverage
from imucal.plot.temperature_loop import temperature_loop
from imucal.plot.thinning import MOST

__all__ = [
    "MOST",
    "allan",
    "before_and_after",
    "correlations",
    "coverage",
    "dependences",
    "disagreement",
    "effect_sizes",
    "histogram",
    "largest_correlations",
    "law",
    "law_points",
    "limits",
    "move_residuals",
    "move_signals",
    "norms_before_and_after",
    "parameters",
    "probabilities",
    "propagated_gravity",
    "ranking",
    "recording_signals",
    "residual_against",
    "rest_residuals",
    "sigmas",
    "soak",
    "sphere_before_and_after",
    "temperature_loop",
    "waterfall",
    "waterfall_steps",
]
