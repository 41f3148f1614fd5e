"""INAV: CLI commands that set the zero and gain of the accelerometer and the zero of the gyroscope.

    accel = (raw - acczero) * accgain / 4096 / acc_1G     in g, raw in counts, for each axis
    gyro  = (raw - gyro_zero) * scale                     in deg/s

Source: iNavFlight/inav, applyAccelerationZero and accUpdate in sensors/acceleration.c, gyroUpdateAndCalibrate
in sensors/gyro.c. All settings are integers, with ranges from docs/Settings.md of INAV. acc_1G and scale are
constants of the sensor's driver.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.errors import InputError
from imucal.exporting.format import Format, Written, line_comments
from imucal.exporting.model import FRAMES, lost_effects, misalignment, off_scale, per_axis, rotated
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["ACCEL_LSB_PER_G", "GYRO_LSB_PER_DPS", "INAV"]

# Default of acc_1G, counts per g. INAV's drivers with a range of 16 g have this value, for example the
# drivers of ICM-42605, MPU-6000, BMI160 and BMI270.
ACCEL_LSB_PER_G: Final = 2048.0
# Default of the gyroscope resolution, counts per deg/s. All of INAV's drivers use the range 2000 deg/s, which
# has this resolution.
GYRO_LSB_PER_DPS: Final = 16.4
# Value of accgain for a gain of 1.
UNIT_GAIN: Final = 4096
# Largest accepted relative difference between the resolution of a unit in raw counts and that of INAV's
# driver. A larger difference means that the unit was recorded with another range, because ranges of a sensor
# differ by factors of about two, and scale errors of MEMS sensors are below 10 %.
MOST_OFF: Final = 0.2
GAIN_RANGE: Final = (1, 8192)
ZERO_RANGE: Final = (-32768, 32767)
RANGES: Final = {"accgain": GAIN_RANGE, "acczero": ZERO_RANGE, "gyro_zero": ZERO_RANGE}


def write(
    calibration: Calibration,
    noise: NoiseResult | None,
    accel_lsb_per_g: float = ACCEL_LSB_PER_G,
    gyro_lsb_per_dps: float = GYRO_LSB_PER_DPS,
) -> Written:
    """Write the commands, one per line, with the values rounded to integers."""
    moved, _ = rotated(calibration, "symmetric")
    accel, gyro = moved.accelerometer, moved.gyroscope
    _require_resolution(moved, accel_lsb_per_g, gyro_lsb_per_dps)
    in_counts = calibration.accel_unit == "lsb", calibration.gyro_unit == "lsb"
    # Factors that convert raw units of the calibration to counts of INAV's driver.
    accel_counts = 1.0 if in_counts[0] else accel_lsb_per_g / STANDARD_GRAVITY_MPS2
    gyro_counts = 1.0 if in_counts[1] else gyro_lsb_per_dps * 180 / np.pi
    # Counts of INAV's driver per m/s^2 and per rad/s, for a sensor without errors.
    accel_per_si = accel_lsb_per_g / STANDARD_GRAVITY_MPS2
    gyro_per_si = gyro_lsb_per_dps * 180 / np.pi
    gain = _whole("accgain", UNIT_GAIN * accel_per_si / (accel_counts * per_axis(accel.sensitivity)))
    zero = _whole("acczero", accel_counts * accel.bias)
    settings = {"acczero": zero, "accgain": gain}
    sensitivity = np.diag(UNIT_GAIN * accel_per_si / (accel_counts * gain))
    same_gyro = None
    if gyro is not None:
        settings["gyro_zero"] = _whole("gyro_zero", gyro_counts * gyro.bias)
        same_gyro = Triad(np.eye(3) * gyro_per_si / gyro_counts, settings["gyro_zero"] / gyro_counts)
    lines = [
        f"set {name}_{axis} = {value}"
        for name, values in settings.items()
        for axis, value in zip("xyz", values, strict=True)
    ]
    if gyro is not None:
        lines.insert(-3, "set init_gyro_cal = OFF")
    kept = replace(
        moved, accelerometer=Triad(sensitivity, zero / accel_counts), gyroscope=same_gyro, effects=()
    )
    return Written(
        body="\n".join([*lines, "save", ""]),
        lost=(
            *_rounded(moved, kept),
            *misalignment("accelerometer", accel.sensitivity),
            *(() if gyro is None else off_scale("gyroscope", gyro.sensitivity * gyro_counts / gyro_per_si)),
            *(() if gyro is None else misalignment("gyroscope", gyro.sensitivity)),
            *lost_effects(calibration),
        ),
        same_as=kept,
        frame=FRAMES["symmetric"] + ", along the sensor's axes",
        notes=(
            f"acc_1G is {accel_lsb_per_g:g} counts per g, the gyroscope has {gyro_lsb_per_dps:g} counts "
            "per deg/s: if the driver of your sensor has other values, export with --accel-lsb-per-g and "
            "--gyro-lsb-per-dps.",
            "Raw samples are those of the sensor, along its own axes, before acczero, accgain and any "
            "alignment (align_*): record with acczero 0 and accgain 4096.",
            *(
                ()
                if gyro is None
                else (
                    "With init_gyro_cal OFF, INAV uses gyro_zero; otherwise it measures the gyroscope bias "
                    "at each start.",
                )
            ),
            "Paste the commands into the CLI. INAV also truncates each corrected accelerometer sample to "
            "counts.",
        ),
    )


def _require_resolution(calibration: Calibration, accel_lsb_per_g: float, gyro_lsb_per_dps: float) -> None:
    """Raise InputError for raw counts whose resolution differs from that of the sensor's driver in INAV."""
    gyro = calibration.gyroscope
    for triad, unit, per_si, driver, what, option in (
        (
            calibration.accelerometer,
            calibration.accel_unit,
            STANDARD_GRAVITY_MPS2,
            accel_lsb_per_g,
            "accelerometer of this calibration has {:.5g} counts per g, but acc_1G",
            "--accel-lsb-per-g",
        ),
        (
            gyro,
            calibration.gyro_unit,
            np.pi / 180,
            gyro_lsb_per_dps,
            "gyroscope of this calibration has {:.5g} counts per deg/s, but the resolution of INAV's driver",
            "--gyro-lsb-per-dps",
        ),
    ):
        if triad is None or unit != "lsb":
            continue
        # Mean scale of the axes, from the determinant, which does not change if the sensor is rotated.
        counts = per_si * float(abs(np.linalg.det(triad.sensitivity)) ** (1 / 3))
        if abs(counts / driver - 1) > MOST_OFF:
            raise InputError(
                f"the {what.format(counts)} is assumed to be {driver:g}: give the value of the driver of "
                f"your sensor ({option}), and calibrate raw counts of the same range as in INAV"
            )


