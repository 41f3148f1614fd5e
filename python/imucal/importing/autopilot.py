"""The calibration of an autopilot: an offset and a scale per axis, and thermal offsets.

    corrected_accel = (raw - thermal(T) - offset) * scale         for each axis
    corrected_gyro  =  raw - thermal(T) - offset                  old versions of PX4: also * scale

`imucal.exporting.autopilot` converts calibrations of imucal to such offsets and scales.
"""

from __future__ import annotations

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.importing.parameters import Cubic, Thermal
from imucal.importing.source_format import Found, Wanted

__all__ = ["per_axis_found"]


def per_axis_found(
    offsets: dict[str, FloatArray],
    scales: dict[str, FloatArray],
    thermal: dict[str, Cubic],
    wanted: Wanted,
    *,
    notes: tuple[str, ...] = (),
) -> Found:
    """The calibration that corresponds to offsets and scales.

    offsets   by sensor ("accel", "gyro"), raw units
    scales    by sensor, corrected / raw; "gyro" is absent if the autopilot has no gyroscope scale
    thermal   thermal terms by sensor, for sensors whose thermal terms the autopilot applies
    """
    missing = [
        "accel_misalignment",
        "gyro_misalignment",
        *([] if "gyro" in scales else ["gyro_scale"]),
        "noise",
    ]
    scales = {"gyro": np.ones(3), **scales}
    found: list[Thermal] = []
    remarks = list(notes)
    for sensor, cubic in thermal.items():
        if wanted.temperature_degc is not None:
            offsets = {**offsets, sensor: offsets[sensor] + cubic.at(wanted.temperature_degc)}
            continue
        terms = cubic.effect(sensor, scales[sensor])
        offsets = {**offsets, sensor: offsets[sensor] + terms.offset}
        if terms.effect.values.any():
            found.append(terms)
    temperatures = None
    if thermal and wanted.temperature_degc is not None:
        temperatures = (wanted.temperature_degc, wanted.temperature_degc)
        remarks.append(f"the thermal terms are evaluated at {wanted.temperature_degc:g} degC")
    elif found:
        ranges = [cubic.range_degc for cubic in thermal.values()]
        temperatures = max(low for low, _ in ranges), min(high for _, high in ranges)
        if any(terms.definition is None for terms in found):
            remarks.append(
                f"outside {temperatures[0]:g} to {temperatures[1]:g} degC the autopilot keeps the thermal "
                "terms constant, but imucal extrapolates them with a warning"
            )
    return Found(
        Triad(np.diag(1 / scales["accel"]), offsets["accel"]),
        Triad(np.diag(1 / scales["gyro"]), offsets["gyro"]),
        tuple(terms.effect for terms in found),
        tuple(terms.definition for terms in found if terms.definition is not None),
        temperature_range_degc=temperatures,
        missing=tuple(missing if thermal else ["temperature", *missing]),
        notes=tuple(remarks),
    )
