"""Operations on calibrations for export: rotation of the body frame, and descriptions of omitted parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Frame, Triad
from imucal.effects.definition import UserEffect
from imucal.effects.effect import EffectValues
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED, Axes

__all__ = [
    "FRAMES",
    "along_columns",
    "axes_note",
    "inverse",
    "linear",
    "lost_effects",
    "misalignment",
    "off_scale",
    "per_axis",
    "rotated",
    "temperature_note",
    "turned",
    "turned_axes",
]

FRAMES: Final[dict[Frame, str]] = {
    "symmetric": "orthogonal, closest to the three axes of the accelerometer ('symmetric')",
    "triangular": "orthogonal, x along the accelerometer's x axis, y in its x-y plane ('triangular')",
    "given": "as defined by the program of an imported calibration, or by a composed calibration ('given')",
}


def inverse(triad: Triad) -> FloatArray:
    """The inverse of the sensitivity, (3, 3), bit-identical to the one that imucal-core computes."""
    unit = Triad(triad.sensitivity, np.zeros(3))
    # Without bias, the corrections of the three unit vectors are the columns of the inverse.
    columns, _ = _core.correct(Calibration(unit, unit), np.eye(3), np.zeros((3, 3)))
    found: FloatArray = columns.T.copy()
    return found


def along_columns(calibration: Calibration, *, with_body: bool = False) -> Calibration:
    """Convert a calibration so that it applies to raw samples before the axis remapping of its recordings.

    Firmware and other programs correct such samples. The body frame of the corrected samples stays the same.
    With `with_body`, the inverse of the axis remapping is also applied to the body frame. The result has no
    covariance, because the known covariance is for the parameters after axis remapping.
    """
    if calibration.axes == UNCHANGED:
        return calibration
    axes = Axes.parse(calibration.axes)

    def before(triad: Triad, matrix: FloatArray) -> Triad:
        body = axes.accel if with_body else np.eye(3)
        return Triad(matrix.T @ triad.sensitivity @ body, matrix.T @ triad.bias)

    return replace(
        calibration,
        accelerometer=before(calibration.accelerometer, axes.accel),
        gyroscope=None if calibration.gyroscope is None else before(calibration.gyroscope, axes.gyro),
        axes=UNCHANGED,
        covariance=None,
        covariance_names=(),
    )


def axes_note(calibration: Calibration) -> str:
    """The header line on the axis remapping of the recordings."""
    return (
        f"The recordings were read with axes={calibration.axes!r}. The raw samples to which this file "
        "applies are along the axes of the columns, before this axis remapping."
    )


def linear(calibration: Calibration, effects: Iterable[EffectValues] = ()) -> Calibration:
    """Return the calibration with `effects` as its only effects, and without covariance."""
    return replace(calibration, effects=tuple(effects), covariance=None, covariance_names=())


def rotated(calibration: Calibration, frame: Frame) -> tuple[Calibration, FloatArray]:
    """Convert a calibration, without its effects, to another body frame; also returns the rotation (3, 3).

    v_new = rotation v_old. Raises InputError if the accelerometer axes are left-handed, because no rotation
    maps them to a right-handed frame.
    """
    old = calibration.accelerometer.sensitivity
    if np.linalg.det(old) < 0:
        raise InputError(
            "the accelerometer axes are left-handed (the sensitivity has a negative determinant): change the "
            "sign of one axis in the recording, for accelerometer and gyroscope, and calibrate again"
        )
    if _is_in(frame, old):
        return replace(linear(calibration), frame=frame), np.eye(3)
    gyroscope = calibration.gyroscope
    # The identity replaces the sensitivity of a missing gyroscope. It has no influence, because the frame is
    # defined by the accelerometer alone.
    accel, gyro = _core.convert_frame(old, np.eye(3) if gyroscope is None else gyroscope.sensitivity, frame)
    moved = replace(
        linear(calibration),
        accelerometer=Triad(accel, calibration.accelerometer.bias),
        gyroscope=None if gyroscope is None else Triad(gyro, gyroscope.bias),
        frame=frame,
    )
    return moved, np.asarray(np.linalg.solve(accel, old), dtype=np.float64)


def _is_in(frame: Frame, sensitivity: FloatArray) -> bool:
    """Whether the accelerometer's sensitivity has the form that defines this frame."""
    if frame == "triangular":
        return np.array_equal(sensitivity, np.tril(sensitivity)) and bool((np.diag(sensitivity) > 0).all())
    # In the symmetric frame the sensitivity also has positive eigenvalues. Symmetry is not sufficient,
    # because a rotation by 180 deg is also symmetric.
    return np.array_equal(sensitivity, sensitivity.T) and bool((np.linalg.eigvalsh(sensitivity) > 0).all())


