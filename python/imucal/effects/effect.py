"""Errors of a sensor beyond sensitivity and bias: the catalogue of effects, and user-defined effects.

    measured = T (true + sum of Phi(state) theta) + bias          docs/model.md (15)

An effect has a name, a sensor, parameters theta with units and typical sizes, and a field Phi. For each
sample, Phi is the (3, p) derivative of the sensor's input with respect to the parameters, in the body frame.
The catalogue comes from the compiled library. A `UserEffect` is written in Python and used in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import FloatArray, SampleArray, as_rows
from imucal.effects.disturbance import disturbances
from imucal.errors import InputError
from imucal.recording.recording import Recording

__all__ = [
    "Alias",
    "Effect",
    "EffectParameter",
    "EffectValues",
    "State",
    "UserEffect",
    "by_name",
    "catalogue",
    "find",
    "not_known",
]

TRIADS: Final = ("accelerometer", "gyroscope")


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect: its name within the effect, SI unit, and typical size in a MEMS sensor."""

    name: str
    unit: str
    typical: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.typical) and self.typical > 0):
            raise InputError(
                f"the typical size of parameter {self.name!r} is {self.typical}: a positive number is needed"
            )


@dataclass(frozen=True)
class Alias:
    """Another effect with similar residuals, and the data that distinguish the two."""

    name: str
    told_apart_by: str


@dataclass(frozen=True)
class Effect:
    """One row of the catalogue.

    sensor      "accelerometer", "gyroscope" or "encoder"
    parameters  in the order of the columns of the field
    plain       number of parameters of the plain form: the first ones; the full form has all parameters
    shape       a positive parameter on which the field depends nonlinearly, or None
    needs       inputs of the field other than rate and force: "angular_acceleration", "attitude",
                "temperature", "time", ...
    formula     the field times its parameters
    observable  the data in which the effect is observable
    """

    name: str
    sensor: str
    parameters: tuple[EffectParameter, ...]
    plain: int
    shape: EffectParameter | None
    needs: tuple[str, ...]
    formula: str
    observable: str
    aliases: tuple[Alias, ...]


@dataclass(frozen=True, eq=False)
class EffectValues:
    """Values of an effect: `values` (p,) in the order of its parameters, and its shape if it has one.

    Raises InputError if a value is not finite, or if the shape is not positive.
    """

    name: str
    values: FloatArray
    shape: float | None = None

    def __post_init__(self) -> None:
        values = as_rows(self.values, f"the values of {self.name}")
        if not np.isfinite(values).all():
            raise InputError(
                f"the values of {self.name} hold {values[~np.isfinite(values)][0]}: finite numbers are needed"
            )
        if self.shape is not None and not (math.isfinite(self.shape) and self.shape > 0):
            raise InputError(f"the shape of {self.name} is {self.shape}: a positive number is needed")
        # A copy: a later change of the caller's array must not change a calibration.
        values = values.copy()
        values.flags.writeable = False
        object.__setattr__(self, "values", values)


