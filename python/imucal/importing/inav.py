"""INAV: settings of the CLI (`dump`, `diff` or `set` commands).

    accel = (raw - acczero) * accgain / 4096 / acc_1G     in g, raw in counts, for each axis
    gyro  = (raw - gyro_zero) * scale                     in deg/s

acc_1G and scale are constants of the sensor's driver, which the file does not state. Source: accUpdate in
sensors/acceleration.c and gyroUpdateAndCalibrate in sensors/gyro.c of iNavFlight/inav.
`imucal.exporting.inav` writes these settings.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.errors import FormatError
from imucal.exporting.inav import ACCEL_LSB_PER_G, GYRO_LSB_PER_DPS, UNIT_GAIN
from imucal.importing.source_format import Content, Found, Reader, Wanted
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["INAV", "has_settings"]

# Matches one setting: set NAME = VALUE, as the CLI prints and reads it.
LINE: Final = re.compile(r"^\s*set\s+(\w+)\s*=\s*(\S+)", re.MULTILINE)
# Settings of a calibration, each with INAV's default. The CLI command `diff` does not list settings that have
# their default.
DEFAULTS: Final = {"acczero": 0.0, "accgain": float(UNIT_GAIN), "gyro_zero": 0.0}
# Unless this setting is OFF, INAV measures gyro_zero at each start.
AT_START: Final = "init_gyro_cal"


def has_settings(text: str) -> bool:
    """Whether a text sets the zero or the gain of a sensor."""
    names = tuple(f"{name}_{axis}" for name in DEFAULTS for axis in "xyz")
    return any(match[1] in names for match in LINE.finditer(text))


def recognises(content: Content) -> bool:
    """Whether the file has settings of a calibration."""
    return content.document is None and has_settings(content.text)


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of both sensors from the zeros and gains in a file."""
    (content,) = contents
    settings = _settings(content)
    per_g = wanted.accel_lsb_per_g or ACCEL_LSB_PER_G
    per_dps = wanted.gyro_lsb_per_dps or GYRO_LSB_PER_DPS
    notes = [
        f"acc_1G is taken as {per_g:g} counts per g, and the resolution of the gyroscope as {per_dps:g} "
        "counts per deg/s: for a driver with another resolution give accel_lsb_per_g and gyro_lsb_per_dps",
        "raw samples are counts along the axes of the sensor, before acczero, accgain and any alignment "
        "(align_*); INAV also truncates corrected samples of the accelerometer to counts",
    ]
    gain = _vector(content, settings, "accgain", notes)
    if (gain <= 0).any():
        raise FormatError(f"{content.name}: accgain is {gain.tolist()}: the sensor is not calibrated")
    accelerometer = Triad(
        np.diag(UNIT_GAIN * per_g / STANDARD_GRAVITY_MPS2 / gain),
        _vector(content, settings, "acczero", notes),
    )
    missing = ["accel_misalignment", "gyro_scale", "gyro_misalignment", "noise"]
    if settings.get(AT_START, "ON").upper() == "OFF":
        zero = _vector(content, settings, "gyro_zero", notes)
    else:
        missing.insert(1, "gyro_bias")
        zero = np.zeros(3)
        notes.append(
            f"{AT_START} is not OFF: INAV measures the zero of the gyroscope at each start, and gyro_zero in "
            "the file is not used"
        )
    return Found(
        accelerometer,
        Triad(np.eye(3) * np.degrees(per_dps), zero),
        accel_unit="lsb",
        gyro_unit="lsb",
        missing=tuple(missing),
        notes=tuple(notes),
    )


def _settings(content: Content) -> dict[str, str]:
    """The settings by name. Raises FormatError if a setting has two different values."""
    found: dict[str, str] = {}
    for match in LINE.finditer(content.text):
        name, value = match.groups()
        if name.rpartition("_")[0] not in DEFAULTS and name != AT_START:
            continue
        if found.setdefault(name, value) != value:
            raise FormatError(f"{content.name}: {name} is {found[name]} and {value}: keep one of them")
    return found


def _vector(content: Content, settings: dict[str, str], name: str, notes: list[str]) -> FloatArray:
    """Three integers, one per axis. A setting that is not in the file has its default, with a note."""
    values, defaults = [], []
    for axis in "xyz":
        text = settings.get(f"{name}_{axis}")
        if text is None:
            defaults.append(f"{name}_{axis}")
            values.append(DEFAULTS[name])
            continue
        if not re.fullmatch(r"-?\d+", text):
            raise FormatError(f"{content.name}: {name}_{axis} is {text!r}: a whole number is needed")
        values.append(float(text))
    if defaults:
        notes.append(
            f"{', '.join(defaults)} not in the file: taken as INAV's default {DEFAULTS[name]:g}, which "
            "`diff` does not list"
        )
    return np.array(values)


INAV: Final = Reader(
    name="inav",
    title="INAV: settings of the CLI (`dump`, `diff` or `set` commands)",
    program="INAV",
    formula="accel = (raw - acczero) * accgain / 4096 / acc_1G, gyro = (raw - gyro_zero) * scale, per axis",
    source="iNavFlight/inav, sensors/acceleration.c and sensors/gyro.c",
    recognises=recognises,
    read=read,
    without="misalignment, scale of the gyroscope, covariance, temperature, noise",
    scaled=True,
)
