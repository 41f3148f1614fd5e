"""A calibration as data for firmware: its binary form with a checksum, and the C header that reads this form.

The documentation of the Rust module `imucal_core::stored` (rust/imucal-core/src/stored.rs) defines the bytes
of the binary form.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import TYPE_CHECKING, Final

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.effects.effect import EffectValues
from imucal.errors import InputError
from imucal.exporting.format import SI, Format, Written, block_comment, line_comments
from imucal.exporting.model import FRAMES, inverse, linear, lost_effects, temperature_note
from imucal.recording.axes import UNCHANGED, Axes
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["BLOB", "C_LOADER", "blob_of"]

# Version of the binary form. `imucal_core::stored` and the C header read only this version.
VERSION: Final = 1
# Bits of the byte `flags` in the header of the binary form.
RATE_IN_COUNTS: Final = 1
FORCE_IN_COUNTS: Final = 2
HAS_TEMPERATURE_RANGE: Final = 4
# Largest value of int16_t.
LARGEST_COUNT: Final = 32767


def write(
    calibration: Calibration,
    noise: NoiseResult | None,
    axes: str = UNCHANGED,
    resolution: tuple[float, float] | None = None,
) -> Written:
    """Write the binary form. It omits all user-defined effects, including formulas.

    axes         axes of the corrected samples, in terms of the body frame, such as "x,-y,-z"
    resolution   counts per g and per deg/s, if the calibration is in SI units and the firmware has raw
                 samples in counts
    """
    original = calibration
    if resolution is not None:
        calibration = _of_counts(calibration, *resolution)
    kept = _kept(calibration)
    lost = lost_effects(calibration, {values.name for values in kept})
    return Written(
        body="",
        lost=lost,
        same_as=linear(original, kept),
        frame=FRAMES[calibration.frame]
        + ("" if axes == UNCHANGED else f"; corrected samples along {axes} of it"),
        notes=(
            *_warnings(calibration, kept, lost),
            *_too_large_counts(calibration),
            *temperature_note(calibration),
        ),
        binary=blob_of(calibration, axes),
        raw_units=None
        if resolution is None
        else "lsb ({:.10g} per g) and lsb ({:.10g} per deg/s)".format(*resolution),
    )


def _warnings(calibration: Calibration, kept: Sequence[EffectValues], lost: Sequence[str]) -> list[str]:
    """Notes for the developer of the firmware: effects, required inputs, and omitted parts."""
    needs = sorted({need for v in kept for need in getattr(calibration.definition(v), "needs", ())})
    notes = [f"Effects compensated: {', '.join(v.name for v in kept) or 'none'}"]
    if needs:
        notes.append(f"The firmware must give: {', '.join(needs).replace('_', ' ')}")
    if lost:
        notes.append(
            "The errors of omitted effects stay in the data. omitted_effects is the number of these effects, "
            "so that a firmware can refuse the calibration"
        )
    return notes


def _too_large_counts(calibration: Calibration) -> list[str]:
    """A note if counts of a unit at rest may exceed int16_t, the argument type of `imucal_correct_counts`."""
    if calibration.accel_unit != "lsb" or calibration.gyroscope is None:
        return []
    accel = calibration.accelerometer
    at_rest = np.abs(accel.bias) + STANDARD_GRAVITY_MPS2 * np.linalg.norm(accel.sensitivity, axis=1)
    largest = float(max(at_rest.max(), np.abs(calibration.gyroscope.bias).max()))
    if largest <= LARGEST_COUNT:
        return []
    return [
        f"Counts at rest reach {largest:.0f} and exceed int16_t, the argument of imucal_correct_counts: call "
        "imucal_correct"
    ]


def _of_counts(calibration: Calibration, accel_lsb_per_g: float, gyro_lsb_per_dps: float) -> Calibration:
    """Convert a calibration of raw samples in SI units to a calibration of raw samples in counts."""
    if calibration.gyroscope is None or "lsb" in (calibration.accel_unit, calibration.gyro_unit):
        raise InputError(
            "this calibration is for raw counts already: remove --accel-lsb-per-g and --gyro-lsb-per-dps"
        )
    accel, gyro = accel_lsb_per_g / STANDARD_GRAVITY_MPS2, math.degrees(gyro_lsb_per_dps)
    if not (math.isfinite(accel) and accel > 0 and math.isfinite(gyro) and gyro > 0):
        raise InputError("a resolution is not a positive number: give counts per g and per deg/s")

    def counted(triad: Triad, lsb: float) -> Triad:
        return Triad(triad.sensitivity * lsb, triad.bias * lsb)

    return replace(
        calibration,
        accelerometer=counted(calibration.accelerometer, accel),
        gyroscope=counted(calibration.gyroscope, gyro),
        accel_unit="lsb",
        gyro_unit="lsb",
        covariance=None,
        covariance_names=(),
    )


def blob_of(calibration: Calibration, axes: str = UNCHANGED) -> bytes:
    """The bytes of the binary form.

    axes   axes of the corrected samples, in terms of the body frame, such as "x,-y,-z"

    Raises InputError for left-handed axes.
    """
    assert calibration.gyroscope is not None  # `Format.needs_gyroscope`
    kept = _kept(calibration)
    omitted = len(lost_effects(calibration, {values.name for values in kept}))
    known = calibration.temperature_range_degc
    flags = (
        (RATE_IN_COUNTS if calibration.gyro_unit == "lsb" else 0)
        | (FORCE_IN_COUNTS if calibration.accel_unit == "lsb" else 0)
        | (HAS_TEMPERATURE_RANGE if known is not None else 0)
    )
    lowest, highest = known if known is not None else (0.0, 0.0)
    body = b"".join(
        (
            struct.pack("<BB3b3x", len(kept), omitted, *_axis_codes(axes)),
            _floats(lowest, highest, _core.REFERENCE_TEMPERATURE_DEGC),
            _triad(calibration.gyroscope),
            _triad(calibration.accelerometer),
            *(_effect(values) for values in kept),
        )
    )
    start = struct.pack("<4sBBH", b"IMUC", VERSION, flags, 8 + len(body) + 4)
    return start + body + struct.pack("<I", zlib.crc32(start + body))


def _kept(calibration: Calibration) -> list[EffectValues]:
    """The effects that the binary form can represent."""
    numbers = _numbers()
    own = {effect.name for effect in calibration.user_effects}
    return [v for v in calibration.effects if v.name not in own and numbers.get(v.name, 0)]


def _numbers() -> dict[str, int]:
    """Identification number of each effect in the binary form; 0 for an effect that is not a sensor error."""
    return {effect.name: effect.number for effect in _core.effects()}


def _axis_codes(axes: str) -> list[int]:
    changed = Axes.parse(axes)
    if not changed.are_alike:
        raise InputError(
            f"body_axes is {axes!r}: both sensors of a calibration have one body frame, give one order of "
            "axes"
        )
    matrix = np.asarray(changed.accel)
    if np.linalg.det(matrix) < 0:
        raise InputError(
            f"body_axes is {axes!r}, which is left-handed, and an angular rate in left-handed axes gives no "
            "attitude: change the sign of one axis, or exchange two, such as x,-y,-z"
        )
    return [int((abs(row).argmax() + 1) * np.sign(row[abs(row).argmax()])) for row in matrix]


def _floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def _triad(triad: Triad) -> bytes:
    return _floats(*inverse(triad).ravel().tolist(), *triad.bias.tolist())


def _effect(values: EffectValues) -> bytes:
    start = struct.pack("<BBxx", _numbers()[values.name], len(values.values))
    return start + _floats(1.0 if values.shape is None else values.shape, *values.values.tolist())


def write_loader(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the C header. Only its comment depends on the calibration; its code is the same for all units."""
    kept = _kept(calibration)
    return Written(
        body=files("imucal.exporting").joinpath("calibration_loader.h").read_text(),
        lost=lost_effects(calibration, {values.name for values in kept}),
        same_as=linear(calibration, kept),
        frame=FRAMES[calibration.frame],
        notes=("This header reads the binary form of any unit (--to blob). It contains no calibration.",),
    )