@dataclass(frozen=True, eq=False)
class State:
    """The true state of N samples, the input of fields. A quantity that is not known is None.

    angular_rate          (N, 3)  body frame, rad/s
    specific_force        (N, 3)  body frame, m/s^2
    time_s                (N,)    since the first sample of the recording, s
    angular_acceleration  (N, 3)  derivative of the angular rate, rad/s^2
    temperature_degc      (N,)    degC
    auxiliary             name -> (N,), further columns of the recording
    rotation_wxyz         (N, 4)  attitude quaternion, maps a vector from body to world
    stand_rad             (N, 3)  true angles of the stand's motors, rad
    stand_rate_radps      (N, 3)  their derivatives, rad/s; zero if not known
    stand_direction       (N, 3)  sign of the last motion of each motor, 0 before any; zero if not known

    Raises InputError if an array has another shape.
    """

    angular_rate: FloatArray
    specific_force: FloatArray
    time_s: FloatArray
    angular_acceleration: FloatArray | None = None
    temperature_degc: FloatArray | None = None
    auxiliary: Mapping[str, FloatArray] = field(default_factory=dict)
    rotation_wxyz: FloatArray | None = None
    stand_rad: FloatArray | None = None
    stand_rate_radps: FloatArray | None = None
    stand_direction: FloatArray | None = None

    def __post_init__(self) -> None:
        rows = len(as_rows(self.time_s, "time_s"))
        for name, width in (
            ("angular_rate", 3),
            ("specific_force", 3),
            ("time_s", None),
            ("angular_acceleration", 3),
            ("temperature_degc", None),
            ("rotation_wxyz", 4),
            ("stand_rad", 3),
            ("stand_rate_radps", 3),
            ("stand_direction", 3),
        ):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, as_rows(values, name, width, rows))
        auxiliary = {
            name: as_rows(values, f"auxiliary[{name!r}]", None, rows)
            for name, values in self.auxiliary.items()
        }
        object.__setattr__(self, "auxiliary", auxiliary)

    @staticmethod
    def of(
        recording: Recording,
        angular_rate: SampleArray,
        specific_force: SampleArray,
        angular_acceleration: FloatArray | None = None,
    ) -> State:
        """The state at each sample of a recording with the given true rate and force.

        Without `angular_acceleration`, it is computed as the derivative of the rate; NaN for a single sample.
        """
        rate, force = as_rows(angular_rate, "angular_rate", 3), as_rows(specific_force, "specific_force", 3)
        if angular_acceleration is None:
            angular_acceleration = (
                _core.angular_acceleration(recording.time_s, rate)
                if len(recording) > 1
                else np.full((len(recording), 3), np.nan)
            )
        return State(
            rate,
            force,
            recording.time_s - recording.time_s[:1],
            angular_acceleration=angular_acceleration,
            temperature_degc=recording.temperature_degc,
            auxiliary=recording.auxiliary,
        )


@dataclass(frozen=True, eq=False)
class UserEffect:
    """A user-defined effect.

    name        must not be in the catalogue; parameters are called `<name>_<parameter>` in all results
    sensor      "accelerometer" (the field is a specific force) or "gyroscope" (it is an angular rate)
    parameters  one per column of the field
    field       function of the State that returns the field, (N, 3, p); None if the calibration was loaded
                from a file without the definition

    Example: a gyroscope whose bias depends on the supply voltage in the column `supply_v`:

        def field(state):
            return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

        per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
        supply = imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)

    Raises InputError for a name that exists or is not an identifier, for an unknown sensor, and without
    parameters.
    """

    name: str
    sensor: str
    parameters: tuple[EffectParameter, ...]
    field: Callable[[State], ArrayLike] | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.name.isidentifier():
            raise InputError(f"the effect's name {self.name!r} cannot be one: use letters, digits and _")
        if self.name in _rows() or self.name in {row.name for row in disturbances()}:
            raise InputError(f"imucal has an effect of the name {self.name}: give yours another name")
        if self.sensor not in TRIADS:
            raise InputError(f"the sensor of {self.name} is {self.sensor!r}: give one of {', '.join(TRIADS)}")
        names = [parameter.name for parameter in self.parameters]
        if not names or len(set(names)) < len(names):
            raise InputError(f"{self.name} has the parameters {names}: give one or more with different names")

    @property
    def plain(self) -> int:
        """The number of parameters; a user-defined effect has only one form."""
        return len(self.parameters)

    @property
    def shape(self) -> None:
        """None, because a user-defined field is linear in all parameters."""
        return

    def required_field(self) -> Callable[[State], ArrayLike]:
        """The field; InputError if the effect was loaded from a file, which does not contain the function."""
        if self.field is None:
            raise InputError(
                f"the definition of the effect {self.name} is not in the file: pass it as user_effects=[...] "
                "to Calibration.load"
            )
        return self.field

    def columns(self, state: State) -> FloatArray:
        """The field at each sample, (N, 3, p).

        Raises InputError if the definition is missing, if the function returns another shape, or if it
        returns values that are not finite at a sample with finite rate and force.
        """
        field = self.required_field()
        needed = (len(state.time_s), 3, len(self.parameters))
        try:
            columns = np.asarray(field(state), dtype=np.float64)
        except KeyError as error:
            raise InputError(
                f"the field of {self.name} asks for {error}, the recording has the auxiliary columns "
                f"{sorted(state.auxiliary)}"
            ) from error
        except (TypeError, ValueError) as error:
            raise InputError(f"the field of {self.name} cannot be evaluated: {error}") from error
        if columns.shape != needed:
            raise InputError(f"the field of {self.name} has the shape {columns.shape}, {needed} is needed")
        known = np.isfinite(state.angular_rate).all(axis=1) & np.isfinite(state.specific_force).all(axis=1)
        wrong = np.flatnonzero(known & ~np.isfinite(columns).all(axis=(1, 2)))
        if len(wrong):
            raise InputError(
                f"the field of {self.name} is not finite at {len(wrong)} samples, first at sample {wrong[0]}"
            )
        return columns

    def at(self, state: State, values: EffectValues) -> FloatArray:
        """The contribution of the effect to the true rate or force at each sample, (N, 3)."""
        check_values(self, values)
        added: FloatArray = self.columns(state) @ values.values
        return added


