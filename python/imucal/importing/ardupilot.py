"""ArduPilot: the parameters INS_ACCOFFS, INS_ACCSCAL, INS_GYROFFS and INS_TCAL of a parameter file.

    accel = (raw - p(T) + p(CALTEMP) - ACCOFFS) * ACCSCAL     for each axis
    gyro  =  raw - p(T) + p(CALTEMP) - GYROFFS
    p(T)  = (c1 + (c2 + c3 x) x) x 1e-6,  x = T - 35,  T and CALTEMP clamped to [TMIN, TMAX]

T is the temperature, degC, CALTEMP the temperature at which the offsets are valid, and c1, c2 and c3 are the
coefficients of the axis in INS_TCAL.

Sources in ArduPilot: AP_InertialSensor_Backend.cpp (_rotate_and_correct_accel, _rotate_and_correct_gyro) and
AP_InertialSensor_tempcal.cpp (correct_sensor, polynomial_eval). ArduPilot then rotates the samples of both
sensors by AHRS_ORIENTATION. `imucal.exporting.ardupilot` writes these parameters.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.exporting.ardupilot import NAMES, PER_UNIT, POLYNOMIAL_REFERENCE_DEGC, RANGE_DEGC
from imucal.importing.autopilot import per_axis_found
from imucal.importing.parameters import Cubic, Parameters, has_parameters
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["ARDUPILOT"]

# Number of each sensor in the names of its parameters, such as INS_ACC2OFFS_X. The first sensor has no
# number.
NUMBERS: Final = ("", "2", "3")
# Value of INS_TCAL_ENABLE with which ArduPilot applies the thermal terms. With the value 2 ArduPilot
# estimates the terms.
APPLIED: Final = 1.0
# Default value of INS_ACC_CALTEMP and INS_GYR_CALTEMP, degC. It means "not set", and ArduPilot replaces it by
# TMIN.
NO_CALTEMP_DEGC: Final = -300.0


def recognises(content: Content) -> bool:
    """Whether the file has calibration parameters of ArduPilot."""
    return content.document is None and has_parameters(content.text, ("INS_ACC", "INS_GYR", "INS_TCAL"))


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of the accelerometer and of the gyroscope with the number `instance`, from 0."""
    parameters = Parameters.of(contents[0])
    if not wanted.instance < len(NUMBERS):
        raise InputError(
            f"instance is {wanted.instance}: parameter files of ArduPilot have the sensors 0 to 2"
        )
    number = NUMBERS[wanted.instance]
    # ArduPilot's names of the gyroscope offsets are INS_GYROFFS for the first sensor, and INS_GYR2OFFS and
    # INS_GYR3OFFS for the second and third.
    offsets = {
        "accel": parameters.vector(f"INS_ACC{number}OFFS_{{}}"),
        "gyro": parameters.vector(f"INS_GYR{number}OFFS_{{}}" if number else "INS_GYROFFS_{}"),
    }
    scale = parameters.scale(f"INS_ACC{number}SCAL_{{}}")
    notes = ["raw samples are those without ArduPilot's corrections"]
    if not offsets["accel"].any() and (scale == 1).all():
        notes.append("all values of the accelerometer are ArduPilot's defaults: it has not been calibrated")
    if orientation := parameters.number("AHRS_ORIENTATION", 0.0):
        notes.append(
            "corrected samples are along the axes of the sensor; ArduPilot then rotates them "
            f"(AHRS_ORIENTATION {orientation:g})"
        )
    thermal = {}
    if parameters.number(f"INS_TCAL{wanted.instance + 1}_ENABLE", 0.0) == APPLIED:
        thermal = {sensor: _thermal(parameters, sensor, wanted.instance + 1) for sensor in NAMES}
    return per_axis_found(offsets, {"accel": scale}, thermal, wanted, notes=tuple(notes))


def _thermal(parameters: Parameters, sensor: str, number: int) -> Cubic:
    """The polynomial p(T) - p(CALTEMP), whose constant term is -p(CALTEMP)."""
    group, name = f"INS_TCAL{number}", NAMES[sensor]
    powers: list[FloatArray] = [parameters.vector(f"{group}_{name}{k}_{{}}") / PER_UNIT for k in (1, 2, 3)]
    limits = (
        parameters.number(f"{group}_TMIN", RANGE_DEGC[0]),
        parameters.number(f"{group}_TMAX", RANGE_DEGC[1]),
    )
    cubic = Cubic(np.array([np.zeros(3), *powers]), POLYNOMIAL_REFERENCE_DEGC, limits)
    at_calibration = cubic.at(parameters.number(f"INS_{name}{number}_CALTEMP", NO_CALTEMP_DEGC))
    return Cubic(np.array([-at_calibration, *powers]), cubic.reference_degc, limits)


ARDUPILOT: Final = Reader(
    name="ardupilot",
    title="ArduPilot: parameter file (.param, .parm) of a ground station",
    program="ArduPilot",
    formula="accel = (raw - p(T) + p(CALTEMP) - ACCOFFS) * ACCSCAL, gyro = raw - p(T) + p(CALTEMP) - GYROFFS",
    source="ArduPilot, AP_InertialSensor_Backend.cpp and AP_InertialSensor_tempcal.cpp",
    recognises=recognises,
    read=read,
    without="misalignment, scale of the gyroscope, covariance, noise",
)
