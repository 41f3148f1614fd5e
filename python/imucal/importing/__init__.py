"""Import of calibrations of other programs: estimators, cameras, autopilots and calibration packages.

    calibration = imucal.read_calibration("imu.yaml")
    calibration.provenance.imported.missing      # what the file does not state

The result corrects samples exactly as the other program does, in the body frame of that program. Parts of a
calibration that a file does not state, such as the covariance, are absent in the result and listed in
`missing`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import as_rows
from imucal.calibration.calibration import Calibration
from imucal.calibration.provenance import Imported, Provenance
from imucal.calibration.references import References
from imucal.calibration.triad import Frame, Triad, frame_of
from imucal.errors import FormatError, InputError
from imucal.importing.ardupilot import ARDUPILOT
from imucal.importing.basalt import BASALT
from imucal.importing.content import content_of
from imucal.importing.ferraris import FERRARIS
from imucal.importing.imu_tk import IMU_TK
from imucal.importing.inav import INAV
from imucal.importing.kalibr import KALIBR
from imucal.importing.openvins import OPENVINS
from imucal.importing.px4 import PX4
from imucal.importing.realsense import IMU_INFO, REALSENSE
from imucal.importing.realsense_table import REALSENSE_TABLE
from imucal.importing.ros import ROS
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["READERS", "Reader", "read_calibration", "readers_markdown"]

READERS: Final[dict[str, Reader]] = {
    reader.name: reader
    for reader in (
        KALIBR,
        OPENVINS,
        BASALT,
        REALSENSE,
        REALSENSE_TABLE,
        IMU_INFO,
        ROS,
        PX4,
        ARDUPILOT,
        INAV,
        IMU_TK,
        FERRARIS,
    )
}


def read_calibration(
    *paths: str | os.PathLike[str],
    format: str | None = None,
    instance: int = 0,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
    accel_bias: ArrayLike | None = None,
    gyro_bias: ArrayLike | None = None,
    temperature_degc: float | None = None,
    accel_lsb_per_g: float | None = None,
    gyro_lsb_per_dps: float | None = None,
    serial_number: str | None = None,
) -> Calibration:
    """Read a calibration of another program, or a calibration file of imucal.

    paths         path of the file; for imu_tk and IMUInfo, the paths of the files of accelerometer and
                  gyroscope
    format        a name from `imucal import --list`; default: recognised from the contents
    instance      index of the sensor in a file with several sensors, from 0
    accel_unit, gyro_unit   raw units, for imu_tk and Ferraris: m/s^2, g, mg, rad/s, deg/s, mdeg/s or lsb
    accel_bias, gyro_bias   (3,) biases in raw units, for files without biases, such as those of Kalibr
    temperature_degc        evaluate the thermal terms of PX4 and ArduPilot at this temperature
    accel_lsb_per_g, gyro_lsb_per_dps   resolution of INAV's driver of the sensor, counts per g and per deg/s;
                            default: 2048 and 16.4
    serial_number           serial number of the unit

    The result has no covariance, and `provenance.imported` lists all that the files do not state.

    Raises InputError if a file cannot be read or several formats are possible. Raises FormatError with the
    name of the field if a file is damaged or incomplete.
    """
    if not paths:
        raise InputError("no file is given: give the file of a calibration")
    if isinstance(instance, bool) or not isinstance(instance, int) or instance < 0:
        raise InputError(f"instance is {instance!r}: a whole number from 0 is needed")
    if temperature_degc is not None and not np.isfinite(temperature_degc):
        raise InputError(f"temperature_degc is {temperature_degc}: a finite number is needed")
    for name, value in (("accel_lsb_per_g", accel_lsb_per_g), ("gyro_lsb_per_dps", gyro_lsb_per_dps)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}: a positive number is needed")
    contents = tuple(map(content_of, paths))
    if format is None and len(paths) == 1 and "schema" in contents[0].fields:
        return Calibration.load(paths[0])
    reader = _reader(contents, format)
    if not reader.scaled and (accel_lsb_per_g is not None or gyro_lsb_per_dps is not None):
        raise InputError(
            f"{reader.name} does not use the resolution: remove accel_lsb_per_g and gyro_lsb_per_dps"
        )
    wanted = Wanted(instance, accel_unit, gyro_unit, temperature_degc, accel_lsb_per_g, gyro_lsb_per_dps)
    names = " and ".join(content.name for content in contents)
    try:
        found = reader.read(contents, wanted)
    except InputError as error:
        # An InputError about an invalid sensitivity, such as a singular matrix, means that the values in the
        # file are invalid, so it is converted to a FormatError.
        if str(error).startswith("the sensitivity"):
            raise FormatError(f"{names}: {error}") from None
        raise
    except np.linalg.LinAlgError:
        raise FormatError(
            f"{names}: a matrix is singular, so an axis is missing: the file is damaged, export it again"
        ) from None
    found = _with_bias(_with_bias(found, "accel", accel_bias, names), "gyro", gyro_bias, names)
    return _calibration(reader, contents, found, serial_number)


def _reader(contents: Sequence[Content], format: str | None) -> Reader:
    """The format of the files. Raises InputError or FormatError if it is unknown or ambiguous."""
    names = ", ".join(READERS)
    if format is not None:
        if format not in READERS:
            raise InputError(f"there is no format {format!r}: give one of {names}")
        reader = READERS[format]
        for content in contents:
            if not reader.recognises(content):
                raise FormatError(f"{content.name} is no file of {reader.title}: required fields are missing")
    else:
        fitting = [reader for reader in READERS.values() if all(map(reader.recognises, contents))]
        if len(fitting) > 1:
            raise InputError(
                f"{contents[0].name} may be of {' or '.join(r.name for r in fitting)}: give "
                f"format={fitting[0].name!r}"
            )
        if not fitting and not contents[0].text:
            raise FormatError(
                f"{contents[0].name} is no text and no calibration table of a RealSense camera: give the "
                "text file of the calibration, such as calibration.json instead of calibration.bin of "
                "rs-imu-calibration"
            )
        if not fitting:
            raise FormatError(
                f"{contents[0].name} is no calibration that imucal reads: it has the fields of none of "
                f"{names}; `imucal import --list` describes them"
            )
        reader = fitting[0]
    least, most = reader.files
    if not least <= len(contents) <= most:
        raise InputError(
            f"{len(contents)} files are given, a calibration of {reader.name} has {most}: import them "
            "one by one"
        )
    return reader


def _with_bias(found: Found, sensor: Literal["accel", "gyro"], bias: ArrayLike | None, name: str) -> Found:
    """The calibration with a bias given by the user, because the files do not state it."""
    if bias is None:
        return found
    values = as_rows(bias, f"{sensor}_bias")
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"{sensor}_bias is {bias!r}: three numbers are needed")
    field = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
    triad = getattr(found, field) or Triad(np.eye(3), np.zeros(3))
    alone = getattr(found, field) is None
    if not alone and f"{sensor}_bias" not in found.missing:
        raise InputError(f"{name} states the bias of the {sensor} sensor: leave out {sensor}_bias")
    changed: dict[str, Any] = {field: Triad(triad.sensitivity, values)}
    # If the files do not describe the sensor at all, its scale and misalignment are also listed as missing.
    others = (f"{sensor}_scale", f"{sensor}_misalignment") if alone else ()
    return replace(
        found,
        **changed,
        missing=(*others, *(part for part in found.missing if part != f"{sensor}_bias")),
        notes=(*found.notes, f"{sensor}_bias {values.tolist()} was given on import"),
    )


def _calibration(
    reader: Reader, contents: Sequence[Content], found: Found, serial_number: str | None
) -> Calibration:
    missing = ["covariance", *(["temperature"] if not found.temperature_range_degc else []), "gravity"]
    for field in ("accelerometer", "gyroscope"):
        if getattr(found, field) is None:
            missing.append(field)
    missing += [part for part in found.missing if part not in missing]
    names = " and ".join(content.name for content in contents)
    accelerometer = found.accelerometer
    if accelerometer is None:
        raise InputError(
            f"{names}: a calibration of a gyroscope alone needs that of the accelerometer, which defines the "
            "body frame: give both files"
        )
    calibration = Calibration(
        accelerometer,
        found.gyroscope,
        frame=_frame(accelerometer, found.gyroscope),
        accel_unit="lsb" if found.accel_unit == "lsb" else "m/s^2",
        gyro_unit="lsb" if found.gyro_unit == "lsb" else "rad/s",
        references=References("unknown"),
        effects=found.effects,
        user_effects=found.user_effects,
        noise=found.noise,
        temperature_range_degc=found.temperature_range_degc,
        # The verdict is `incomplete`, because the calibration is usable but its residuals are not known.
        verdict="incomplete",
        reasons=(
            f"this is a calibration of {reader.program}, which imucal has not evaluated on any recording"
            ": use imucal evaluate [not_evaluated]",
        ),
        provenance=Provenance(
            imucal_version=str(_core.__version__),
            imported=Imported(
                reader.name,
                reader.program,
                reader.formula,
                tuple(content.source for content in contents),
                tuple(missing),
                found.notes,
            ),
        ),
        serial_number=serial_number or found.serial_number,
    )
    # The conversion to a document and back runs the checks of a calibration file: ranges of sensitivities,
    # biases, noise and temperatures.
    return Calibration.from_dict(calibration.to_dict(), names)


def _frame(accelerometer: Triad, gyroscope: Triad | None) -> Frame:
    """The name of the body frame: "given" for left-handed gyroscope axes, which no other frame permits."""
    if gyroscope is not None and np.linalg.det(gyroscope.sensitivity) < 0:
        return "given"
    return frame_of(accelerometer.sensitivity)


def readers_markdown() -> str:
    """The table of all formats for docs/imports.md, as Markdown."""
    rows = [
        f"| `{reader.name}` | {reader.title} | {reader.formula} | {reader.without} | {reader.source} |"
        for reader in READERS.values()
    ]
    heads = ("`--from`", "file", "correction", "never in the file", "source of the formula")
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *rows])
