"""PX4: the parameters CAL_ACC0, CAL_GYRO0, TC_A0 and TC_G0, as QGroundControl loads them.

corrected_accel = (data - thermal_offset - offset).emult(scale)     sensor_calibration/Accelerometer.hpp
corrected_gyro  =  data - thermal_offset - offset                   sensor_calibration/Gyroscope.hpp
thermal_offset  = x0 + x1 dT + x2 dT^2 + x3 dT^3, dT = T - TREF, T clamped to [TMIN, TMAX]
                                    TemperatureCompensation.cpp, calc_thermal_offsets_3D

`data` are raw samples, T is the temperature, degC, x0 to x3 are the coefficients of the axis, and emult is
the product axis by axis.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.exporting.autopilot import PerAxis, per_axis_model
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.model import FRAMES

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["LETTERS", "PX4", "RANGE_DEGC"]

# Parameter types in QGroundControl's parameter files (MAV_PARAM_TYPE of MAVLink).
INT32: Final = 6
REAL32: Final = 9
# Letter of each sensor in the names of the TC_ parameters.
LETTERS: Final = {"accel": "A", "gyro": "G"}
# Values of TMIN and TMAX, degC, if the calibration has no temperature range. They are PX4's defaults.
RANGE_DEGC: Final = (0.0, 100.0)


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the parameters of the first accelerometer and the first gyroscope, one per line."""
    model = per_axis_model(calibration)
    rows: list[tuple[str, float | int]] = []
    for i, axis in enumerate("XYZ"):
        rows.append((f"CAL_ACC0_{axis}OFF", model.accel_offset[i]))
        rows.append((f"CAL_ACC0_{axis}SCALE", model.accel_scale[i]))
    if model.gyro_offset is not None:
        rows += [(f"CAL_GYRO0_{axis}OFF", model.gyro_offset[i]) for i, axis in enumerate("XYZ")]
    rows += _thermal_rows(model)
    notes = [
        "Raw samples are samples without PX4's corrections: the topics sensor_accel and sensor_gyro.",
        "The parameters are for the first sensors; for other sensors replace the 0 in the names by their "
        "number. CAL_ACC0_ID and CAL_GYRO0_ID are not in this file. They must hold the device IDs of these "
        "sensors.",
        "Set SENS_IMU_AUTOCAL to 0, otherwise PX4 replaces the offsets of both sensors by those that "
        "its estimator learns in flight. Set IMU_GYRO_CAL_EN to 0, otherwise it estimates new "
        "gyroscope offsets at rest.",
    ]
    if model.thermal:
        slots = ", ".join(f"TC_{LETTERS[sensor]}0_ID" for sensor in model.thermal)
        notes.append(f"Set {slots} to the same device IDs, otherwise PX4 ignores the thermal terms.")
    body = "\n".join(
        f"1\t1\t{name}\t{value}\t{INT32}"
        if isinstance(value, int)
        else f"1\t1\t{name}\t{number(value, single=True)}\t{REAL32}"
        for name, value in rows
    )
    return Written(
        body=f"#\n# Vehicle-Id Component-Id Name Value Type\n{body}\n",
        lost=model.lost,
        same_as=model.same_as,
        frame=FRAMES["symmetric"] + ", along the sensor's axes",
        notes=(*notes, *model.thermal_notes),
    )


def _thermal_rows(model: PerAxis) -> Iterable[tuple[str, float | int]]:
    low, high = model.range_degc(RANGE_DEGC)
    for sensor, thermal in model.thermal.items():
        letter = LETTERS[sensor]
        yield f"TC_{letter}_ENABLE", 1
        for power, values in ((3, thermal.cube), (2, thermal.square), (1, thermal.linear), (0, (0.0,) * 3)):
            yield from ((f"TC_{letter}0_X{power}_{i}", value) for i, value in enumerate(values))
        yield f"TC_{letter}0_TREF", _core.REFERENCE_TEMPERATURE_DEGC
        yield f"TC_{letter}0_TMIN", low
        yield f"TC_{letter}0_TMAX", high


PX4 = Format(
    name="px4",
    title="PX4 parameters",
    suffix=".params",
    formula="accel = (raw - thermal - OFF) * SCALE, gyro = raw - thermal - OFF, for each axis",
    source="PX4-Autopilot, Accelerometer.hpp, Gyroscope.hpp and TemperatureCompensation.cpp",
    units=SI + ", parameters are float32",
    includes="bias of both sensors, scale of the accelerometer, *_bias_temperature",
    omits="misalignment of both sensors, scale of the gyroscope, all other effects",
    layout=line_comments("#"),
    write=write,
    needs_gyroscope=False,
)
