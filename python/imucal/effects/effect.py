"""What a real sensor does beyond sensitivity and bias: the catalogue of effects, and effects of one's own.

    measured = T (true + sum of Phi(state) theta) + bias          docs/model.md (15)

An effect is a name, a sensor, parameters theta with units and typical sizes, and the field Phi: for each
sample the (3, p) derivative of what the sensor sees by the parameters, in the body frame. The catalogue is
the one of the compiled library; a `UserEffect` is written in Python and used in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

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
    """One number of an effect: its name in the effect, SI unit, and the size of an ordinary MEMS sensor."""

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
    """Something whose trace in the data is alike, and what tells the two apart."""

    name: str
    told_apart_by: str


@dataclass(frozen=True)
class Effect:
    """One row of the catalogue.

    sensor      "accelerometer", "gyroscope" or "encoder"
    parameters  in the order of the columns of the field
    plain       the plain form has this many of the parameters, the first ones; the full form has them all
    shape       a positive number that the field depends on other than linearly, or None
    needs       what the field depends on besides rate and force: "angular_acceleration", "attitude",
                "temperature", "time", ...
    formula     the field times its parameters
    observable  the data that shows it
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
    """An effect with numbers: `values` (p,) in the order of its parameters, and its shape if it has one.

    Raises InputError if a number is not finite, or the shape not positive.
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
        # A copy, as a later change of the caller's array must not reach a calibration.
        values = values.copy()
        values.flags.writeable = False
        object.__setattr__(self, "values", values)


@dataclass(frozen=True, eq=False)
class State:
    """The true state of N samples, on which fields depend; None is not known.

    angular_rate          (N, 3)  body frame, rad/s
    specific_force        (N, 3)  body frame, m/s^2
    time_s                (N,)    since the first sample of the recording, s
    angular_acceleration  (N, 3)  derivative of the angular rate, rad/s^2
    temperature_degc      (N,)    degC
    auxiliary             name -> (N,), what else was recorded along
    rotation_wxyz         (N, 4)  attitude: takes a vector from the body to the world
    stand_rad             (N, 3)  true angles of the stand's motors, rad
    stand_rate_radps      (N, 3)  their derivatives, rad/s; zero if not known
    stand_direction       (N, 3)  sign of the last motion of each motor, 0 before any; zero if not known

    Raises InputError for other shapes.
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
        """The state at each sample of a recording, whose true rate and force are given.

        Without `angular_acceleration` it is the derivative of the rate, NaN for a single sample.
        """
        from imucal import _core

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
    """An effect of one's own.

    name        not one of the catalogue; with `_` and a parameter's name it names that parameter everywhere
    sensor      "accelerometer" (the field is a specific force) or "gyroscope" (it is an angular rate)
    parameters  one for each column of the field
    field       the function of the State that gives the field, (N, 3, p). A calibration that was read from
                a file without this definition has None here

    A gyroscope whose bias follows the supply voltage, recorded in a column `supply_v`:

        def field(state):
            return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

        per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
        supply = imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)

    Raises InputError for a name that is taken or cannot be one, for another sensor, and without parameters.
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
        """The number of parameters: a user's effect has one form."""
        return len(self.parameters)

    @property
    def shape(self) -> None:
        """A user's field is linear in all parameters."""
        return

    def required_field(self) -> Callable[[State], ArrayLike]:
        """The field; InputError if the effect was read from a file, which does not have it."""
        if self.field is None:
            raise InputError(
                f"the definition of the effect {self.name} is not in the file: pass it as user_effects=[...] "
                "to Calibration.load"
            )
        return self.field

    def columns(self, state: State) -> FloatArray:
        """The field at each sample, (N, 3, p).

        Raises InputError if the definition is missing, and if the function gives another shape or, where the
        state is known, numbers that are not finite.
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
        """What the effect adds to the true rate or force at each sample, (N, 3)."""
        check_values(self, values)
        added: FloatArray = self.columns(state) @ values.values
        return added


def catalogue() -> tuple[Effect, ...]:
    """All effects of the library, family by family."""
    return tuple(_rows().values())


@cache
def _rows() -> Mapping[str, Effect]:
    from imucal import _core

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
    """The effect of this name; InputError, with names that are like it, if there is none."""
    if name in _rows():
        return _rows()[name]
    for row in disturbances():
        if name == row.name:
            what = "noise" if row.kind == "noise" else "a fault"
            raise InputError(f"{name} is {what}: it has no field, so it is not estimated or taken away")
    raise not_known(name, _rows())


def not_known(name: str, known: Iterable[str]) -> InputError:
    """The error for a name that no effect has, with those that are like it."""
    import difflib

    close = difflib.get_close_matches(name, list(known), cutoff=0.5)
    hint = f"is it {' or '.join(close)}? " if close else ""
    return InputError(f"there is no effect {name!r}: {hint}`imucal effects` lists them all")


def check_values(effect: Effect | UserEffect, values: EffectValues) -> None:
    """Refuse numbers that do not fit the effect, with InputError."""
    count, plain, full = len(values.values), effect.plain, len(effect.parameters)
    if count not in (plain, full):
        forms = f"{full} parameters" if plain == full else f"{plain} parameters, or {full} in its full form"
        raise InputError(f"{effect.name} has {forms}: {count} were given")
    if effect.shape is not None and values.shape is None:
        raise InputError(f"{effect.name} needs its shape {effect.shape.name}, {effect.shape.unit}")
    if effect.shape is None and values.shape is not None:
        raise InputError(f"{effect.name} has no shape: {values.shape} was given")


def named_numbers(effect: Effect | UserEffect, values: EffectValues) -> list[tuple[EffectParameter, float]]:
    """Each parameter with its number, the shape last."""
    numbers = list(zip(effect.parameters, values.values.tolist(), strict=False))
    if effect.shape is not None and values.shape is not None:
        numbers.append((effect.shape, float(values.shape)))
    return numbers


def by_name(user_effects: Iterable[UserEffect]) -> dict[str, UserEffect]:
    """A user's own effects by name; InputError for anything else."""
    found = {}
    for effect in user_effects:
        if not isinstance(effect, UserEffect):
            raise InputError(f"{effect!r} is no effect of your own: give a list of imucal.UserEffect")
        if effect.name in found:
            raise InputError(f"the effect {effect.name} is defined twice: give each one name")
        found[effect.name] = effect
    return found


def definitions(user_effects: Sequence[UserEffect]) -> Mapping[str, Effect | UserEffect]:
    """All effects that a name may mean, by name; a user's own has none of ours."""
    return {**_rows(), **by_name(user_effects)}
