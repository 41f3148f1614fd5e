"""Correction of recordings by a sensor model.

    seen = T^-1 (measured - bias)
    true <- seen - effects(true),  starting at seen          docs/model.md (16)

T is the sensitivity of the sensor, and `seen` the value that still contains the effects.

For the effects of the catalogue, the compiled library performs this iteration sample by sample. The error
that a user-defined effect causes is computed by a Python function of whole arrays. For user-defined effects,
the iteration is therefore in this file; each step calls the library for the effects of the catalogue.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray, as_rows
from imucal.calibration.model import SensorModel
from imucal.calibration.triad import Triad
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED
from imucal.recording.recording import Recording, require_sensors, samples_of_both

if TYPE_CHECKING:
    from imucal.effects.definition import UserEffect
    from imucal.effects.effect import EffectValues
    from imucal.effects.state import State

__all__ = ["correct", "correct_recording", "empty_samples", "left_in_data", "takes_pieces"]

# Convergence criterion: largest change of a sample in an iteration, relative to the magnitude of the terms
# whose sum is the corrected sample. The limit is 16 times the relative rounding error of float64.
ROUNDING: Final = 16 * np.finfo(np.float64).eps
# Maximum number of iterations for user-defined effects, which are evaluated on whole recordings.
MOST_PASSES: Final = 32

# Inputs of effects besides rate and force, each with the further column of the recording that its computation
# needs.
COLUMNS: Final = {
    "time": "time_s",
    "angular_acceleration": "time_s",
    "temperature": "temperature_degc",
    "temperature_history": "temperature_degc",
}
# Inputs that are computed from more than one sample, so that an effect which depends on them needs the
# neighbours of each sample.
OF_OTHER_SAMPLES: Final = {"angular_acceleration", "temperature_history"}


def correct(
    model: SensorModel, angular_rate: ArrayLike | None, specific_force: ArrayLike | None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Correct samples that are given as arrays (N, 3), as `Calibration.apply` describes."""
    _require_rate_and_force_only(model)
    if angular_rate is not None and model.gyroscope is None:
        model.both()
    if angular_rate is None or specific_force is None:
        if model.effects:
            missing = "angular_rate" if angular_rate is None else "specific_force"
            raise InputError(
                f"{missing} is None [sensor_missing], and {model.effects[0].name} needs both sensors: give "
                "both"
            )
        rate = None if angular_rate is None else as_rows(angular_rate, "angular_rate", 3)
        force = None if specific_force is None else as_rows(specific_force, "specific_force", 3)
        return _of_triad(model.gyroscope, rate), _of_triad(model.accelerometer, force)
    rate = as_rows(angular_rate, "angular_rate", 3)
    force = as_rows(specific_force, "specific_force", 3, len(rate))
    corrected: tuple[FloatArray, FloatArray] = _core.correct(model, rate, force)
    return corrected


def correct_recording(model: SensorModel, recording: Recording, *, start_s: float | None = None) -> Recording:
    """Correct a recording, as `Calibration.apply_recording` describes."""
    for effect in model.user_effects:
        effect.required_field()
    if start_s is not None and not takes_pieces(model):
        raise InputError(f"{recording.name}: the effects of this calibration need the whole recording")
    model.require_raw_units(recording)
    if model.gyroscope is None:
        # The result is in SI units in the body frame, so it must not contain angular rates that cannot be
        # corrected.
        recording = recording.of_sensor("accelerometer")
    if len(recording.sensors) == 1:
        if model.effects:
            require_sensors(recording, "accelerometer", "gyroscope")
        _core.require_signed_counts(recording)
        rate, force = (
            _of_triad(model.gyroscope, _float64(recording.angular_rate)),
            _of_triad(model.accelerometer, _float64(recording.specific_force)),
        )
        return _in_body_frame(recording, rate, force)
    _require_columns(model, recording)
    without = _remove_user_effects(model, recording)
    rate, force = _core.correct_recording(model.without_user_effects(), without, start_s)
    return _in_body_frame(recording, rate, force)


def _in_body_frame(recording: Recording, rate: FloatArray | None, force: FloatArray | None) -> Recording:
    return replace(
        recording,
        angular_rate=rate,
        specific_force=force,
        accel_unit="m/s^2",
        gyro_unit="rad/s",
        axes=UNCHANGED,
        column_units=(None, None),
    )


def _of_triad(triad: Triad | None, raw: FloatArray | None) -> FloatArray | None:
    """Correct samples of one sensor, (N, 3), without effects."""
    if triad is None or raw is None:
        return None
    corrected: FloatArray = _core.correct_triad(triad, raw)
    return corrected


def _float64(samples: SampleArray | None) -> FloatArray | None:
    return None if samples is None else samples.astype(np.float64, copy=False)