def _with(axes: str = UNCHANGED, resolution: tuple[float, float] | None = None) -> Format:
    """The format with these axes of the corrected samples and this resolution of raw counts."""
    _axis_codes(axes)
    return replace(
        BLOB,
        write=partial(write, axes=axes, resolution=resolution),
        along=lambda given: _with(given, resolution),
        scaled=lambda accel, gyro: _with(axes, (accel, gyro)),
    )


BLOB = Format(
    name="blob",
    title="Calibration as data for firmware, read by c-loader or imucal-core",
    suffix=".bin",
    formula="true = T^-1 (raw - bias) - effects(true), by imucal_correct or StoredCalibration::correct",
    source="imucal-core, stored.rs",
    units=SI,
    includes="bias, scale and misalignment of both sensors, every effect of the catalogue; single precision",
    omits="user-defined effects and formulas, noise figures, standard deviations, provenance",
    layout=line_comments("#"),
    write=write,
    takes_counts=True,
    is_binary=True,
    along=lambda axes: _with(axes),
    scaled=lambda accel, gyro: _with(resolution=(accel, gyro)),
)

C_LOADER = Format(
    name="c-loader",
    title="C header that reads the binary form (blob) of any unit",
    suffix=".h",
    formula="true = T^-1 (raw - bias) - effects(true), by imucal_correct after imucal_calibration_load",
    source="imucal-core, stored.rs; docs/model.md (16)",
    units=SI,
    includes="the correction with every effect of the catalogue, for any unit; no calibration",
    omits="the calibration itself (blob), user-defined effects and formulas",
    layout=block_comment,
    write=write_loader,
    takes_counts=True,
)
