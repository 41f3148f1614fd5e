"""Plots of results as plotly figures, for notebooks and for the reports.

    import imucal, imucal.plot
    result = imucal.calibrate(run, control=control)
    imucal.plot.propagated_gravity(result.control, "x").show()
    imucal.plot.coverage(result).write_html("coverage.html")

A figure shows numbers of a result in their units and computes no estimates of its own. If there are more than
`MOST` rests or moves, some are omitted, but never those excluded from the fit or those with the largest
residuals.

plotly comes with the extra `imucal-rs[report]`. Without it, every function raises an `ImucalError` with the
install command.
"""

from imucal.plot.estimates import limits, parameters, sigmas
from imucal.plot.evidence import before_and_after, disagreement, law, ranking
from imucal.plot.noise import allan
from imucal.plot.own_motion import dependences, law_points, move_signals, residual_against
from imucal.plot.propagated import propagated_gravity
from imucal.plot.residuals import move_residuals, rest_residuals
from imucal.plot.shares import effect_sizes, probabilities, waterfall, waterfall_steps
from imucal.plot.soak import soak_law, soak_residuals
from imucal.plot.sphere import coverage
from imucal.plot.thinning import MOST

__all__ = [
    "MOST",
    "allan",
    "before_and_after",
    "coverage",
    "dependences",
    "disagreement",
    "effect_sizes",
    "law",
    "law_points",
    "limits",
    "move_residuals",
    "move_signals",
    "parameters",
    "probabilities",
    "propagated_gravity",
    "ranking",
    "residual_against",
    "rest_residuals",
    "sigmas",
    "soak_law",
    "soak_residuals",
    "waterfall",
    "waterfall_steps",
]
