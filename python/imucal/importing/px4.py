"""PX4: the parameters CAL_ACC, CAL_GYRO and TC_ of a parameter file.

    corrected_accel = (data - thermal_offset - offset) * scale    Accelerometer.hpp, Correct
    corrected_gyro  =  data - thermal_offset - offset             Gyroscope.hpp, Correct
    thermal_offset  =  x0 + x1 dT + x2 dT^2 + x3 dT^3             TemperatureCompensation.cpp,
                       dT = T - TREF, T clamped to [TMIN, TMAX]   calc_thermal_offsets_3D

`data` are raw samples, T is the temperature, degC, and x0 to x3 are the coefficients of the axis. Old
versions also scale the gyroscope (CAL_GYRO0_XSCALE). PX4 then rotates the samples of both sensors to the
axes of the board, by CAL_*_ROT or SENS_BOARD_ROT. `imucal.exporting.px4` writes these parameters.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.errors import InputError
from imucal.exporting.px4 import LETTERS, RANGE_DEGC
from imucal.importing.autopilot import per_axis_found
from imucal.importing.parameters import Cubic, Parameters, has_parameters
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["PX4"]

SENSORS: Final = {"accel": "ACC", "gyro": "GYRO"}
# Slots (TC_A0, ... TC_A3) that can hold the thermal terms of a sensor.
SLOTS: Final = range(4)


def recognises(content: Content) -> bool:
    """Whether the file has calibration parameters of PX4."""
    return content.document is None and has_parameters(content.text, ("CAL_ACC", "CAL_GYRO"))


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of the accelerometer and of the gyroscope with the number `instance`."""
    parameters = Parameters.of(contents[0])
    n = wanted.instance
    for name in SENSORS.values():
        if parameters.number(f"CAL_{name}{n}_ID", 1.0) == 0:
            raise InputError(
                f"{parameters.file}: CAL_{name}{n}_ID is 0: PX4 has no calibration of this sensor"
            )
    scales = {"accel": parameters.scale(f"CAL_ACC{n}_{{}}SCALE")}
    if f"CAL_GYRO{n}_XSCALE" in parameters.values:
        scales["gyro"] = parameters.scale(f"CAL_GYRO{n}_{{}}SCALE")
    return per_axis_found(
        {sensor: parameters.vector(f"CAL_{name}{n}_{{}}OFF") for sensor, name in SENSORS.items()},
        scales,
        {sensor: cubic for sensor in SENSORS if (cubic := _thermal(parameters, sensor, n)) is not None},
        wanted,
        notes=_notes(parameters, n),
    )


def _thermal(parameters: Parameters, sensor: str, n: int) -> Cubic | None:
    """The thermal terms of sensor n; None if PX4 does not apply any to this sensor.

    The terms are in the slot that has the device ID of the sensor, or in slot n if the file has no IDs.
    """
    letter = LETTERS[sensor]
    if parameters.number(f"TC_{letter}_ENABLE", 0.0) != 1:
        return None
    device = parameters.values.get(f"CAL_{SENSORS[sensor]}{n}_ID")
    ids = {slot: parameters.values.get(f"TC_{letter}{slot}_ID") for slot in SLOTS}
    slots = [slot for slot, found in ids.items() if device is not None and found == device]
    if not slots and (device is not None and any(ids.values())):
        return None
    slot = f"TC_{letter}{slots[0] if slots else n}"
    if (parameters.vector(f"{slot}_SCL_{{}}", "012", 1.0) != 1.0).any():
        raise InputError(
            f"{parameters.file}: {slot}_SCL is not 1: this thermal scale of old versions of PX4 is not read; "
            "set it to 1 if your version ignores it"
        )
    return Cubic(
        np.array([parameters.vector(f"{slot}_X{power}_{{}}", "012") for power in range(4)]),
        parameters.number(f"{slot}_TREF"),
        (parameters.number(f"{slot}_TMIN", RANGE_DEGC[0]), parameters.number(f"{slot}_TMAX", RANGE_DEGC[1])),
    )


def _notes(parameters: Parameters, n: int) -> tuple[str, ...]:
    rotations = {name: parameters.number(f"CAL_{name}{n}_ROT", -1.0) for name in SENSORS.values()}
    if len(set(rotations.values())) > 1:
        raise InputError(
            f"{parameters.file}: CAL_ACC{n}_ROT is {rotations['ACC']:g} and CAL_GYRO{n}_ROT is "
            f"{rotations['GYRO']:g}: the two sensors have different axes; correct the wrong one"
        )
    notes = ["raw samples are those of the topics sensor_accel and sensor_gyro"]
    board = parameters.number("SENS_BOARD_ROT", 0.0)
    if rotations["ACC"] > 0 or board > 0:
        name = f"CAL_ACC{n}_ROT {rotations['ACC']:g}" if rotations["ACC"] > 0 else f"SENS_BOARD_ROT {board:g}"
        notes.append(
            f"corrected samples are along the axes of the sensor; PX4 then rotates them to the board ({name})"
        )
    others = [i for i in range(4) if i != n and parameters.number(f"CAL_ACC{i}_ID", 0.0) != 0]
    if others:
        notes.append(
            f"the file also has the sensors {', '.join(map(str, others))}: "
            f"instance={others[0]} reads the first of them"
        )
    return tuple(notes)


PX4: Final = Reader(
    name="px4",
    title="PX4: parameter file (QGroundControl), `param save` or `param show` as text",
    program="PX4",
    formula="accel = (raw - thermal - OFF) * SCALE, gyro = raw - thermal - OFF, for each axis",
    source="PX4-Autopilot, Accelerometer.hpp, Gyroscope.hpp and TemperatureCompensation.cpp",
    recognises=recognises,
    read=read,
    without="misalignment, scale of the gyroscope, covariance, noise",
)
