"""Definitions of effects: effects of the catalogue, and effects that a user writes in Python."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray
from imucal.document.name import require_name
from imucal.effects.effect import Effect, EffectParameter, EffectValues
from imucal.effects.table import catalogue_by_name
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.effects.state import State

__all__ = ["UserEffect", "by_name", "check_values", "counts_of", "definitions", "named_numbers"]

# Sensors on which a user-defined effect can act.
TRIADS: Final = ("accelerometer", "gyroscope")


@dataclass(frozen=True, eq=False)
class UserEffect:
    """A user-defined effect.

    name        must not be in the catalogue; parameters are called `<name>_<parameter>` in all results
    sensor      "accelerometer" (the effect adds a specific force) or "gyroscope" (it adds an angular rate)
    parameters  the parameters, in the order of the last index of the array that `field` returns
    field       function of the State that returns an array (N, 3, p): the error of each of N samples on the
                three axes, per unit of each of the p parameters. None if the calibration was loaded from a
                file without the definition

    Example: a gyroscope whose bias depends on the supply voltage in the column `supply_v`:

        def field(state):
            return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

        per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
        supply = imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)

    Raises InputError if the name exists in the catalogue or is not an identifier, if the sensor is unknown,
    and if there are no parameters.
    """

    name: str
    sensor: str
    parameters: tuple[EffectParameter, ...]
    field: Callable[[State], ArrayLike] | None

    def __post_init__(self) -> None:
        from imucal.effects.disturbance import disturbances

        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.name.isidentifier():
            raise InputError(f"{self.name!r} is not a valid name of an effect: use letters, digits and _")
        if self.name in catalogue_by_name() or self.name in {row.name for row in disturbances()}:
            raise InputError(
                f"the catalogue has an effect {self.name} already: give your effect another name"
            )
        if self.sensor not in TRIADS:
            raise InputError(f"the sensor of {self.name} is {self.sensor!r}: give one of {', '.join(TRIADS)}")
        names = [parameter.name for parameter in self.parameters]
        for name in names:
            # A parameter's name may start with a digit, because the name of the effect precedes it.
            if not f"_{name}".isidentifier():
                raise InputError(
                    f"{name!r} is not a valid name of a parameter of {self.name}: use letters, digits and _"
                )
        for parameter in self.parameters:
            require_name(parameter.unit, f"the unit of the parameter {parameter.name} of {self.name}")
        if not names or len(set(names)) < len(names):
            raise InputError(f"{self.name} has the parameters {names}: give one or more with different names")

    @property
    def plain(self) -> int:
        """Number of parameters: a user-defined effect has only one form, with all its parameters."""
        return len(self.parameters)

    @property
    def shape(self) -> None:
        """None: a user-defined effect has no shape, because its field is linear in all parameters.

        The shape of an effect of the catalogue is the parameter on which its field depends nonlinearly, such
        as a time constant.
        """
        return

    def required_field(self) -> Callable[[State], ArrayLike]:
        """The function that computes the error of the effect per unit of each parameter.

        Raises InputError if the effect was loaded from a file, because files do not contain functions.
        """
        if self.field is None:
            raise InputError(
                f"the definition of the effect {self.name} is not in the file: pass it as user_effects=[...] "
                "to Calibration.load"
            )
        return self.field

    def columns(self, state: State) -> FloatArray:
        """The error per unit of each parameter (the field of the effect) at each sample, (N, 3, p).

        Raises InputError if the definition is missing, if the function returns another shape, or if it
        returns values that are not finite at a sample with finite rate and force.
        """
        field = self.required_field()
        needed = (len(state.time_s), 3, len(self.parameters))
        try:
            columns = np.asarray(field(state), dtype=np.float64)
        except KeyError as error:
            raise InputError(
                f"the field of {self.name} needs {error}, but the recording has the auxiliary columns "
                f"{sorted(state.auxiliary)}"
            ) from error
        except (TypeError, ValueError) as error:
            raise InputError(f"the field of {self.name} cannot be evaluated: {error}") from error
        if columns.shape != needed:
            raise InputError(
                f"the field of {self.name} has the shape {columns.shape}, but {needed} is needed"
            )
        finite = np.isfinite(columns)
        if finite.all():
            return columns
        known = np.isfinite(state.angular_rate).all(axis=1) & np.isfinite(state.specific_force).all(axis=1)
        wrong = np.flatnonzero(known & ~finite.all(axis=(1, 2)))
        if len(wrong):
            raise InputError(
                f"the field of {self.name} is not finite at {len(wrong)} samples, first at sample {wrong[0]}"
            )
        return columns

    def at(self, state: State, values: EffectValues) -> FloatArray:
        """The error that the effect adds to the true rate, rad/s, or force, m/s^2, at each sample, (N, 3)."""
        check_values(self, values)
        columns = self.columns(state)
        # One product of the matrix of all samples and the vector is several times faster than a product for
        # each sample.
        added: FloatArray = columns.reshape(-1, columns.shape[2]) @ values.values
        return added.reshape(-1, 3)


def by_name(user_effects: Iterable[UserEffect]) -> dict[str, UserEffect]:
    """User-defined effects by name. Raises InputError for another type, and if two effects have one name."""
    found = {}
    for effect in user_effects:
        if not isinstance(effect, UserEffect):
            raise InputError(f"{effect!r} is no effect of your own: give a list of imucal.UserEffect")
        if effect.name in found:
            raise InputError(f"the effect {effect.name} is defined twice: give each effect its own name")
        found[effect.name] = effect
    return found


def definitions(user_effects: Sequence[UserEffect]) -> Mapping[str, Effect | UserEffect]:
    """All effects by name: effects of the catalogue and user-defined effects."""
    return {**catalogue_by_name(), **by_name(user_effects)}


def counts_of(effect: Effect | UserEffect) -> range:
    """Possible numbers of parameters of an effect, one for each form; the full form has all parameters."""
    return range(effect.plain, len(effect.parameters) + 1, effect.plain)


def check_values(effect: Effect | UserEffect, values: EffectValues) -> None:
    """Raise InputError if the number of values, or the presence of a shape, does not match the effect.

    The shape is the parameter on which the field depends nonlinearly, such as a time constant.
    """
    count = len(values.values)
    if count not in counts_of(effect):
        *others, full = map(str, counts_of(effect))
        listed = f"{', '.join(others)} or {full}" if others else full
        raise InputError(f"{effect.name} has {listed} parameters: {count} were given")
    if effect.shape is not None and values.shape is None:
        raise InputError(f"{effect.name} needs its shape {effect.shape.name}, {effect.shape.unit}")
    if effect.shape is None and values.shape is not None:
        raise InputError(f"{effect.name} has no shape: {values.shape} was given")


def named_numbers(effect: Effect | UserEffect, values: EffectValues) -> list[tuple[EffectParameter, float]]:
    """Pair each parameter with its value; the shape (such as a time constant) comes last."""
    numbers = list(zip(effect.parameters, values.values.tolist(), strict=False))
    if effect.shape is not None and values.shape is not None:
        numbers.append((effect.shape, float(values.shape)))
    return numbers
