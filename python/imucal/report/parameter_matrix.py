"""Overview of the parameters of a calibration, with one row per kind and one column per axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucal.plot.style import shown_unit
from imucal.report.tables import rounded_to, table
from imucal.units import datasheet

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.calibration.triad import Parameter

__all__ = ["parameter_matrix"]

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}


def parameter_matrix(calibration: Calibration) -> str:
    """HTML tables of biases, scales and misalignments in the units of datasheets."""
    known = {parameter.name: parameter for parameter in calibration.parameters}
    on_axes, between = [], []
    for prefix, sensor in SENSORS.items():
        for kind, names in (
            ("bias", [f"{prefix}_bias_{a}" for a in "xyz"]),
            ("scale", [f"{prefix}_sensitivity_{a}{a}" for a in "xyz"]),
        ):
            if names[0] not in known:
                continue
            unit = _unit(known[names[0]])
            # For raw samples in SI units, a scale is shown as its difference from 1.
            words = "scale error" if unit == "ppm" else kind
            on_axes.append([f"{sensor} {words}, {unit}", *(_cell(known[name]) for name in names)])
        pairs = ("xy", "xz", "yz", "yx", "zx", "zy")
        off = {pair: known.get(f"{prefix}_sensitivity_{pair}") for pair in pairs}
        if off["xy"] is not None:
            cells = [_cell(p) if p is not None else "" for p in off.values()]
            between.append([f"{sensor} misalignment, {_unit(off['xy'])}", *cells])
    matrices = table(["parameter ± 1 σ", "x", "y", "z"], on_axes)
    if between:
        matrices += table(["", "xy", "xz", "yz", "yx", "zx", "zy"], between)
    # In print, the class `span` makes the tables as wide as the page.
    return f'<div class="span">{matrices}</div>'


def _unit(parameter: Parameter) -> str:
    return shown_unit(datasheet(parameter.name, parameter.unit).unit) or "1"


def _cell(parameter: Parameter) -> str:
    scale = datasheet(parameter.name, parameter.unit)
    value = scale.shown(parameter.value)
    if not parameter.std:
        return f"{value:.5g}"
    std = abs(scale.factor) * parameter.std
    return f"{rounded_to(value, std)} ± {rounded_to(std, std)}"