def catalogue() -> tuple[Effect, ...]:
    """All effects of the catalogue, in the order of their families."""
    return tuple(_rows().values())


@cache
def _rows() -> Mapping[str, Effect]:
    return {
        row.name: Effect(
            row.name,
            row.sensor,
            tuple(EffectParameter(*parameter) for parameter in row.parameters),
            row.plain,
            None if row.shape is None else EffectParameter(*row.shape),
            tuple(row.needs),
            row.formula,
            row.observable,
            tuple(Alias(*alias) for alias in row.aliases),
        )
        for row in _core.effects()
    }


def find(name: str) -> Effect:
    """The effect with this name; InputError with similar names if there is none."""
    if name in _rows():
        return _rows()[name]
    for row in disturbances():
        if name == row.name:
            what = "noise" if row.kind == "noise" else "a fault"
            raise InputError(f"{name} is {what}: it has no field, so it is not estimated or taken away")
    raise not_known(name, _rows())


def not_known(name: str, known: Iterable[str]) -> InputError:
    """The error for an unknown name, with similar names."""
    import difflib

    close = difflib.get_close_matches(name, list(known), cutoff=0.5)
    hint = f"is it {' or '.join(close)}? " if close else ""
    return InputError(f"there is no effect {name!r}: {hint}`imucal effects` lists them all")


def check_values(effect: Effect | UserEffect, values: EffectValues) -> None:
    """Raise InputError if the number of values, or the shape, does not match the effect."""
    count, plain, full = len(values.values), effect.plain, len(effect.parameters)
    if count not in (plain, full):
        forms = f"{full} parameters" if plain == full else f"{plain} parameters, or {full} in its full form"
        raise InputError(f"{effect.name} has {forms}: {count} were given")
    if effect.shape is not None and values.shape is None:
        raise InputError(f"{effect.name} needs its shape {effect.shape.name}, {effect.shape.unit}")
    if effect.shape is None and values.shape is not None:
        raise InputError(f"{effect.name} has no shape: {values.shape} was given")


def named_numbers(effect: Effect | UserEffect, values: EffectValues) -> list[tuple[EffectParameter, float]]:
    """Each parameter with its value, the shape last."""
    numbers = list(zip(effect.parameters, values.values.tolist(), strict=False))
    if effect.shape is not None and values.shape is not None:
        numbers.append((effect.shape, float(values.shape)))
    return numbers


def by_name(user_effects: Iterable[UserEffect]) -> dict[str, UserEffect]:
    """User-defined effects by name; InputError for any other type."""
    found = {}
    for effect in user_effects:
        if not isinstance(effect, UserEffect):
            raise InputError(f"{effect!r} is no effect of your own: give a list of imucal.UserEffect")
        if effect.name in found:
            raise InputError(f"the effect {effect.name} is defined twice: give each one name")
        found[effect.name] = effect
    return found


def definitions(user_effects: Sequence[UserEffect]) -> Mapping[str, Effect | UserEffect]:
    """All effects by name: those of the catalogue and the user-defined ones."""
    return {**_rows(), **by_name(user_effects)}
