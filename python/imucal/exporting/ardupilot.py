"""ArduPilot: the parameters INS_ACCOFFS, INS_ACCSCAL, INS_GYROFFS and INS_TCAL1.

    accel = (raw - p(T) + p(CALTEMP) - ACCOFFS) * ACCSCAL     for each axis
    gyro  =  raw - p(T) + p(CALTEMP) - GYROFFS
    p(T)  = (c1 + (c2 + c3 x) x) x 1e-6,  x = T - 35,  T and CALTEMP clamped to [TMIN, TMAX]

T is the temperature, degC, CALTEMP the temperature at which the offsets are valid, and c1, c2 and c3 are the
coefficients of the axis in INS_TCAL.

Sources in ArduPilot: AP_InertialSensor_Backend.cpp (_rotate_and_correct_accel, _rotate_and_correct_gyro) and
AP_InertialSensor_tempcal.cpp (correct_sensor, polynomial_eval).

ArduPilot then rotates the samples of both sensors by AHRS_ORIENTATION, R, and logs the result: raw_log = R
raw. A calibration from a log is therefore rotated back to the axes of the sensor, where the parameters apply.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.errors import InputError
from imucal.exporting.autopilot import PerAxis, per_axis_model
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.model import FRAMES, turned_axes

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["ARDUPILOT", "NAMES", "PER_UNIT", "POLYNOMIAL_REFERENCE_DEGC", "RANGE_DEGC"]

# Abbreviation of each sensor in the names of the INS_TCAL1 parameters.
NAMES: Final = {"accel": "ACC", "gyro": "GYR"}
# Temperature at which ArduPilot's polynomial is zero, degC (AP_InertialSensor_tempcal.h, TEMP_REFERENCE).
POLYNOMIAL_REFERENCE_DEGC: Final = 35.0
# Extension of dataflash logs, such as 00000012.BIN, in lower case.
LOG_SUFFIX: Final = ".bin"
# ArduPilot stores the INS_TCAL1 coefficients as 1e6 times the SI value.
PER_UNIT: Final = 1e6
# Values of TMIN and TMAX, degC, if the calibration has no temperature range. They are ArduPilot's defaults.
RANGE_DEGC: Final = (0.0, 70.0)


def write(calibration: Calibration, noise: NoiseResult | None, rotation: FloatArray | None = None) -> Written:
    """Write the parameters of the first accelerometer and the first gyroscope, one per line.

    rotation   (3, 3), from the axes of the sensor to those of the recording; None if they are the same
    """
    if rotation is None:
        _require_no_log(calibration)
    back = np.eye(3) if rotation is None else rotation.T
    model = per_axis_model(turned_axes(calibration, back))
    rows: list[tuple[str, float]] = []
    for name, values in (
        ("INS_ACCOFFS", model.accel_offset),
        ("INS_ACCSCAL", model.accel_scale),
        ("INS_GYROFFS", model.gyro_offset),
    ):
        if values is not None:
            rows += [(f"{name}_{axis}", values[i]) for i, axis in enumerate("XYZ")]
    rows += _thermal_rows(model)
    notes = (
        "The recording is assumed to be along the axes of the sensor. ArduPilot applies the parameters "
        "before the rotation AHRS_ORIENTATION, but logs samples after it. If AHRS_ORIENTATION was not 0 in "
        "the log that was calibrated, export with --board-orientation AHRS_ORIENTATION."
        if rotation is None
        else "The recording was rotated by AHRS_ORIENTATION; the parameters are for the axes of the sensor, "
        "before this rotation.",
        "Raw samples are samples without ArduPilot's corrections: record with INS_ACCOFFS and INS_GYROFFS 0, "
        "INS_ACCSCAL 1 and INS_TCAL1_ENABLE 0.",
        "The parameters are for the first sensors. INS_ACC_ID and INS_GYR_ID are not in this file. They must "
        "hold the device IDs of these sensors, otherwise ArduPilot reports them as not calibrated. Running "
        "ArduPilot's calibration once sets them.",
        "The calibration has no gyroscope, so ArduPilot keeps its own gyroscope offsets."
        if model.gyro_offset is None
        else "Set INS_GYR_CAL to 0, otherwise ArduPilot estimates new gyroscope offsets at each start.",
    )
    return Written(
        body="\n".join(f"{name},{number(value, single=True)}" for name, value in rows) + "\n",
        lost=model.lost,
        same_as=turned_axes(model.same_as, back.T),
        frame=FRAMES["symmetric"]
        + (", along the sensor's axes" if rotation is None else ", turned by AHRS_ORIENTATION"),
        notes=(
            *notes,
            *model.thermal_notes,
            *(["CALTEMP is in [TMIN, TMAX], because ArduPilot clamps it."] if model.thermal else []),
        ),
    )


def _require_no_log(calibration: Calibration) -> None:
    """Raises InputError for a calibration from a dataflash log, because its samples may be rotated."""
    for source in calibration.provenance.files:
        if source.path.lower().endswith(LOG_SUFFIX):
            raise InputError(
                f"the calibration is of {source.path}: ArduPilot logs samples after the rotation "
                "AHRS_ORIENTATION, but applies its parameters before this rotation: give "
                "--board-orientation with the value of AHRS_ORIENTATION, 0 if the board is not rotated "
                "(`imucal inspect` shows any other value)"
            )


def _thermal_rows(model: PerAxis) -> Iterable[tuple[str, float]]:
    """INS_TCAL1 parameters of both sensors.

    INS_TCAL1_ENABLE enables the terms of both sensors, so a sensor without thermal terms gets zeros.
    """
    if not model.thermal:
        return
    reference = _core.REFERENCE_TEMPERATURE_DEGC
    low, high = model.range_degc(RANGE_DEGC)
    yield "INS_TCAL1_ENABLE", 1.0
    # ArduPilot also clamps CALTEMP to [TMIN, TMAX], so the range must include the reference temperature.
    yield "INS_TCAL1_TMIN", min(low, reference)
    yield "INS_TCAL1_TMAX", max(high, reference)
    for sensor, name in NAMES.items():
        yield f"INS_{name}1_CALTEMP", reference
        thermal = model.thermal.get(sensor)
        for i, axis in enumerate("XYZ"):
            linear = square = cube = 0.0
            if thermal is not None:
                # The polynomial k d + q d^2 + c d^3 of the effect, with d = T - reference, is expanded around
                # 35 degC. Its constant term is not needed, because it cancels in p(CALTEMP) - p(T).
                moved = POLYNOMIAL_REFERENCE_DEGC - reference
                cube = thermal.cube[i]
                square = thermal.square[i] + 3 * cube * moved
                linear = thermal.linear[i] + 2 * thermal.square[i] * moved + 3 * cube * moved**2
            for power, value in ((1, linear), (2, square), (3, cube)):
                yield f"INS_TCAL1_{name}{power}_{axis}", PER_UNIT * value


def oriented(rotation: FloatArray) -> Format:
    """The export format for recordings whose samples ArduPilot has rotated by this board rotation."""
    return replace(ARDUPILOT, write=partial(write, rotation=rotation))


ARDUPILOT = Format(
    name="ardupilot",
    title="ArduPilot parameters",
    suffix=".param",
    formula="accel = (raw - p(T) + p(CALTEMP) - ACCOFFS) * ACCSCAL, gyro = raw - p(T) + p(CALTEMP) - GYROFFS",
    source="ArduPilot, AP_InertialSensor_Backend.cpp and AP_InertialSensor_tempcal.cpp",
    units=SI + ", parameters are float32",
    includes="bias of both sensors, scale of the accelerometer, *_bias_temperature",
    omits="misalignment of both sensors, scale of the gyroscope, all other effects",
    layout=line_comments("#"),
    write=write,
    needs_gyroscope=False,
    oriented=oriented,
)
