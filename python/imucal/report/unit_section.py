"""Section on one unit of a fleet: its measurements, and its parameters compared with the fleet."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from imucal.plot.style import shown_unit
from imucal.report.tables import rounded_to, shown_name, table
from imucal.units import datasheet

if TYPE_CHECKING:
    from imucal.fleet.measurements import Measurements
    from imucal.fleet.statistics.outliers import UnitDistance

__all__ = ["unit_section"]


def unit_section(measured: Measurements, serial: str, distance: UnitDistance | None) -> str:
    """A collapsed section on the unit `serial`, with the anchor unit-SERIAL for links.

    distance   distance of the unit from the other units, or None if it is not known
    """
    own = measured.where(measured.serials == serial)
    dates = [
        [
            "-" if np.isnat(date) else str(np.datetime_as_string(date)).replace("T", " "),
            str(station) or "-",
            str(operator) or "-",
            str(verdict),
        ]
        for date, station, operator, verdict in zip(
            own.dates, own.stations, own.operators, own.verdicts, strict=True
        )
    ]
    median = np.nanmedian(measured.values_si, axis=0) if len(measured.names) else np.zeros(0)
    rows = []
    for column, (name, unit) in enumerate(zip(own.names, own.units, strict=True)):
        if np.isfinite(own.values_si[-1, column]):
            scale = datasheet(name, unit)
            std = abs(scale.factor) * float(own.sigmas_si[-1, column])
            value, middle = (scale.shown(float(of)) for of in (own.values_si[-1, column], median[column]))
            rows.append(
                [
                    shown_name(name, scale),
                    *(rounded_to(each, std) for each in (value, std, middle)),
                    shown_unit(scale.unit) or "1",
                ]
            )
    words = ""
    if distance is not None and distance.decides:
        decides = ", ".join(f"{item.name} ({item.z:+.1f} sigma)" for item in distance.decides)
        words = (
            f"<p>distance {distance.distance:.1f}, false discovery rate {distance.q_value:.2g}: "
            f"{escape(decides)}</p>"
        )
    return (
        f'<details id="unit-{escape(serial)}"><summary>{escape(serial)}</summary>\n{words}'
        + table(["date", "station", "operator", "verdict"], dates, words=(1, 2, 3))
        + table(["last calibration", "value", "1 σ", "median of the fleet", "unit"], rows)
        + "</details>"
    )
