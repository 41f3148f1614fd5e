"""Composition of two calibrations, of which the second was estimated on data that the first had corrected.

    raw = T1 (x + e1(x)) + b1,      x = T2 (true + e2(true)) + b2
    raw = T1 T2 (true + e2(true) + T2^-1 e1(x)) + b1 + T1 b2

T, b and e are the sensitivity, the bias and the effects of a calibration, and x are data that the first
calibration has corrected. `_moved` expresses e1 as a function of the true values, or refuses an effect for
which this is impossible.

The second calibration has estimated the errors that remain after the first correction. These errors include
the errors of the first calibration's parameters. So the bias and sensitivity of the result have the
uncertainty of the second calibration alone. Effects of the first calibration that the second does not
estimate keep their uncertainty.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.correction import left_in_data
from imucal.calibration.frame import is_added
from imucal.calibration.model import SensorModel
from imucal.calibration.propagation import jacobian, known_covariance
from imucal.calibration.provenance import Provenance
from imucal.calibration.triad import Triad, base_count
from imucal.document.source import Source
from imucal.effects.definition import UserEffect
from imucal.effects.effect import EffectValues
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED, Axes

__all__ = ["compose"]

# Fields of a Calibration that form its sensor model. Composition computes them from both sensor models.
MODEL: Final = (
    "accelerometer",
    "gyroscope",
    "frame",
    "accel_unit",
    "gyro_unit",
    "gravity_mps2",
    "effects",
    "user_effects",
    "axes",
)
# Effects whose parameters form a matrix. If the first calibration has such an effect, composition transforms
# its matrix with the sensitivity of the second calibration.
G_SENSITIVITY: Final = "gyro_g_sensitivity"
ANGULAR_ACCELERATION: Final = "gyro_angular_acceleration"
# Effect with one parameter, a time delay, which a composition does not change.
DELAY: Final = "gyro_time_offset"


def compose(first: Calibration, second: Calibration, *, files: tuple[Source, ...] = ()) -> Calibration:
    """Compose two calibrations into one whose correction equals that by `first` followed by that by `second`.

    second   estimated on recordings that `first` has corrected (`imucal apply`)
    files    the files of the two calibrations, which are recorded in the provenance of the result

    The result has the body frame of `second`, and the raw units and axes of `first`. If only one of the two
    calibrations has a gyroscope, the result has this gyroscope. The result has no covariance if `second` has
    no covariance.

    Raises InputError if `second` expects raw counts, if both were estimated on the same recordings or belong
    to different units, and if an effect of `first` cannot be expressed as a function of the true values.
    """
    require_calibration(first)
    require_calibration(second)
    _require_composable(first, second)

    model = _composed(first, second)
    covariance, names = _covariance(first, second)
    fields: dict[str, Any] = {name: getattr(model, name) for name in MODEL}
    return Calibration(
        **fields,
        references=second.references,
        covariance=covariance,
        covariance_names=names,
        noise=second.noise,
        temperature_range_degc=_temperature_range(first, second),
        # The result is usable, but its residuals are not known, because no recording was corrected by both
        # calibrations.
        verdict="incomplete",
        reasons=(
            "two calibrations were combined, and the combination was not evaluated on any recording: use "
            "imucal evaluate",
        ),
        provenance=Provenance(
            tuple(dict.fromkeys((*first.provenance.files, *second.provenance.files))),
            # The field `control_files` is empty, because no control recording has been corrected by both
            # calibrations.
            (),
            str(_core.__version__),
            second.provenance.date,
            second.provenance.operator,
            composed_of=files,
        ),
        serial_number=second.serial_number or first.serial_number,
    )


def _require_composable(first: Calibration, second: Calibration) -> None:
    # The gyroscope of the second calibration may expect raw counts if the first has no gyroscope, because
    # the result then takes this gyroscope unchanged.
    gyro_is_raw = second.gyro_unit == "lsb" and None not in (first.gyroscope, second.gyroscope)
    if second.accel_unit == "lsb" or gyro_is_raw:
        both = "lsb" in (first.accel_unit, first.gyro_unit)
        which = "both calibrations expect raw counts" if both else "the second calibration expects raw counts"
        raise InputError(
            f"{which}, but the first gives corrected samples in m/s^2 and rad/s: the second was made from "
            "raw samples and replaces the first, so use it alone; or correct its recordings with the first "
            "(imucal apply) and calibrate again"
        )
    if (
        None not in (first.serial_number, second.serial_number)
        and first.serial_number != second.serial_number
    ):
        raise InputError(
            f"the first calibration is of unit {first.serial_number}, the second of unit "
            f"{second.serial_number}: give two calibrations of the same unit"
        )
    shared = second.provenance.seen_in(first.provenance.files)
    if shared:
        raise InputError(
            f"both calibrations are made of {', '.join(source.path for source in shared)}, so the second was "
            "not made of data that the first has corrected: use one of them alone"
        )


def _composed(first: SensorModel, second: SensorModel) -> SensorModel:
    """The sensor model whose correction equals the correction by `first` followed by that by `second`."""
    axes = Axes.parse(second.axes)
    accel1, accel2 = first.accelerometer, _along(second.accelerometer, axes.accel)
    gyro1, gyro2 = first.gyroscope, None
    if second.gyroscope is not None:
        gyro2 = _along(second.gyroscope, axes.gyro)
    step = gyro2 or Triad(np.eye(3), np.zeros(3))
    gyro_bias = step.bias
    moved = []
    left = left_in_data(first)
    for values in first.effects:
        if values.name not in left:
            moved.append(_moved(first, values, accel2, step, second))
            if values.name == G_SENSITIVITY:
                # The g-sensitivity of the first calibration, times the accelerometer bias of the second, is a
                # constant rate and adds to the gyroscope bias.
                gyro_bias = gyro_bias + values.values.reshape(3, 3) @ accel2.bias
    # A product of lower triangular matrices is lower triangular, so two calibrations in the frame
    # "triangular" give a result in this frame. Other products have no special form.
    triangular = first.frame == second.frame == "triangular" and second.axes == UNCHANGED
    return SensorModel(
        _product(accel1, accel2.sensitivity, accel2.bias),
        gyro2 if gyro1 is None else _product(gyro1, step.sensitivity, gyro_bias),
        "triangular" if triangular else "given",
        first.accel_unit,
        second.gyro_unit if gyro1 is None else first.gyro_unit,
        second.gravity_mps2,
        _together(moved, second.effects),
        _definitions(first, second),
        first.axes,
    )


def _product(first: Triad, sensitivity: FloatArray, bias: FloatArray) -> Triad:
    """The triad whose correction equals a correction by `first`, then one with `sensitivity` and `bias`."""
    return Triad(first.sensitivity @ sensitivity, first.bias + first.sensitivity @ bias)


def _along(triad: Triad, axes: FloatArray) -> Triad:
    """Convert a triad for samples after the axis remapping `axes`, (3, 3), to one for samples before it."""
    return Triad(axes.T @ triad.sensitivity, axes.T @ triad.bias)


def _definitions(first: SensorModel, second: SensorModel) -> tuple[UserEffect, ...]:
    """The user-defined effects of both models. Raises InputError if different effects have the same name."""
    found = {effect.name: effect for effect in first.user_effects}
    for effect in second.user_effects:
        other = found.setdefault(effect.name, effect)
        if other is not effect and getattr(other, "text", other) != getattr(effect, "text", effect):
            raise InputError(
                f"both calibrations have an effect {effect.name}, with different definitions: rename one of "
                "the effects"
            )
    return tuple(found.values())


def _moved(
    first: SensorModel, values: EffectValues, accel2: Triad, gyro2: Triad, second: SensorModel
) -> EffectValues:
    """An effect e1 of the first calibration as a function of the true values, T2^-1 e1(x(true)).

    The docstring of the module defines T2, e1 and x. `accel2` and `gyro2` are the triads of the second
    calibration.

    Raises InputError if the effect cannot be written in this form.
    """
    accel_t, gyro_t = accel2.sensitivity, gyro2.sensitivity
    sensors = {second.definition(effect).sensor for effect in second.effects}
    name, numbers = values.name, values.values
    moved: npt.NDArray[np.floating[Any]] = numbers
    if is_added(first, values):
        matrix = accel_t if first.definition(values).sensor == "accelerometer" else gyro_t
        moved = np.linalg.solve(matrix, numbers.reshape(-1, 3).T).T
    elif name == G_SENSITIVITY and "accelerometer" not in sensors:
        moved = np.linalg.solve(gyro_t, numbers.reshape(3, 3) @ accel_t)
    elif name == ANGULAR_ACCELERATION and "gyroscope" not in sensors:
        moved = np.linalg.solve(gyro_t, numbers.reshape(3, 3) @ gyro_t)
    elif not (name == DELAY and "gyroscope" not in sensors) and not _is_neutral(accel2, gyro2, sensors):
        raise InputError(
            f"the first calibration has the effect {name}, which depends on rate or force, and the second "
            "changes rate or force: no effect of the catalogue describes both together; correct recordings "
            "in two steps (imucal apply), or calibrate raw recordings with this effect"
        )
    return replace(values, values=np.asarray(moved, dtype=np.float64).ravel())


def _is_neutral(accel2: Triad, gyro2: Triad, sensors: set[str]) -> bool:
    """Whether the second calibration, whose effects act on `sensors`, leaves every sample unchanged."""
    return not sensors and all(
        np.array_equal(triad.sensitivity, np.eye(3)) and not triad.bias.any() for triad in (accel2, gyro2)
    )


def _together(first: list[EffectValues], second: tuple[EffectValues, ...]) -> tuple[EffectValues, ...]:
    """The sum of the effects of both models.

    Raises InputError if an effect of both models has different time constants.
    """
    found = {values.name: values for values in first}
    for values in second:
        if (other := found.get(values.name)) is not None:
            if other.shape != values.shape:
                raise InputError(
                    f"{values.name} has the time constant {other.shape} s in the first calibration and "
                    f"{values.shape} s in the second: their sum is no effect of the catalogue; correct in "
                    "two steps"
                )
            # Some effects have a plain form with fewer parameters than their full form. The plain form equals
            # the full form if the parameters that the plain form lacks are zero.
            total = np.zeros(max(len(other.values), len(values.values)))
            total[: len(other.values)] += other.values
            total[: len(values.values)] += values.values
            values = replace(values, values=total)
        found[values.name] = values
    return tuple(found.values())


def _covariance(first: Calibration, second: Calibration) -> tuple[FloatArray | None, tuple[str, ...]]:
    """The covariance of the composed calibration, and the names of the parameters in this covariance.

    The covariance is None if `second` has no covariance.
    """
    from_second, from_first = known_covariance(second), known_covariance(first)
    names = [parameter.name for parameter in _composed(first, second).parameters]
    if from_second is None:
        return None, ()
    to_second = jacobian(lambda model: _composed(first, model), second)
    covariance = to_second @ from_second @ to_second.T
    # Some parameters are estimated only in the calibration `first`, such as parameters of its effects or of
    # its gyroscope. `places` are the indices of these parameters in `first.parameters`, and `alone` are their
    # names.
    estimated = tuple(f"{values.name}_" for values in second.effects)
    base = base_count(first.frame, has_gyroscope=first.gyroscope is not None)
    both = base_count(first.frame, has_gyroscope=second.gyroscope is not None)
    places, alone = [], []
    for k, name in enumerate(parameter.name for parameter in first.parameters):
        if both <= k < base or (k >= base and not name.startswith(estimated)):
            places.append(k)
            alone.append(name)
    if places and from_first is not None:
        to_first = jacobian(lambda model: _composed(model, second), first)[:, places]
        covariance = covariance + to_first @ from_first[np.ix_(places, places)] @ to_first.T
        alone = []
    kept = [k for k, name in enumerate(names) if name not in alone]
    covariance = (covariance + covariance.T) / 2
    return covariance[np.ix_(kept, kept)], tuple(names[k] for k in kept)


def _temperature_range(first: Calibration, second: Calibration) -> tuple[float, float] | None:
    """The temperature range in which the thermal effects of both calibrations are valid.

    If neither calibration has thermal effects, the result is the range of `second`.
    """
    ranges = [
        calibration.temperature_range_degc
        for calibration in (first, second)
        if calibration.temperature_effects and calibration.temperature_range_degc is not None
    ]
    if not ranges:
        return second.temperature_range_degc
    low, high = max(low for low, _ in ranges), min(high for _, high in ranges)
    return (low, high) if low <= high else ranges[-1]
