"""A calibration: the sensor model of one unit, how well it is known, and where it comes from.

    measured = T (true + effects(true)) + bias
    corrected = T^-1 (measured - bias) - effects(corrected)

for the accelerometer and for the gyroscope; T is `sensitivity`, the product of scale factors and
misalignment. Most units have no effects (`imucal.effects`), and corrected = T^-1 (measured - bias).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import FloatArray, as_matrix, as_rows
from imucal.document.json_document import Node, read_json, write_json
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.effects.effect import (
    Effect,
    EffectValues,
    UserEffect,
    check_values,
    definitions,
    find,
    named_numbers,
)
from imucal.errors import InputError
from imucal.recording.recording import AccelUnit, GyroUnit, Recording

__all__ = ["Calibration", "Frame", "Parameter", "Provenance", "Triad", "as_frame"]

Frame: TypeAlias = Literal["symmetric", "triangular"]
FRAMES: Final[tuple[Frame, ...]] = ("symmetric", "triangular")
ACCEL_ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "symmetric": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "triangular": ("xx", "yy", "zz", "yx", "zx", "zy"),
}
# The fixed memory of imucal-core, MAX_EFFECTS; a user's own effects are not in it.
MAX_EFFECTS: Final = 12
GYRO_ENTRIES: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")


def as_frame(name: str) -> Frame:
    """The body frame of that name; InputError if there is none."""
    for frame in FRAMES:
        if name == frame:
            return frame
    raise InputError(f"frame is {name!r}: give symmetric or triangular")


def require_serial_number(serial_number: str | None) -> None:
    """Refuse what is no serial number, with InputError: files and tables are named after it."""
    if serial_number is None:
        return
    if not isinstance(serial_number, str):
        raise InputError(f"the serial number is {serial_number!r}: give text, {str(serial_number)!r}")
    if not serial_number.strip():
        raise InputError("the serial number is empty: give that of the unit, or none")
    if not serial_number.isprintable():
        raise InputError(f"the serial number is {serial_number!r}: give characters that can be printed")


@dataclass(frozen=True, eq=False)
class Triad:
    """Three axes of one kind: sensitivity (3, 3) in raw units per SI unit, bias (3,) in raw units.

    Raises InputError if the shapes differ, a number is not finite, or the sensitivity has no inverse.
    """

    sensitivity: FloatArray
    bias: FloatArray

    def __post_init__(self) -> None:
        sensitivity = as_matrix(self.sensitivity, "sensitivity", (3, 3))
        object.__setattr__(self, "sensitivity", sensitivity)
        object.__setattr__(self, "bias", as_matrix(self.bias, "bias", (3,)))
        if not np.linalg.cond(sensitivity) < 1e12:
            raise InputError(f"the sensitivity {sensitivity.tolist()} has no inverse: an axis is missing")


@dataclass(frozen=True)
class Parameter:
    """One number of the model with its standard deviation (1 sigma; None if not known) and unit."""

    name: str
    value: float
    std: float | None
    unit: str


@dataclass(frozen=True)
class Provenance:
    """Where a calibration comes from: files, version of the package, date (ISO 8601, UTC), who made it."""

    files: tuple[Source, ...] = ()
    control_files: tuple[Source, ...] = ()
    imucal_version: str = ""
    date: str = ""
    operator: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """The sensor model of one unit.

    accelerometer, gyroscope  the two triads, raw unit -> SI
    frame                     the body frame, "symmetric" or "triangular"
    accel_unit, gyro_unit     the raw units it expects: SI units or "lsb"
    gravity_mps2              the gravity it was made with, m/s^2
    effects                   what the triads do not explain, of the catalogue or a user's own
    user_effects              definitions of the user's own
    covariance                (P, P) of the parameters in `covariance_names`, or None
    noise                     noise figures, the unit in each name
    temperature_range_degc    lowest and highest temperature of the recordings, or None
    fit                       how the estimation went
    calibration_set, control_set   figures on the recordings it was made of, and on those that only judge it
    """

    accelerometer: Triad
    gyroscope: Triad
    frame: Frame = "symmetric"
    accel_unit: AccelUnit = "m/s^2"
    gyro_unit: GyroUnit = "rad/s"
    gravity_mps2: float = 9.80665
    effects: tuple[EffectValues, ...] = ()
    user_effects: tuple[UserEffect, ...] = ()
    covariance: FloatArray | None = None
    covariance_names: tuple[str, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    temperature_range_degc: tuple[float, float] | None = None
    fit: Mapping[str, Any] = field(default_factory=dict)
    calibration_set: Mapping[str, Any] | None = None
    control_set: Mapping[str, Any] | None = None
    provenance: Provenance = field(default_factory=Provenance)
    serial_number: str | None = None

    def __post_init__(self) -> None:
        as_frame(self.frame)
        require_serial_number(self.serial_number)
        if not (np.isfinite(self.gravity_mps2) and self.gravity_mps2 > 0):
            raise InputError(f"gravity_mps2 is {self.gravity_mps2}: a positive number is needed")
        if self.covariance is not None:
            size = len(self.covariance_names)
            covariance = as_matrix(self.covariance, "covariance", (size, size))
            if (np.diag(covariance) < 0).any():
                raise InputError("covariance has a negative variance on its diagonal")
            object.__setattr__(self, "covariance", covariance)
        self._take_effects()

    def _take_effects(self) -> None:
        object.__setattr__(self, "effects", tuple(self.effects))
        carried = {values.name for values in self.effects}
        if len(carried) < len(self.effects):
            raise InputError(f"an effect stands twice among {[values.name for values in self.effects]}")
        known = definitions(self.user_effects)
        for values in self.effects:
            check_values(known.get(values.name) or find(values.name), values)
        used = tuple(effect for effect in self.user_effects if effect.name in carried)
        of_catalogue = len(self.effects) - len(used)
        if of_catalogue > MAX_EFFECTS:
            raise InputError(
                f"a calibration carries at most {MAX_EFFECTS} effects, {of_catalogue} were given: leave out "
                "those that matter least"
            )
        object.__setattr__(self, "user_effects", used)
        names = [parameter.name for parameter in self.parameters]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"two parameters have the name {twice}: give your effect another name")

    def definition(self, values: EffectValues) -> Effect | UserEffect:
        """The row of the catalogue, or the user's definition, of one of `effects`."""
        return definitions(self.user_effects)[values.name]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters with the standard deviations of the covariance.

        First the 21 of the triads in their fixed order, then those of each effect, its shape last; their
        names are <effect>_<parameter>.
        """
        accel_scale = "1" if self.accel_unit != "lsb" else "lsb/(m/s^2)"
        gyro_scale = "1" if self.gyro_unit != "lsb" else "lsb/(rad/s)"
        variance = (
            {}
            if self.covariance is None
            else dict(zip(self.covariance_names, np.diag(self.covariance).tolist(), strict=True))
        )
        values: list[tuple[str, float, str]] = []
        for sensor, triad, entries, raw_unit, scale_unit in (
            ("accel", self.accelerometer, ACCEL_ENTRIES[self.frame], self.accel_unit, accel_scale),
            ("gyro", self.gyroscope, GYRO_ENTRIES, self.gyro_unit, gyro_scale),
        ):
            values += [(f"{sensor}_bias_{a}", float(triad.bias[i]), raw_unit) for i, a in enumerate("xyz")]
            values += [
                (
                    f"{sensor}_sensitivity_{entry}",
                    float(triad.sensitivity["xyz".index(entry[0]), "xyz".index(entry[1])]),
                    scale_unit,
                )
                for entry in entries
            ]
        for effect in self.effects:
            values += [
                (f"{effect.name}_{parameter.name}", number, parameter.unit)
                for parameter, number in named_numbers(self.definition(effect), effect)
            ]
        return tuple(
            Parameter(name, value, variance[name] ** 0.5 if name in variance else None, unit)
            for name, value, unit in values
        )

    @property
    def left_in_data(self) -> tuple[str, ...]:
        """Names of the effects that no correction takes away.

        They depend on the attitude or act on the stand. The Earth's rate is among them: a gyroscope rightly
        measures it, it is no error of the sensor.
        """
        from imucal.calibration.correction import left_in_data

        return left_in_data(self)

    @property
    def temperature_effects(self) -> tuple[str, ...]:
        """Names of the effects of the catalogue that depend on the temperature."""
        return tuple(
            values.name
            for values in self.effects
            if "temperature" in getattr(self.definition(values), "needs", ())
        )

    @property
    def takes_pieces(self) -> bool:
        """Whether a recording can be corrected piece by piece.

        Not where an effect depends on the angular acceleration, a derivative that reaches over the ends of a
        piece, nor with a user's own effect, whose field takes whole columns.
        """
        from imucal.calibration.correction import takes_pieces

        return takes_pieces(self)

    def apply(self, angular_rate: ArrayLike, specific_force: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Correct raw samples.

        angular_rate    (N, 3) in `gyro_unit`
        specific_force  (N, 3) in `accel_unit`

        Returns (angular_rate, specific_force), (N, 3) each, rad/s and m/s^2 in the body frame. NaN stays NaN,
        and a sample is NaN where the effects are too large to be undone.
        Raises InputError for other shapes, and if an effect depends on more than rate and force: then
        `apply_recording` is needed.
        """
        from imucal.calibration.correction import require_no_surroundings

        require_no_surroundings(self)
        rate = as_rows(angular_rate, "angular_rate", 3)
        force = as_rows(specific_force, "specific_force", 3, len(rate))
        corrected: tuple[FloatArray, FloatArray] = _core.correct(self, rate, force)
        return corrected

    def require_raw_units(self, recording: Recording) -> None:
        """Refuse a recording of other raw units than this calibration expects, with InputError."""
        for sensor, expected, found in (
            ("accelerometer", self.accel_unit, recording.accel_unit),
            ("gyroscope", self.gyro_unit, recording.gyro_unit),
        ):
            if expected != found:
                raise InputError(
                    f"{recording.name}: the {sensor} is in {found} but the calibration expects {expected}: "
                    "give the recording in the units that the unit was calibrated in"
                )

    def apply_recording(self, recording: Recording, *, start_s: float | None = None) -> Recording:
        """The recording in SI units and the body frame, all effects taken away but those `left_in_data`.

        start_s  the first time of the whole, if the recording is a piece of one; see `takes_pieces`

        Time counts from the recording's first sample or from `start_s`, temperature from 25 degC; the angular
        acceleration is the derivative of the rate. NaN stays NaN, and a sample is NaN where the effects are
        too large to be undone.
        Raises InputError for other raw units than expected, for negative counts that were read as unsigned
        numbers, if a column is missing that an effect depends on, without the definition of a user's effect,
        and for a piece where the whole is needed.
        """
        from imucal.calibration.correction import remove_user_effects, require_surroundings

        for effect in self.user_effects:
            effect.required_field()
        if start_s is not None and not self.takes_pieces:
            raise InputError(f"{recording.name}: the effects of this calibration need the whole recording")
        self.require_raw_units(recording)
        require_surroundings(self, recording)
        without = remove_user_effects(self, recording)
        rate, force = _core.correct_recording(self.without_user_effects(), without, start_s)
        return replace(
            recording, angular_rate=rate, specific_force=force, accel_unit="m/s^2", gyro_unit="rad/s"
        )

    def without_user_effects(self) -> Calibration:
        """The same with the effects of the catalogue alone, which is what the compiled library knows."""
        own = {effect.name for effect in self.user_effects}
        return replace(
            self, effects=tuple(values for values in self.effects if values.name not in own), user_effects=()
        )

    def __repr__(self) -> str:
        """One line: the unit, its raw units, how many effects it has, and what its figures were."""
        from imucal.estimation.evaluate import figures_text

        count = len(self.effects)
        parts = [
            f"accelerometer in {self.accel_unit}",
            f"gyroscope in {self.gyro_unit}",
            f"{count or 'no'} effect{'s' if count != 1 else ''}",
        ]
        # Files hold figures as they were written, by whatever program.
        for name, figures in (("control set", self.control_set), ("calibration set", self.calibration_set)):
            known = {key: value for key, value in (figures or {}).items() if isinstance(value, (int, float))}
            if said := figures_text(known):
                parts.append(f"{name}: {said}")
                break
        unit = "unit without a number" if self.serial_number is None else f"unit {self.serial_number!r}"
        return f"Calibration({unit}, {', '.join(parts)})"

    def _repr_html_(self) -> str:
        """What notebooks show."""
        from imucal.report.notebook import of_calibration

        return of_calibration(self)

    def to_dict(self) -> dict[str, Any]:
        """The fields of the file."""
        from imucal.calibration.file import document_of

        return document_of(self)

    @staticmethod
    def from_dict(
        document: Mapping[str, Any], name: str = "calibration", *, user_effects: Sequence[UserEffect] = ()
    ) -> Calibration:
        """The calibration that `to_dict` wrote; FormatError names the field that is wrong."""
        from imucal.calibration.file import calibration_of

        return calibration_of(Node(plain(document), "$", name), user_effects)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration file, whole or not at all.

        Raises InputError if it cannot be written, or if a number is not finite.
        """
        write_json(self.to_dict(), path)

    @staticmethod
    def load(path: str | os.PathLike[str], *, user_effects: Sequence[UserEffect] = ()) -> Calibration:
        """Read a calibration file.

        user_effects  definitions of the user's own effects in it; without them it can be read but not applied

        Raises InputError if it cannot be read, and FormatError, naming the field, if it is not a calibration.
        """
        from imucal.calibration.file import calibration_of

        return calibration_of(read_json(path), user_effects)
