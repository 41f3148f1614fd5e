"""Reports: one self-contained HTML page, readable offline, on a phone, in a dark theme and on paper.

    write_calibration_page("unit-0042.html", imucal.calibrate(run, control=control))

A page shows the numbers of the command's JSON and computes no estimates of its own. Its figures are those of
`imucal.plot`, which need the optional dependency plotly. Without it, an `ImucalError` gives the install
command.
"""

from imucal.report.calibration_page import write_calibration_page, write_evaluation_page
from imucal.report.certificate import calibration_hash, write_certificate
from imucal.report.fleet_page import write_fleet_page
from imucal.report.gap_page import write_gap_page
from imucal.report.inspection_page import write_inspection_page
from imucal.report.noise_page import write_noise_page
from imucal.report.page import require_plotly
from imucal.report.soak_page import write_soak_page

__all__ = [
    "calibration_hash",
    "require_plotly",
    "write_calibration_page",
    "write_certificate",
    "write_evaluation_page",
    "write_fleet_page",
    "write_gap_page",
    "write_inspection_page",
    "write_noise_page",
    "write_soak_page",
]