def turned_axes(calibration: Calibration, rotation: FloatArray) -> Calibration:
    """Convert a calibration to raw and corrected samples that are both rotated: v_new = rotation v_old.

    Of the effects, only temperature effects of the biases are rotated, because formats that use this rotation
    export no other effects.
    """
    if np.array_equal(rotation, np.eye(3)):
        return calibration

    def after(triad: Triad) -> Triad:
        return Triad(rotation @ triad.sensitivity @ rotation.T, rotation @ triad.bias)

    def rotated_values(values: EffectValues) -> EffectValues:
        if not values.name.endswith("_bias_temperature"):
            return values
        vectors = np.reshape(values.values, (-1, 3)) @ rotation.T
        return EffectValues(values.name, np.asarray(vectors.ravel(), dtype=np.float64))

    return replace(
        calibration,
        accelerometer=after(calibration.accelerometer),
        gyroscope=None if calibration.gyroscope is None else after(calibration.gyroscope),
        effects=tuple(map(rotated_values, calibration.effects)),
        covariance=None,
        covariance_names=(),
    )


def turned(rotation: FloatArray) -> str:
    """Header text on the rotation from the calibration's body frame to the file's; empty for the identity."""
    if np.array_equal(rotation, np.eye(3)):
        return ""
    return f"; v = R v_body of the calibration, R = {rotation.tolist()}"


def temperature_note(calibration: Calibration) -> tuple[str, ...]:
    """A note on the temperature range of the recordings; empty if the calibration has none."""
    if calibration.temperature_range_degc is None:
        return ()
    low, high = calibration.temperature_range_degc
    effects = calibration.temperature_effects
    outside = f": outside this range, {' and '.join(effects)} are extrapolated" if effects else ""
    return (f"The recordings were at {low:.5g} to {high:.5g} degC{outside}",)


def per_axis(sensitivity: FloatArray) -> FloatArray:
    """The scale of each axis, (3,), that minimises the error of a correction without misalignment.

    The correction is corrected_i = raw_i / scale_i with scale_i = |T_i|^2 / T_ii, where T_i is row i of the
    sensitivity. It minimises the mean square of T_i v / scale_i - v_i over all directions of v.
    """
    scale: FloatArray = (sensitivity**2).sum(axis=1) / np.diag(sensitivity)
    return scale


def misalignment(sensor: str, sensitivity: FloatArray) -> tuple[str, ...]:
    """Description of the omitted misalignment with its largest angle; empty if there is none.

    Raises InputError if a sensor axis points closer to another axis of the body frame than to the axis of the
    same name.
    """
    _require_along_axes(sensor, sensitivity)
    largest = np.abs(sensitivity / np.diag(sensitivity)[:, None] - np.eye(3)).max()
    return (f"misalignment of the {sensor}, up to {largest:.3g} rad",) if largest > 0 else ()


def _require_along_axes(sensor: str, sensitivity: FloatArray) -> None:
    """Raises InputError unless each sensor axis points along the body axis of the same name.

    Formats with one correction per axis can only neglect small misalignment angles, not swapped axes.
    """
    if (np.diag(sensitivity) < np.abs(sensitivity).max(axis=1)).any():
        axes = ", ".join(
            f"its {axis} lies along {'-' if row[along] < 0 else ''}{'xyz'[along]}"
            for axis, row, along in zip("xyz", sensitivity, np.abs(sensitivity).argmax(axis=1), strict=True)
        )
        raise InputError(
            f"the {sensor} axes do not match the body frame ({axes}), and this format has no rotation: swap "
            "the sensor's columns and change their signs in the recording until they match, and calibrate "
            "again"
        )


def off_scale(sensor: str, sensitivity: FloatArray) -> tuple[str, ...]:
    """Description of the omitted scale error with its largest value; empty if all scales are 1."""
    percent = 100 * np.abs(np.diag(sensitivity) - 1).max()
    return (f"scale of the {sensor}, up to {percent:.3g} %",) if percent > 0 else ()


def lost_effects(calibration: Calibration, kept: Iterable[str] = ()) -> tuple[str, ...]:
    """Description of each effect that `imucal apply` compensates but the other program does not."""
    left = set(calibration.left_in_data) | set(kept)
    return tuple(
        f"the effect {values.name}"
        + (" (user-defined)" if isinstance(calibration.definition(values), UserEffect) else "")
        for values in calibration.effects
        if values.name not in left
    )
