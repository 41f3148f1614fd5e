"""The page of a unit's noise: Allan plots and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from imucal import plot
from imucal.plot.style import shown_unit
from imucal.report import sentences
from imucal.report.blocks import finding_texts
from imucal.report.page import Shown, Tab, write_page
from imucal.report.tables import heading, item_list, paragraph, rounded_to, table

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseFigure, NoiseResult

__all__ = ["noise_table", "write_noise_page"]


def write_noise_page(path: str | Path, noise: NoiseResult) -> None:
    """Write the page of one recording's noise.

    Raises ImucalError without plotly, and InputError if the file cannot be written.
    """
    remarks = finding_texts(noise.findings)
    figures = Tab(
        "Figures",
        (
            paragraph(
                "A kind of noise that the recording does not show has no value: the band ends where the "
                "recording excludes it. The Allan deviation of a bias instability is flat at 0.664 of it."
            ),
            noise_table(noise),
            heading("Worth knowing") if remarks else "",
            item_list(remarks),
        ),
    )
    caption = "Overlapping Allan deviation with 95 % bands; lines: the identified noise."
    plots = (
        Tab("Accelerometer", (Shown("allan-accel", plot.allan(noise, "accel"), caption),)),
        Tab("Gyroscope", (Shown("allan-gyro", plot.allan(noise, "gyro"), caption),)),
    )
    write_page(path, f"Noise of {noise.name}", (*plots, figures), sentences.of_noise(noise))


def noise_table(noise: NoiseResult) -> str:
    """Every figure with its 95 % band."""
    rows = [
        [f"{name} {kind.replace('_', ' ')}", *_cells(figure)]
        for name, axis in noise.axes.items()
        for kind, figure in axis.figures.items()
        if kind != "quantisation" or figure.value is not None
    ]
    return table(["", "value", "1 σ", "95 % from", "to", "unit"], rows)


def _cells(figure: NoiseFigure) -> list[str]:
    band = [f"{figure.low:.3g}", f"{figure.high:.3g}", shown_unit(figure.unit)]
    if figure.value is None or figure.std is None:
        return ["not seen", "-", *band]
    return [rounded_to(figure.value, figure.std), f"{figure.std:.2g}", *band]
