"""The report of a unit's noise: Allan plots and noise figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import imucal.plot as plot
import imucal.report.sentences as sentences
from imucal.plot.style import shown_unit
from imucal.report.blocks import finding_texts
from imucal.report.page import Shown, Tab, write_page
from imucal.report.tables import heading, item_list, paragraph, rounded_to, table

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseFigure, NoiseResult

__all__ = ["noise_table", "write_noise_page"]


def write_noise_page(path: str | Path, noise: NoiseResult) -> None:
    """Write the report of the noise in one recording.

    Raises ImucalError if plotly is not installed, and InputError if the file cannot be written.
    """
    remarks = finding_texts(noise.findings)
    figures = Tab(
        "Figures",
        (
            paragraph(
                "Noise that is not detectable in the recording has no value; its interval ends at the upper "
                "bound. Bias instability gives a flat Allan deviation of 0.664 times its value."
            ),
            noise_table(noise),
            heading("Notes") if remarks else "",
            item_list(remarks),
        ),
    )
    caption = (
        "Overlapping Allan deviation with 95 % confidence intervals; curves: the identified noise model. "
        "Straight lines: the detected components of the model, white noise N, bias instability B and random "
        "walk K. Stars: N is the value of its line at 1 s, K at 3 s, and B is the flat part divided by 0.664."
    )
    sensors: tuple[tuple[Literal["accel", "gyro"], str], ...] = (
        ("accel", "Accelerometer"),
        ("gyro", "Gyroscope"),
    )
    plots = tuple(
        Tab(title, (Shown(f"allan-{sensor}", plot.allan(noise, sensor), caption),))
        for sensor, title in sensors
        if noise.has(sensor)
    )
    write_page(path, f"Noise of {noise.name}", (*plots, figures), sentences.of_noise(noise))


def noise_table(noise: NoiseResult) -> str:
    """Every noise figure with its 95 % confidence interval."""
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
        return ["not detected", "-", *band]
    return [rounded_to(figure.value, figure.std), f"{figure.std:.2g}", *band]
