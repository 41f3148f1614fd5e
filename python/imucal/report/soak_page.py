"""The report of a temperature soak (a unit at rest in one pose): how the biases depend on temperature."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import imucal.plot as plot
from imucal.report.meaning import meanings
from imucal.report.page import Shown, Tab, Verdict, write_page
from imucal.report.tables import paragraph, parameter_table

if TYPE_CHECKING:
    from imucal.gap.soak_result import Soak, SoakedSensor

__all__ = ["write_soak_page"]


def write_soak_page(path: str | Path, found: Soak) -> None:
    """Write the report of a soak.

    Raises ImucalError if plotly is not installed, and InputError if the file cannot be written.
    """
    tabs = [_tab(found, sensor) for sensor in found.sensors]
    names = [sensor.described for sensor in found.sensors if sensor.terms]
    sentence = (
        f"The biases depend on temperature: {', '.join(names)}." if names else "The biases are constant."
    )
    left = "; ".join(
        f"{sensor.sensor} {', '.join(f'{100 * share:.0f}' for share in sensor.left)} % (x, y, z)"
        for sensor in found.sensors
    )
    beside = f"Residual on held-out epochs, relative to that of one cubic in the temperature: {left}."
    write_page(path, f"Soak {found.name}", tabs, Verdict("found" if names else "good", sentence, beside))


def _tab(found: Soak, sensor: SoakedSensor) -> Tab:
    return Tab(
        sensor.sensor.capitalize(),
        (
            Shown(
                f"law-{sensor.sensor}",
                plot.soak(found, sensor),
                "Mean reading of each epoch over temperature, relative to the reference temperature. A loop "
                "between heating and cooling is a lag or hysteresis.",
            ),
            Shown(
                f"residuals-{sensor.sensor}",
                plot.soak(found, sensor, "time"),
                "Residuals of one cubic in the temperature, and of the model.",
            ),
            parameter_table(sensor.parameters)
            if sensor.terms
            else paragraph("The reading does not depend on temperature beyond its scatter."),
            *meanings([term.name for term in sensor.terms]),
        ),
    )
