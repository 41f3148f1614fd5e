"""Figures of results, as plotly figures: for notebooks, and the same ones that the reports show.

    import imucal, imucal.plot
    result = imucal.calibrate(run, control=control)
    imucal.plot.carried_gravity(result.control, "x").show()
    imucal.plot.coverage(result).write_html("coverage.html")

A figure shows numbers of the result that it is given, in their units, and estimates none. Rests and moves
beyond `MOST` are thinned: what is left out of the fit and the largest residuals stay.

plotly comes with the extra `imucal-rs[report]`; without it every function raises an `ImucalError` that says
so.
"""

from imucal.plot.carried import carried_gravity
from imucal.plot.estimates import limits, parameters, sigmas
from imucal.plot.evidence import before_and_after, disagreement, ranking
from imucal.plot.noise import allan
from imucal.plot.residuals import move_residuals, rest_residuals
from imucal.plot.sphere import coverage
from imucal.plot.thinning import MOST

__all__ = [
    "MOST",
    "allan",
    "before_and_after",
    "carried_gravity",
    "coverage",
    "disagreement",
    "limits",
    "move_residuals",
    "parameters",
    "ranking",
    "rest_residuals",
    "sigmas",
]
