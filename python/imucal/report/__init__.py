"""Reports: one self-contained HTML page, readable without network, on a phone, in the dark and on paper.

    write_calibration_page("unit-0042.html", imucal.calibrate(run, control=control))

A page shows what the command's JSON holds and estimates nothing. Its figures are those of `imucal.plot` and
need plotly, an optional dependency: without it there is an `ImucalError` that says how to install it.
"""

from imucal.report.calibration_page import write_calibration_page, write_evaluation_page
from imucal.report.gap_page import write_gap_page
from imucal.report.noise_page import write_noise_page
from imucal.report.page import require_plotly

__all__ = [
    "require_plotly",
    "write_calibration_page",
    "write_evaluation_page",
    "write_gap_page",
    "write_noise_page",
]
