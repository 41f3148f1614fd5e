"""Ferraris calibrations (JSON) of the package imucal of mad-lab-fau, whose import name is also imucal.

    acc  = R_a^-1 K_a^-1 (raw - b_a)
    gyro = R_g^-1 K_g^-1 (raw - K_ga acc - b_g)

R_a and R_g are misalignment matrices, K_a and K_g scale matrices, b_a and b_g biases, and K_ga is the
g-sensitivity. So the sensitivity of the accelerometer is K_a R_a, that of the gyroscope is T = K_g R_g, and
the g-sensitivity in the body frame is T^-1 K_ga. Source: FerrarisCalibrationInfo in
ferraris_calibration_info.py of mad-lab-fau/imucal.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.effects.effect import EffectValues
from imucal.exporting.kalibr import G_SENSITIVITY
from imucal.importing.raw_units import in_si, per_si_unit
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["FERRARIS"]

# Names by which the package mad-lab-fau/imucal states that the raw unit is counts.
COUNTS: Final = ("a.u.", "a.u", "lsb", "counts")


def recognises(content: Content) -> bool:
    """Whether the file has the matrices and the bias of the accelerometer, K_a, R_a and b_a."""
    return {"K_a", "R_a", "b_a"} <= content.fields.keys()


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of both sensors."""
    document = contents[0].document
    assert document is not None
    accelerometer, accel_unit = _triad(document, "a", "accelerometer", "acc", "m/s^2", wanted.accel_unit)
    gyroscope, gyro_unit = _triad(document, "g", "gyroscope", "gyr", "rad/s", wanted.gyro_unit)
    # The unit of K_ga is the raw unit of the gyroscope per unit of the calibrated force.
    per_force = per_si_unit("accelerometer", _unit(document, "acc_unit", "m/s^2"))
    raw_gyro = _unit(document, "from_gyr_unit", "a.u.") if wanted.gyro_unit is None else wanted.gyro_unit
    per_raw = 1.0 if raw_gyro in COUNTS else per_si_unit("gyroscope", raw_gyro)
    coupling = document.get("K_ga").array(3, 3) * per_force / per_raw
    effects = []
    if coupling.any():
        in_body = np.linalg.solve(gyroscope.sensitivity, coupling).ravel()
        effects.append(EffectValues(G_SENSITIVITY, np.asarray(in_body, dtype=np.float64)))
    return Found(
        accelerometer,
        gyroscope,
        tuple(effects),
        accel_unit=accel_unit,
        gyro_unit=gyro_unit,
        missing=("noise",),
    )


def _unit(document: Node, name: str, default: str) -> str:
    """A unit in the file, or `default` for files of older versions of the package, which state no unit."""
    value = document.mapping().get(name)
    return default if value is None else document.get(name).text()


def _triad(
    document: Node, letter: str, sensor: str, short: str, si_unit: str, given: str | None
) -> tuple[Triad, str]:
    """The triad of a sensor, and its raw unit: counts ("lsb") or the SI unit.

    letter, short   the sensor in names of matrices (a, g) and of units (acc, gyr)
    given           raw unit that the user gives, or None
    """
    matrix = document.get(f"K_{letter}").array(3, 3) @ document.get(f"R_{letter}").array(3, 3)
    # The matrices convert calibrated samples, in the units that the file states, to raw samples.
    calibrated = _unit(document, f"{short}_unit", "m/s^2" if short == "acc" else "deg/s")
    triad = Triad(matrix * per_si_unit(sensor, calibrated), document.get(f"b_{letter}").array(3))
    raw = _unit(document, f"from_{short}_unit", "a.u.") if given is None else given
    if raw in COUNTS:
        return triad, "lsb"
    return in_si(triad, per_si_unit(sensor, raw)), si_unit


FERRARIS: Final = Reader(
    name="ferraris",
    title="Ferraris calibration (JSON) of mad-lab-fau/imucal",
    program="imucal of mad-lab-fau",
    formula="acc = R_a^-1 K_a^-1 (raw - b_a); gyro = R_g^-1 K_g^-1 (raw - K_ga acc - b_g)",
    source="mad-lab-fau/imucal, ferraris_calibration_info.py, FerrarisCalibrationInfo",
    recognises=recognises,
    read=read,
    without="covariance, temperature, noise",
)
