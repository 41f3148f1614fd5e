"""Reports: one self-contained HTML page, readable without network, on a phone, in the dark and on paper.

Figures need plotly, an optional dependency: it is imported when a figure is made, and a missing one is an
`ImucalError` that says how to install it. Nothing here computes results; it shows what it is given.
"""

from imucal.report.calibration_page import write_calibration_page
from imucal.report.figures import carried_gravity_figure
from imucal.report.noise_page import allan_figure, write_noise_page
from imucal.report.page import Section, write_page
from imucal.report.tables import judgement_table, parameter_table, table

__all__ = [
    "Section",
    "allan_figure",
    "carried_gravity_figure",
    "judgement_table",
    "parameter_table",
    "table",
    "write_calibration_page",
    "write_noise_page",
    "write_page",
]
