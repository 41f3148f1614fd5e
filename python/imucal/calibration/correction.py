"""What a correction needs to know of the surroundings, and how it takes a user's own effects away.

    seen = T^-1 (measured - bias)
    true <- seen - effects(true),  starting at seen          docs/model.md (16)

The compiled library does this sample by sample for the effects of the catalogue. A user's field is a function
of whole arrays, so its passes are made here, around the library's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray
from imucal.effects.effect import Effect, EffectValues, State, UserEffect
from imucal.errors import InputError
from imucal.recording.recording import Recording

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration, Triad

__all__ = [
    "empty_samples",
    "left_in_data",
    "remove_user_effects",
    "require_no_surroundings",
    "require_surroundings",
    "takes_pieces",
]

# Those of the library's own passes.
MAX_PASSES: Final = 32
ROUNDING: Final = 16 * np.finfo(np.float64).eps

# What a field may need, and the column of a recording that gives it.
COLUMNS: Final = {"time": "time_s", "angular_acceleration": "time_s", "temperature": "temperature_degc"}


def empty_samples(
    raw: Recording, corrected: Recording
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Which samples have no rate or no force, and which have both and no correction."""

    def is_whole(recording: Recording) -> npt.NDArray[np.bool_]:
        columns = np.hstack((recording.angular_rate, recording.specific_force))
        return np.asarray(np.isfinite(columns).all(axis=1))

    complete = is_whole(raw)
    return np.logical_not(complete), complete & np.logical_not(is_whole(corrected))


def left_in_data(calibration: Calibration) -> tuple[str, ...]:
    """Names of the effects whose needs no recording gives, or that act on the stand."""
    return tuple(
        effect.name
        for effect in _of_catalogue(calibration)
        if effect.sensor == "encoder" or not set(effect.needs) <= set(COLUMNS)
    )


def takes_pieces(calibration: Calibration) -> bool:
    """Whether each sample is corrected without its neighbours, and no user's field takes whole columns."""
    needs = {need for effect in _of_catalogue(calibration) for need in effect.needs}
    return not calibration.user_effects and "angular_acceleration" not in needs


def require_no_surroundings(calibration: Calibration) -> None:
    """Refuse effects that depend on more than rate and force, with InputError."""
    for effect in _of_catalogue(calibration):
        for need in effect.needs:
            if need in COLUMNS:
                raise InputError(
                    f"{effect.name} depends on {need.replace('_', ' ')}: use apply_recording, with a "
                    f"recording that has {COLUMNS[need]}"
                )
    for own in calibration.user_effects:
        raise InputError(f"{own.name} is a user's effect, its field takes whole columns: use apply_recording")


def require_surroundings(calibration: Calibration, recording: Recording) -> None:
    """Refuse a recording that lacks what an effect depends on, with InputError."""
    for effect in _of_catalogue(calibration):
        if "temperature" in effect.needs and recording.temperature_degc is None:
            raise InputError(
                f"{recording.name} has no temperature_degc (temp_degc in a file) and {effect.name} depends "
                "on it: record the temperature, or leave the effect out of the calibration"
            )
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
            f"{recording.name}: time_s goes back from sample {wrong[0]} to {wrong[0] + 1} and {name} "
            "depends on angular acceleration: give times in their order"
        )


# An effect that runs away ends at infinity; it is refused with a message of its own.
@np.errstate(over="ignore", invalid="ignore")
def remove_user_effects(calibration: Calibration, recording: Recording) -> Recording:
    """The raw recording of the same unit without the user's own effects; all else stays in it.

    The angular acceleration in the State that their fields get is the derivative of the rate without the
    effects of the catalogue.

    Raises InputError without a definition, and if the passes do not settle.
    """
    own = list(_own(calibration))
    if not own:
        return recording
    others = calibration.without_user_effects()
    size = np.hstack(
        (
            _size(calibration.gyroscope, recording.angular_rate),
            _size(calibration.accelerometer, recording.specific_force),
        )
    )
    rate, force = _core.correct_recording(others, recording)
    # Taken once: from pass to pass it would add noise.
    acceleration = State.of(recording, rate, force).angular_acceleration
    measured = np.isfinite(np.hstack((rate, force)))
    for _ in range(MAX_PASSES):
        on_rate, on_force = _added(own, State.of(recording, rate, force, acceleration))
        without = replace(
            recording,
            angular_rate=recording.angular_rate - on_rate @ calibration.gyroscope.sensitivity.T,
            specific_force=recording.specific_force - on_force @ calibration.accelerometer.sensitivity.T,
        )
        before = np.hstack((rate, force))
        rate, force = _core.correct_recording(others, without)
        change = np.abs(np.hstack((rate, force)) - before)
        limit = ROUNDING * (size + np.hstack((_largest(on_rate), _largest(on_force))))
        unsettled = measured & ~(change <= limit)
        if not unsettled.any():
            return without
    names = ", ".join(effect.name for effect, _ in own)
    raise InputError(
        f"{recording.name}: {names} cannot be undone, sample {unsettled.any(axis=1).argmax()} has not "
        f"settled in {MAX_PASSES} passes: what is added must be small against what it depends on"
    )


def _added(own: list[tuple[UserEffect, EffectValues]], state: State) -> tuple[FloatArray, FloatArray]:
    """What the user's effects add to the true rate and force."""
    on_rate, on_force = np.zeros_like(state.angular_rate), np.zeros_like(state.specific_force)
    for effect, values in own:
        target = on_rate if effect.sensor == "gyroscope" else on_force
        target += effect.at(state, values)
    return on_rate, on_force


def _size(triad: Triad, raw: SampleArray) -> FloatArray:
    """How large the numbers are whose rounding is in a corrected sample, (N, 3) in SI units."""
    inverse = np.abs(np.linalg.inv(triad.sensitivity))
    # As numbers: the lowest count of 16 bits has no positive counterpart among them.
    size = np.abs(raw.astype(np.float64, copy=False))
    return _largest((size + np.abs(triad.bias)) @ inverse.T)


def _largest(rows: FloatArray) -> FloatArray:
    """The largest magnitude of each row, in all three places."""
    return np.repeat(np.abs(rows).max(axis=1, keepdims=True), 3, axis=1)


def _own(calibration: Calibration) -> Iterator[tuple[UserEffect, EffectValues]]:
    for values in calibration.effects:
        effect = calibration.definition(values)
        if isinstance(effect, UserEffect):
            yield effect, values


def _of_catalogue(calibration: Calibration) -> Iterator[Effect]:
    for values in calibration.effects:
        effect = calibration.definition(values)
        if isinstance(effect, Effect):
            yield effect
