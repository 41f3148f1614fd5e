"""The sensor model of one unit: two triads of three sensor axes each, and effects.

    measured = T (true + effects(true)) + bias

T is the `sensitivity` of a triad. Most units have no effects (`imucal.effects`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

import imucal._core as _core
from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES, Frame, Parameter, Triad, as_frame
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED, Axes
from imucal.recording.recording import AccelUnit, GyroUnit, Recording, Sensor
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.effects.definition import UserEffect
    from imucal.effects.effect import Effect, EffectValues

__all__ = ["SensorModel"]

Model = TypeVar("Model", bound="SensorModel")


@dataclass(frozen=True, eq=False, repr=False)
class SensorModel:
    """The parameters of the sensor model, without their uncertainty.

    accelerometer, gyroscope  sensitivity and bias of the three axes of each sensor; gyroscope is None for an
                              accelerometer alone
    frame                     the body frame, see `imucal.calibration.triad`: "symmetric", "triangular", or
                              "given" by another program or by the composition of two calibrations
    accel_unit, gyro_unit     raw units of the recordings: SI units or "lsb"
    gravity_mps2              local gravity that the calibration assumed, m/s^2
    effects                   effects from the catalogue and user-defined effects, with their values
    user_effects              definitions of the user-defined effects
    axes                      axis remapping of the recordings, the argument `axes` of `imucal.read`
    """

    accelerometer: Triad
    gyroscope: Triad | None
    frame: Frame = "symmetric"
    accel_unit: AccelUnit = "m/s^2"
    gyro_unit: GyroUnit = "rad/s"
    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    effects: tuple[EffectValues, ...] = ()
    user_effects: tuple[UserEffect, ...] = ()
    axes: str = UNCHANGED

    def __post_init__(self) -> None:
        as_frame(self.frame)
        if not (np.isfinite(self.gravity_mps2) and self.gravity_mps2 > 0):
            raise InputError(f"gravity_mps2 is {self.gravity_mps2}: a positive number is needed")
        object.__setattr__(self, "axes", str(Axes.parse(self.axes)))
        object.__setattr__(self, "effects", tuple(self.effects))
        if self.gyroscope is None:
            object.__setattr__(self, "gyro_unit", "rad/s")
            if self.effects:
                raise InputError(
                    f"{self.effects[0].name} is given without a gyroscope [sensor_missing]: effects need "
                    "both sensors"
                )
        names = {values.name for values in self.effects}
        if len(names) < len(self.effects):
            raise InputError(f"an effect occurs twice in {[values.name for values in self.effects]}")
        self._check_effects()
        used = tuple(effect for effect in self.user_effects if effect.name in names)
        of_catalogue = len(self.effects) - len(used)
        if of_catalogue > _core.MAX_EFFECTS:
            raise InputError(
                f"a calibration can have at most {_core.MAX_EFFECTS} effects, but {of_catalogue} were given: "
                "leave out the smallest effects"
            )
        object.__setattr__(self, "user_effects", used)
        parameters = [parameter.name for parameter in self.parameters]
        twice = next((name for name in parameters if parameters.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"two parameters have the name {twice}: give your effect another name")

    def _check_effects(self) -> None:
        """Raise InputError for values that do not match the definition of their effect."""
        if not self.effects and not self.user_effects:
            return
        from imucal.effects.definition import check_values, definitions
        from imucal.effects.table import find

        known = definitions(self.user_effects)
        for values in self.effects:
            check_values(known.get(values.name) or find(values.name), values)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The names of the sensors that the model has."""
        return ("accelerometer",) if self.gyroscope is None else ("accelerometer", "gyroscope")

    def both(self) -> tuple[Triad, Triad]:
        """The triads (accelerometer, gyroscope). InputError `sensor_missing` if there is no gyroscope."""
        if self.gyroscope is None:
            raise InputError(
                "this operation needs a gyroscope, and the calibration has none [sensor_missing]: calibrate "
                "both sensors; docs/one-sensor.md lists the operations for a single sensor"
            )
        return self.accelerometer, self.gyroscope

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: first the parameters of the triads in a fixed order, then those of each effect.

        The triads have 21 parameters, or 24 in the frame "given". An accelerometer alone has nine, or twelve
        in the frame "given". A parameter of an effect is named <effect>_<parameter>; the shape of an effect
        (a time constant) is its last parameter.
        """
        found: list[Parameter] = []
        for sensor, triad, entries, raw_unit, si_unit in (
            ("accel", self.accelerometer, ACCEL_ENTRIES[self.frame], self.accel_unit, "m/s^2"),
            ("gyro", self.gyroscope, GYRO_ENTRIES, self.gyro_unit, "rad/s"),
        ):
            if triad is None:
                continue
            scale_unit = f"lsb/({si_unit})" if raw_unit == "lsb" else "1"
            for i, axis in enumerate("xyz"):
                found.append(Parameter(f"{sensor}_bias_{axis}", float(triad.bias[i]), None, raw_unit))
            for entry in entries:
                row, column = ("xyz".index(axis) for axis in entry)
                value = float(triad.sensitivity[row, column])
                found.append(Parameter(f"{sensor}_sensitivity_{entry}", value, None, scale_unit))
        return (*found, *self._effect_parameters())

    def _effect_parameters(self) -> Iterator[Parameter]:
        if not self.effects:
            return
        from imucal.effects.definition import named_numbers

        for effect in self.effects:
            for parameter, number in named_numbers(self.definition(effect), effect):
                yield Parameter(f"{effect.name}_{parameter.name}", number, None, parameter.unit)

    def definition(self, values: EffectValues) -> Effect | UserEffect:
        """The definition of an effect of this model, from the catalogue or from the user."""
        from imucal.effects.definition import definitions

        return definitions(self.user_effects)[values.name]

    def catalogue_effects(self) -> Iterator[Effect]:
        """The definitions of the effects that are in the catalogue."""
        own = {effect.name for effect in self.user_effects}
        for values in self.effects:
            if values.name not in own:
                yield cast("Effect", self.definition(values))

    def own_effects(self) -> Iterator[tuple[UserEffect, EffectValues]]:
        """The user-defined effects with their values."""
        own = {effect.name: effect for effect in self.user_effects}
        for values in self.effects:
            if values.name in own:
                yield own[values.name], values

    def without_user_effects(self: Model) -> Model:
        """The model with only the effects of the catalogue, which the compiled library implements."""
        own = {effect.name for effect in self.user_effects}
        return replace(
            self, effects=tuple(values for values in self.effects if values.name not in own), user_effects=()
        )

    def require_raw_units(self, recording: Recording) -> None:
        """Raise InputError for a recording whose raw units or axes differ from those of this model.

        A sensor that the model or the recording lacks is not compared.
        """
        for sensor, expected, found in (
            ("accelerometer", self.accel_unit, recording.accel_unit),
            ("gyroscope", self.gyro_unit, recording.gyro_unit),
        ):
            if sensor in self.sensors and sensor in recording.sensors and expected != found:
                raise InputError(
                    f"{recording.name}: the {sensor} is in {found} but the calibration expects {expected}: "
                    "give the recording in the units that the unit was calibrated in"
                )
        if recording.axes != self.axes:
            raise InputError(
                f"{recording.name} was read with the axes {recording.axes}, but the calibration was made "
                f"from recordings with the axes {self.axes}: read the recording with the axes {self.axes}"
            )
