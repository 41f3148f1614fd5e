"""The command `imucal import`, which converts a calibration of another program to a calibration file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import imucal.cli.completion as completion
from imucal.cli.options import JsonPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.errors import InputError

__all__ = ["import_calibration"]


def import_calibration(
    files: Annotated[
        list[Path] | None,
        argument(
            metavar="FILE...",
            help="Calibration of another program; imu_tk: the files of accelerometer and gyroscope.",
        ),
    ] = None,
    output: Annotated[
        Path | None, option("--output", "-o", metavar="PATH", help="Calibration file to write.")
    ] = None,
    format: Annotated[
        str | None,
        option(
            "--from",
            "--format",
            metavar="FORMAT",
            help="Format, see --list; recognised from the contents if not given.",
            completion=completion.calibration_formats,
        ),
    ] = None,
    instance: Annotated[
        int,
        option("--instance", metavar="N", help="Number of the sensor, from 0, in a file with several."),
    ] = 0,
    accel_unit: Annotated[
        str | None, option("--accel-unit", help="imu_tk, Ferraris: raw unit, m/s^2, g, mg or lsb.")
    ] = None,
    gyro_unit: Annotated[
        str | None, option("--gyro-unit", help="imu_tk, Ferraris: raw unit, rad/s, deg/s, mdeg/s or lsb.")
    ] = None,
    accel_bias: Annotated[
        str | None,
        option("--accel-bias", metavar="X,Y,Z", help="Bias, m/s^2, for files without one (Kalibr)."),
    ] = None,
    gyro_bias: Annotated[
        str | None,
        option("--gyro-bias", metavar="X,Y,Z", help="Bias, rad/s, for files without one (Kalibr)."),
    ] = None,
    temperature_degc: Annotated[
        float | None,
        option(
            "--temperature-degc",
            metavar="DEGC",
            help="PX4, ArduPilot: evaluate the thermal terms at this temperature.",
        ),
    ] = None,
    accel_lsb_per_g: Annotated[
        float | None,
        option("--accel-lsb-per-g", metavar="X", help="INAV: acc_1G of the sensor's driver; default 2048."),
    ] = None,
    gyro_lsb_per_dps: Annotated[
        float | None,
        option("--gyro-lsb-per-dps", metavar="X", help="INAV: counts per deg/s of the driver; default 16.4."),
    ] = None,
    serial_number: Annotated[str | None, option("--serial-number", help="Serial number of the unit.")] = None,
    show_formats: Annotated[
        bool, option("--list", help="List the formats with their formulas and what they do not state.")
    ] = False,
    json: JsonPath = None,
) -> None:
    """Read a calibration of another program, such as Kalibr, Basalt, RealSense, PX4 or ArduPilot.

    The correction is the same as in the other program. If its file does not state a part of a calibration,
    such as the covariance, the output file lacks this part, and the command lists it.

    Example: imucal import imu.yaml -o imported.json
    """
    import imucal
    from imucal.importing import READERS

    out = Output(json)
    if show_formats:
        fields = ("name", "title", "program", "formula", "source", "without")
        out.document({"formats": [{f: getattr(reader, f) for f in fields} for reader in READERS.values()]})
        for reader in READERS.values():
            out.line(f"{reader.name}: {reader.title}")
            out.line(f"    {reader.formula}")
            out.line(f"    never states {reader.without}")
        return
    if not files or output is None:
        raise InputError(
            "give the file of a calibration and -o PATH: `imucal import --list` shows the formats"
        )
    require_apart(files, {"--output": output, "--json": json})
    calibration = imucal.read_calibration(
        *files,
        format=format,
        instance=instance,
        accel_unit=accel_unit,
        gyro_unit=gyro_unit,
        accel_bias=_vector("--accel-bias", accel_bias),
        gyro_bias=_vector("--gyro-bias", gyro_bias),
        temperature_degc=temperature_degc,
        accel_lsb_per_g=accel_lsb_per_g,
        gyro_lsb_per_dps=gyro_lsb_per_dps,
        serial_number=serial_number,
    )
    imported = calibration.provenance.imported
    if imported is None:
        raise InputError(f"{files[0]} is a calibration file of imucal already: use it as it is")
    calibration.save(output)
    out.document(
        {
            "output": str(output),
            "format": imported.format,
            "program": imported.program,
            "formula": imported.formula,
            "frame": calibration.frame,
            "raw_units": {"accelerometer": calibration.accel_unit, "gyroscope": calibration.gyro_unit},
            "effects": [effect.name for effect in calibration.effects],
            "missing": list(imported.missing),
            "notes": list(imported.notes),
        }
    )
    out.line(f"{output}: calibration of {imported.program} ({imported.format}), {calibration!r}")
    out.line(f"correction: {imported.formula}")
    out.line(f"not in the file: {', '.join(imported.missing).replace('_', ' ')}")
    for note in imported.notes:
        out.line(f"note: {note}")


def _vector(option: str, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3:
        raise InputError(f"{option} is {text!r}: give three numbers, X,Y,Z")
    return values