def _whole(name: str, values: FloatArray) -> FloatArray:
    """Round values to integers. Raises InputError for a value outside the range of the setting `name`."""
    low, high = RANGES[name]
    found = np.rint(values)
    if not ((found >= low) & (found <= high)).all():
        raise InputError(
            f"{name} is {found.tolist()}, outside of {low} to {high}: give the resolution of the driver, "
            "--accel-lsb-per-g and --gyro-lsb-per-dps"
        )
    return found.astype(np.int64)


def _rounded(whole: Calibration, kept: Calibration) -> tuple[str, ...]:
    """Description of the errors due to rounding to integers, with their largest values; may be empty."""
    gain = per_axis(whole.accelerometer.sensitivity) / np.diag(kept.accelerometer.sensitivity) - 1
    errors = [
        (np.abs(whole.accelerometer.bias - kept.accelerometer.bias).max(), whole.accel_unit),
        (100 * np.abs(gain).max(), f"% (accgain in steps of 1/{UNIT_GAIN})"),
    ]
    if whole.gyroscope is not None and kept.gyroscope is not None:
        errors.insert(1, (np.abs(whole.gyroscope.bias - kept.gyroscope.bias).max(), whole.gyro_unit))
    sizes = ", ".join(f"{size:.2g} {unit}" for size, unit in errors)
    # Differences up to 1e-12 are rounding errors of float64 and are not reported.
    return (
        (f"fractions of the settings, because INAV stores integers: up to {sizes}",)
        if max(e for e, _ in errors) > 1e-12
        else ()
    )


def scaled(accel_lsb_per_g: float, gyro_lsb_per_dps: float) -> Format:
    """INAV's format for raw counts of this resolution. Raises InputError unless both numbers are positive."""
    for name, value in (("accel_lsb_per_g", accel_lsb_per_g), ("gyro_lsb_per_dps", gyro_lsb_per_dps)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}: a positive number is needed")
    return replace(
        INAV, write=partial(write, accel_lsb_per_g=accel_lsb_per_g, gyro_lsb_per_dps=gyro_lsb_per_dps)
    )


INAV = Format(
    name="inav",
    title="INAV CLI commands",
    suffix=".txt",
    formula="accel = (raw - acczero) * accgain / 4096 / acc_1G, gyro = (raw - gyro_zero) * scale, per axis",
    source="iNavFlight/inav, sensors/acceleration.c, sensors/gyro.c, docs/Settings.md",
    units="g and deg/s",
    includes="bias of both sensors, scale of the accelerometer, as integers",
    omits="misalignment of both sensors, scale of the gyroscope, all effects",
    layout=line_comments("#"),
    write=write,
    takes_counts=True,
    needs_gyroscope=False,
    scaled=scaled,
)
