"""Options of an estimation in the compiled library."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.triad import Frame
from imucal.errors import InputError
from imucal.recording.recording import Recording

if TYPE_CHECKING:
    from imucal.effects.definition import UserEffect
    from imucal.rig.unit import Unit

__all__ = ["Options", "UserField", "Wander", "asked_for", "wander_of"]


class UserField(NamedTuple):
    """A user-defined effect for the compiled library.

    columns   for each recording, the error per unit of each parameter at each sample, (N, 3, p)
    """

    name: str
    sensor: str
    typical: tuple[float, ...]
    columns: tuple[FloatArray, ...]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of an estimation; the compiled library reads the fields by name.

    effects      names of the effects of the catalogue to estimate, each with the number of parameters of the
                 requested form
    user_fields  user-defined effects, evaluated at each sample of each recording
    partly       names of the effects that were requested as NAME:seen, so that their parameters have a prior
    accelerometer   nine parameters of a calibrated accelerometer in the symmetric frame, and their
                    covariance, as a prior
    hold         names of held parameters or groups, each with the mean and standard deviation of its prior
    profile      spread of the parameters between units (standard deviation), by group of parameters, from the
                 profile of the unit
    wander       bias instability and random walk of the accelerometer and of the gyroscope, from the profile
                 of the unit
    The other fields are the arguments of `calibrate`.
    """

    gravity_mps2: float
    min_rest_s: float
    gravity_sigma_mps2: float | None = None
    clock_ppm: float | None = None
    frame: Frame = "symmetric"
    exclude_saturated: bool = False
    accel_nominal: float | None = None
    gyro_nominal: float | None = None
    effects: tuple[tuple[str, int], ...] = ()
    user_fields: tuple[UserField, ...] = ()
    joint: bool = True
    wander: tuple[Wander, Wander] | None = None
    folds: int | None = None
    partly: tuple[str, ...] = ()
    accelerometer: tuple[list[float], list[list[float]]] | None = None
    model: str = "full"
    hold: tuple[tuple[str, float | None, float | None], ...] = ()
    profile: tuple[tuple[str, list[float]], ...] = ()
    max_iterations: int = _core.MAX_ITERATIONS


class Wander(NamedTuple):
    """Bias instability and random walk of a sensor on the axes x, y and z, SI units."""

    bias_instability: tuple[float, ...]
    random_walk: tuple[float, ...]


def wander_of(unit: Unit | str | os.PathLike[str] | None) -> tuple[Wander, Wander] | None:
    """Bias instability and random walk of both sensors in the profile `unit`; None if all of them are 0."""
    if unit is None:
        return None
    from imucal.rig.unit import unit_of

    profile = unit_of(unit)
    of = [
        Wander((sensor.bias_instability,) * 3, tuple(map(float, sensor.random_walk)))
        for sensor in (profile.accelerometer, profile.gyroscope)
    ]
    still = not any(value for wander in of for value in (*wander.bias_instability, *wander.random_walk))
    return None if still else (of[0], of[1])


def asked_for(
    effects: Sequence[str | UserEffect], recordings: Sequence[Recording]
) -> tuple[tuple[tuple[str, int], ...], tuple[str, ...], tuple[UserEffect, ...]]:
    """Sort the requested effects into three tuples.

    The first tuple contains, for each effect of the catalogue, its name and the number of parameters of the
    requested form. The second contains the names that were requested as NAME:seen. The third contains the
    user-defined effects, including formulas.

    recordings  the recordings on which formulas among the effects are evaluated
    """
    if isinstance(effects, str):
        raise InputError(f"effects is the string {effects!r}: give a list of names")
    if not effects:
        return (), (), ()
    from imucal.effects.definition import UserEffect
    from imucal.effects.formula import is_formula
    from imucal.effects.formula_effect import formula_effects
    from imucal.effects.table import find

    wanted, partly = [], []
    formulas = [effect for effect in effects if isinstance(effect, str) and is_formula(effect)]
    for effect in effects:
        if isinstance(effect, UserEffect) or effect in formulas:
            continue
        if not isinstance(effect, str):
            raise InputError(
                f"{effect!r} is no effect: give names of the catalogue, formulas, or imucal.UserEffect"
            )
        name, colon, form = effect.partition(":")
        row = find(name)
        forms = row.forms | {"seen": row.plain}
        if colon and form not in forms:
            others = " or ".join(f"{name}:{form}" for form in forms)
            raise InputError(f"{effect!r} is no form of {name}: give {name}, {others}")
        wanted.append((name, forms.get(form, row.plain)))
        partly += [name] if form == "seen" else []
    own = (
        *(effect for effect in effects if isinstance(effect, UserEffect)),
        *formula_effects(formulas, recordings),
    )
    return tuple(wanted), tuple(partly), own
