"""What is common to the models of other programs: other body frames, and how large the loss is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration import Calibration, Frame, Triad
from imucal.effects import EffectValues, UserEffect
from imucal.errors import InputError

__all__ = [
    "FRAMES",
    "inverse",
    "linear",
    "lost_effects",
    "misalignment",
    "off_scale",
    "per_axis",
    "rotated",
    "temperature_note",
    "turned",
]

FRAMES: Final[dict[Frame, str]] = {
    "symmetric": "orthogonal, as close as can be to the three axes of the accelerometer ('symmetric')",
    "triangular": "orthogonal, x along the accelerometer's x axis, y in its x-y plane ('triangular')",
}


def inverse(triad: Triad) -> FloatArray:
    """The inverse of the sensitivity, (3, 3), to the last bit the one that the device applies."""
    from imucal import _core

    unit = Triad(triad.sensitivity, np.zeros(3))
    # Of the unit vectors it gives its columns.
    columns, _ = _core.correct(Calibration(unit, unit), np.eye(3), np.zeros((3, 3)))
    found: FloatArray = columns.T.copy()
    return found


def linear(calibration: Calibration, effects: Iterable[EffectValues] = ()) -> Calibration:
    """The same with these effects alone."""
    return replace(calibration, effects=tuple(effects), user_effects=(), covariance=None, covariance_names=())


def rotated(calibration: Calibration, frame: Frame) -> tuple[Calibration, FloatArray]:
    """Both triads in another body frame, without effects, and the rotation (3, 3) to it.

    v_new = rotation v_old. Raises InputError if the axes of the accelerometer are left-handed: no rotation
    takes them to a right-handed frame.
    """
    from imucal import _core

    old = calibration.accelerometer.sensitivity
    if np.linalg.det(old) < 0:
        raise InputError(
            "the axes of the accelerometer are left-handed (its sensitivity has a negative determinant): "
            "turn the sign of one axis in the recording, of its gyroscope too, and calibrate again"
        )
    if _is_in(frame, old):
        return replace(linear(calibration), frame=frame), np.eye(3)
    accel, gyro = _core.convert_frame(old, calibration.gyroscope.sensitivity, frame)
    moved = replace(
        linear(calibration),
        accelerometer=Triad(accel, calibration.accelerometer.bias),
        gyroscope=Triad(gyro, calibration.gyroscope.bias),
        frame=frame,
    )
    return moved, np.asarray(np.linalg.solve(accel, old), dtype=np.float64)


def _is_in(frame: Frame, sensitivity: FloatArray) -> bool:
    """Whether the accelerometer's sensitivity has the form that this frame gives it."""
    if frame == "triangular":
        return np.array_equal(sensitivity, np.tril(sensitivity)) and bool((np.diag(sensitivity) > 0).all())
    # A half turn is symmetric as well.
    return np.array_equal(sensitivity, sensitivity.T) and bool((np.linalg.eigvalsh(sensitivity) > 0).all())


def turned(rotation: FloatArray) -> str:
    """How a frame lies to the body frame of the calibration, in words; empty if it is the same."""
    if np.array_equal(rotation, np.eye(3)):
        return ""
    return f"; v = R v_body of the calibration, R = {rotation.tolist()}"


def temperature_note(calibration: Calibration) -> tuple[str, ...]:
    """At which temperatures the calibration was made, in words; nothing if it does not know."""
    if calibration.temperature_range_degc is None:
        return ()
    low, high = calibration.temperature_range_degc
    effects = calibration.temperature_effects
    outside = f": outside it the numbers of {' and '.join(effects)} are an assumption" if effects else ""
    return (f"The recordings were at {low:.5g} to {high:.5g} degC{outside}",)


def per_axis(sensitivity: FloatArray) -> FloatArray:
    """The scale of each axis (3,) that leaves the smallest errors over all directions, without misalignment.

    corrected_i = raw_i / scale_i, and scale_i makes |T_i v / scale_i - v_i| least in the mean square over all
    directions of v: |T_i|^2 / T_ii, T_i being row i.
    """
    scale: FloatArray = (sensitivity**2).sum(axis=1) / np.diag(sensitivity)
    return scale


def misalignment(sensor: str, sensitivity: FloatArray) -> tuple[str, ...]:
    """The loss of what is off the diagonal, in words; none if nothing is there.

    Raises InputError where it is no loss but another direction.
    """
    _require_along_axes(sensor, sensitivity)
    largest = np.abs(sensitivity / np.diag(sensitivity)[:, None] - np.eye(3)).max()
    return (f"misalignment of the {sensor}, up to {largest:.3g} rad",) if largest > 0 else ()


def _require_along_axes(sensor: str, sensitivity: FloatArray) -> None:
    """Refuse a sensor whose axes point elsewhere than those of the body frame, with InputError.

    Programs that correct each axis by itself have no place for more than small angles.
    """
    if (np.diag(sensitivity) < np.abs(sensitivity).max(axis=1)).any():
        axes = ", ".join(
            f"its {axis} lies along {'-' if row[along] < 0 else ''}{'xyz'[along]}"
            for axis, row, along in zip("xyz", sensitivity, np.abs(sensitivity).argmax(axis=1), strict=True)
        )
        raise InputError(
            f"the {sensor} is turned against the body frame ({axes}), and this format knows no such turn: "
            "swap its columns and their signs in the recording until they agree, and calibrate again"
        )


def off_scale(sensor: str, sensitivity: FloatArray) -> tuple[str, ...]:
    """The loss of the scale of each axis, in words; none if it is 1."""
    percent = 100 * np.abs(np.diag(sensitivity) - 1).max()
    return (f"scale of the {sensor}, up to {percent:.3g} %",) if percent > 0 else ()


def lost_effects(calibration: Calibration, kept: Iterable[str] = ()) -> tuple[str, ...]:
    """The effects that `imucal apply` takes away and the other program does not, in words."""
    left = set(calibration.left_in_data) | set(kept)
    return tuple(
        f"the effect {values.name}"
        + (" (your own)" if isinstance(calibration.definition(values), UserEffect) else "")
        for values in calibration.effects
        if values.name not in left
    )