def empty_samples(
    raw: Recording, corrected: Recording
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return two masks: samples without rate or force, and complete samples that could not be corrected."""

    def is_complete(recording: Recording) -> npt.NDArray[np.bool_]:
        there = [rows for rows in (recording.angular_rate, recording.specific_force) if rows is not None]
        columns = np.hstack(there)
        return np.asarray(np.isfinite(columns).all(axis=1))

    complete = is_complete(raw)
    return np.logical_not(complete), complete & np.logical_not(is_complete(corrected))


def left_in_data(model: SensorModel) -> tuple[str, ...]:
    """Names of effects that remain in corrected samples.

    These are errors of the stand's encoders, and effects that depend on a quantity that a recording does not
    contain, such as the attitude.
    """
    return tuple(
        effect.name
        for effect in model.catalogue_effects()
        if effect.sensor == "encoder" or not set(effect.needs) <= set(COLUMNS)
    )


def takes_pieces(model: SensorModel) -> bool:
    """Whether each sample is corrected independently of its neighbours."""
    needs = {need for effect in model.catalogue_effects() for need in effect.needs}
    return not model.user_effects and not needs & OF_OTHER_SAMPLES


def _require_rate_and_force_only(model: SensorModel) -> None:
    """Raise InputError for effects that depend on more than rate and force."""
    for effect in model.catalogue_effects():
        for need in effect.needs:
            if need in COLUMNS:
                raise InputError(
                    f"{effect.name} depends on {need.replace('_', ' ')}: use apply_recording, with a "
                    f"recording that has {COLUMNS[need]}"
                )
    for own in model.user_effects:
        raise InputError(
            f"{own.name} is a user-defined effect, whose function needs whole columns: use apply_recording"
        )


def _require_columns(model: SensorModel, recording: Recording) -> None:
    """Raise InputError if the recording lacks a column on which an effect depends."""
    for effect in model.catalogue_effects():
        if "temperature" in effect.needs and recording.temperature_degc is None:
            raise InputError(
                f"{recording.name} has no temperature_degc (temp_degc in a file) and {effect.name} depends "
                "on it: record the temperature, or leave the effect out of the calibration"
            )
        if "temperature" in effect.needs and (finding := _core.check_temperature(recording)) is not None:
            raise InputError(f"{finding}")
        if "angular_acceleration" in effect.needs:
            _require_derivative(recording, effect.name)


def _require_derivative(recording: Recording, name: str) -> None:
    if len(recording) == 1:
        raise InputError(
            f"{recording.name} has one sample and {name} depends on angular acceleration: give two"
        )
    wrong = np.flatnonzero(~(np.diff(recording.time_s) >= 0))
    if len(wrong):
        raise InputError(
            f"{recording.name}: time_s decreases from sample {wrong[0]} to {wrong[0] + 1}, and {name} "
            "depends on angular acceleration: give samples in order of time"
        )


# If the iteration diverges, values overflow to infinity. NumPy's warnings are switched off, because the
# InputError at the end of the function reports the divergence.
@np.errstate(over="ignore", invalid="ignore")
def _remove_user_effects(model: SensorModel, recording: Recording) -> Recording:
    """Subtract the contributions of the user-defined effects from a raw recording.

    The function of each effect receives a State (rate, force, temperature, ... at each sample). The angular
    acceleration and the time since the last motion in this State are computed from the rate that is corrected
    for the effects of the catalogue only.

    Raises InputError if a definition is missing or the iteration does not converge.
    """
    own = list(model.own_effects())
    if not own:
        return recording
    from imucal.effects.state import State

    others = model.without_user_effects()
    accelerometer, gyroscope = model.both()
    raw_force, raw_rate = samples_of_both(recording)
    sizes = _rounded_size(gyroscope, raw_rate), _rounded_size(accelerometer, raw_force)
    corrected = _core.correct_recording(others, recording)
    # The rate is differentiated only once, because differentiation in each iteration would add noise. The
    # time since the last motion is also computed only once. This time changes abruptly when the rate crosses
    # a threshold, so a sample near the threshold might never converge.
    start = State.of(recording, *corrected)
    acceleration = start.angular_acceleration
    measured = [np.isfinite(samples) for samples in corrected]
    for _ in range(MOST_PASSES):
        on_rate, on_force = _added(own, State.of(recording, *corrected, acceleration, start.rest_s))
        without = replace(
            recording,
            angular_rate=raw_rate - on_rate @ gyroscope.sensitivity.T,
            specific_force=raw_force - on_force @ accelerometer.sensitivity.T,
        )
        before, corrected = corrected, _core.correct_recording(others, without)
        limits = [
            ROUNDING * (size + _largest(added))
            for size, added in zip(sizes, (on_rate, on_force), strict=True)
        ]
        unsettled = [
            known & ~(np.abs(now - earlier) <= limit)
            for known, now, earlier, limit in zip(measured, corrected, before, limits, strict=True)
        ]
        if not any(of_sensor.any() for of_sensor in unsettled):
            return without
    names = ", ".join(effect.name for effect, _ in own)
    first = np.hstack(unsettled).any(axis=1).argmax()
    raise InputError(
        f"{recording.name}: {names} cannot be corrected: at sample {first} the "
        f"correction has not converged in {MOST_PASSES} iterations, because the effect is too large "
        "relative to the rate or force on which it depends"
    )


def _added(own: list[tuple[UserEffect, EffectValues]], state: State) -> tuple[FloatArray, FloatArray]:
    """Sum of the user-defined effects on the rate, rad/s, and on the force, m/s^2, (N, 3) each."""
    on_rate, on_force = np.zeros_like(state.angular_rate), np.zeros_like(state.specific_force)
    for effect, values in own:
        target = on_rate if effect.sensor == "gyroscope" else on_force
        target += effect.at(state, values)
    return on_rate, on_force


def _rounded_size(triad: Triad, raw: SampleArray) -> FloatArray:
    """Magnitude of the terms whose sum is a corrected sample, (N, 1), SI units.

    The rounding error of the sample is proportional to this magnitude.
    """
    inverse = np.abs(np.linalg.inv(triad.sensitivity))
    # Counts are converted to float64 before the absolute value is taken, because the absolute value of -32768
    # overflows int16.
    size = np.abs(raw.astype(np.float64, copy=False))
    return _largest((size + np.abs(triad.bias)) @ inverse.T)


def _largest(rows: FloatArray) -> FloatArray:
    """The largest absolute value of the three axes at each sample, (N, 1)."""
    x, y, z = np.abs(rows).T
    # `np.max` along the axis of three values takes several times longer.
    largest: FloatArray = np.maximum(np.maximum(x, y), z)
    return largest[:, None]
