"""A calibration: the sensor model of one unit, how well it is known, and where it comes from.

    measured = T true + bias          corrected = T^-1 (measured - bias)

for the accelerometer and for the gyroscope; T is `sensitivity`, the product of scale factors and
misalignment. The file (schema imucal.calibration/1) holds every number in full: reading gives the same bits.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray, as_matrix, as_rows
from imucal.document import Node, plain, read_json, write_json
from imucal.effects import EffectValues
from imucal.errors import FormatError, InputError
from imucal.recording import AccelUnit, GyroUnit, Recording, Source

__all__ = ["Calibration", "Frame", "Parameter", "Provenance", "Triad", "as_frame"]

SCHEMA: Final = "imucal.calibration/1"
MODEL: Final = "measured = T true + bias; corrected = T^-1 (measured - bias)"

Frame: TypeAlias = Literal["symmetric", "triangular"]
FRAMES: Final[tuple[Frame, ...]] = ("symmetric", "triangular")
BODY_FRAME: Final[dict[str, str]] = {
    "symmetric": "right-handed orthogonal frame closest to the accelerometer's three axes: its T is "
    "symmetric positive definite; a still sensor reads +g on the axis that points up",
    "triangular": "right-handed orthogonal frame with x along the accelerometer's x axis and y in its x-y "
    "plane: its T is lower triangular; a still sensor reads +g on the axis that points up",
}
ACCEL_ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "symmetric": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "triangular": ("xx", "yy", "zz", "yx", "zx", "zy"),
}
GYRO_ENTRIES: Final = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")


def as_frame(name: str) -> Frame:
    """The body frame of that name; InputError if there is none."""
    for frame in FRAMES:
        if name == frame:
            return frame
    raise InputError(f"frame is {name!r}: give symmetric or triangular")


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
    """Where a calibration comes from: files, version of the package, date (ISO 8601, UTC)."""

    files: tuple[Source, ...] = ()
    control_files: tuple[Source, ...] = ()
    imucal_version: str = ""
    date: str = ""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The sensor model of one unit.

    accelerometer, gyroscope  the two triads, raw unit -> SI
    frame                     the body frame, "symmetric" or "triangular"
    accel_unit, gyro_unit     the raw units it expects: SI units or "lsb"
    gravity_mps2              the gravity it was made with, m/s^2
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
        if not (np.isfinite(self.gravity_mps2) and self.gravity_mps2 > 0):
            raise InputError(f"gravity_mps2 is {self.gravity_mps2}: a positive number is needed")
        if self.covariance is not None:
            size = len(self.covariance_names)
            covariance = as_matrix(self.covariance, "covariance", (size, size))
            if (np.diag(covariance) < 0).any():
                raise InputError("covariance has a negative variance on its diagonal")
            object.__setattr__(self, "covariance", covariance)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 21 parameters in their fixed order, with the standard deviations of the covariance."""
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
        return tuple(
            Parameter(name, value, variance[name] ** 0.5 if name in variance else None, unit)
            for name, value, unit in values
        )

    def apply(self, angular_rate: ArrayLike, specific_force: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Correct raw samples.

        angular_rate    (N, 3) in `gyro_unit`
        specific_force  (N, 3) in `accel_unit`

        Returns (angular_rate, specific_force), (N, 3) each, rad/s and m/s^2 in the body frame. NaN stays NaN.
        Raises InputError for other shapes.
        """
        from imucal import _core

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

    def apply_recording(self, recording: Recording) -> Recording:
        """The recording in SI units and the body frame; InputError for other raw units than expected."""
        self.require_raw_units(recording)
        rate, force = self.apply(recording.angular_rate, recording.specific_force)
        return Recording(
            recording.time_s,
            force,
            rate,
            temperature_degc=recording.temperature_degc,
            stand_rad=recording.stand_rad,
            auxiliary=recording.auxiliary,
            name=recording.name,
            sources=recording.sources,
        )

    def to_dict(self) -> dict[str, Any]:
        """The fields of the file."""
        document: dict[str, Any] = plain(
            {
                "schema": SCHEMA,
                "serial_number": self.serial_number,
                "model": MODEL,
                "body_frame": BODY_FRAME[self.frame],
                "raw_units": {"accelerometer": self.accel_unit, "gyroscope": self.gyro_unit},
                "gravity_mps2": self.gravity_mps2,
                "accelerometer": {
                    "T": self.accelerometer.sensitivity,
                    "bias": self.accelerometer.bias,
                    "frame": self.frame,
                },
                "gyroscope": {"T": self.gyroscope.sensitivity, "bias": self.gyroscope.bias},
                "effects": [],
                "parameters": self.parameters,
                "covariance": None
                if self.covariance is None
                else {"names": self.covariance_names, "matrix": self.covariance},
                "noise": self.noise,
                "temperature_range_degc": self.temperature_range_degc,
                "fit": self.fit,
                "calibration_set": self.calibration_set,
                "control_set": self.control_set,
                "provenance": self.provenance,
            }
        )
        return document

    @staticmethod
    def from_dict(document: Mapping[str, Any], name: str = "calibration") -> Calibration:
        """The calibration that `to_dict` wrote; FormatError names the field that is wrong."""
        return _checked(Node(plain(document), "$", name))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration file, whole or not at all.

        Raises InputError if it cannot be written, or if a number is not finite.
        """
        write_json(self.to_dict(), path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Calibration:
        """Read a calibration file.

        Raises InputError if it cannot be read, and FormatError, naming the field, if it is not a calibration.
        """
        return _checked(read_json(path))


def _checked(node: Node) -> Calibration:
    """What the fields contradict among themselves is a fault of the file."""
    try:
        return _from_node(node)
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None


def _from_node(node: Node) -> Calibration:
    node.require_schema(SCHEMA)
    if node.get("effects").items():
        raise FormatError(
            f"{node.file}: $.effects[0] is not known to this version of imucal: install a newer one"
        )
    units = node.get("raw_units")
    frame = node.get("accelerometer").get("frame").text(FRAMES)
    covariance = node.get("covariance")
    names: tuple[str, ...] = ()
    if covariance.value is not None:
        names = tuple(item.text() for item in covariance.get("names").items())
    temperature = node.get("temperature_range_degc")
    calibration = Calibration(
        accelerometer=_triad(node.get("accelerometer")),
        gyroscope=_triad(node.get("gyroscope")),
        frame=as_frame(frame),
        accel_unit="lsb" if units.get("accelerometer").text(get_args(AccelUnit)) == "lsb" else "m/s^2",
        gyro_unit="lsb" if units.get("gyroscope").text(get_args(GyroUnit)) == "lsb" else "rad/s",
        gravity_mps2=node.get("gravity_mps2").number(),
        covariance=covariance.get("matrix").array(len(names), len(names)) if names else None,
        covariance_names=names,
        noise={name: node.get("noise").get(name).number() for name in node.get("noise").mapping()},
        temperature_range_degc=None if temperature.value is None else _pair(temperature),
        fit=node.get("fit").mapping(),
        calibration_set=_figures(node.get("calibration_set")),
        control_set=_figures(node.get("control_set")),
        provenance=_provenance(node.get("provenance")),
        serial_number=None if node.get("serial_number").value is None else node.get("serial_number").text(),
    )
    _require_same_parameters(node.get("parameters"), calibration)
    return calibration


def _triad(node: Node) -> Triad:
    return Triad(node.get("T").array(3, 3), node.get("bias").array(3))


def _pair(node: Node) -> tuple[float, float]:
    low, high = node.array(2).tolist()
    return low, high


def _figures(node: Node) -> dict[str, Any] | None:
    return None if node.value is None else node.mapping()


def _provenance(node: Node) -> Provenance:
    def sources(field: str) -> tuple[Source, ...]:
        return tuple(
            Source(item.get("path").text(), item.get("sha256").text()) for item in node.get(field).items()
        )

    return Provenance(
        sources("files"),
        sources("control_files"),
        node.get("imucal_version").text(),
        node.get("date").text(),
    )


def _require_same_parameters(node: Node, calibration: Calibration) -> None:
    """The table repeats the matrices for readers; a file in which they differ was edited by halves."""
    items = node.items()
    if len(items) != len(calibration.parameters):
        raise FormatError(
            f"{node.file}: {node.path} has {len(items)} items, {len(calibration.parameters)} are needed"
        )
    for item, parameter in zip(items, calibration.parameters, strict=True):
        if item.get("name").text() != parameter.name:
            raise FormatError(f"{node.file}: {item.path}.name must be {parameter.name}")
        if item.get("value").number() != parameter.value:
            raise FormatError(
                f"{node.file}: {item.path}.value ({parameter.name}) is {item.get('value').number()} but the "
                f"matrix or bias has {parameter.value}: correct one of them"
            )
