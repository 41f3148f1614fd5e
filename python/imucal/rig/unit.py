"""Simulated units: their sensors, and unit files.

    measured = convert(sensitivity (true + effects) + bias + noise)

A unit file (schema imucal.unit/1) has the figures of a datasheet, such as bias, noise density and range, each
with its unit and source. The noise density of a datasheet is one-sided and is given as
`noise_density_one_sided`; `noise_density` is two-sided, as in the Allan deviation, and smaller by a factor of
sqrt(2). A figure that the source does not give is `null` and is simulated as perfect. The package contains
the units `unit_names()`.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray, as_matrix
from imucal.document.agreement import require_fields
from imucal.document.figure import Figure
from imucal.document.json_document import Node, read_json, write_json
from imucal.document.name import require_name
from imucal.document.whole import check_seed
from imucal.effects.effect import EffectValues
from imucal.effects.table import find
from imucal.effects.values import effects_of, effects_to_list
from imucal.errors import FormatError, InputError
from imucal.rig.unit_bounds import LARGEST, require_figure, require_sensor, require_tolerance

__all__ = ["Sensor", "Unit", "unit_names"]

SCHEMA: Final = "imucal.unit/1"
FOLDER: Final = Path(__file__).parent / "shipped"
# Minimum of the Allan deviation of flicker noise with coefficient B: sqrt(2 ln 2 / pi) B (IEEE Std 952-1997).
FLOOR_PER_INSTABILITY: Final = math.sqrt(2.0 * math.log(2.0) / math.pi)
# Ratio of the two-sided noise density N to the one-sided noise density of a datasheet (docs/model.md (22)).
TWO_SIDED_PER_ONE_SIDED: Final = math.sqrt(0.5)
# Units are drawn such that the tolerance of the datasheet is this number of standard deviations. The number
# depends on the kind of tolerance.
DEVIATIONS: Final = {"typical": 1.0, "maximum": 3.0}
# Parameters of a random unit, except effects, in the order in which they are drawn: number of values, and
# unit.
DRAWN: Final[dict[str, tuple[int, str]]] = {
    "accel_bias": (3, "m/s^2"),
    "accel_scale": (3, "1"),
    "accel_misalignment": (6, "1"),
    "gyro_bias": (3, "rad/s"),
    "gyro_scale": (3, "1"),
    "gyro_misalignment": (6, "1"),
}
FIELDS: Final = (
    *("schema", "name", "description", "sources"),
    *("accelerometer", "gyroscope", "effects", "spread"),
)
SENSOR_FIELDS: Final = (
    *("part", "sensitivity", "bias", "noise_density", "noise_density_one_sided"),
    *("allan_floor", "bias_instability", "random_walk"),
    *("noise_in_motion", "range", "resolution", "bits", "bandwidth", "filter", "output_rate", "averaging"),
)


@dataclass(frozen=True, eq=False)
class Sensor:
    """A triad of sensors, in SI units (v is m/s^2 or rad/s).

    sensitivity       (3, 3), 1 is perfect
    bias              (3,) v
    noise_density     white noise N, continuous, two-sided, v/sqrt(Hz). The standard deviation of a point
                      sample is N * sqrt(rate_hz), and the Allan deviation is N / sqrt(tau). The density of a
                      datasheet is one-sided, which is sqrt(2) N
    bias_instability  flicker coefficient B, v; the minimum of the Allan deviation is 0.664 B
    random_walk       (3,) rate random walk K per axis, v/s/sqrt(Hz); its Allan deviation is K sqrt(tau / 3)
    noise_in_motion   factor by which white noise is larger during moves
    lsb, bits         size of one count, v, and word width; None for no quantisation and no saturation
    filter_hz         bandwidth of the low-pass filter before sampling, Hz; None for no filter (point samples)
    averaging         whether samples are means over the sampling interval
    bandwidth_hz      bandwidth in the datasheet, Hz, used with `filter_hz="datasheet"`
    """

    sensitivity: FloatArray = field(default_factory=lambda: np.eye(3))
    bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    noise_density: float = 0.0
    bias_instability: float = 0.0
    random_walk: FloatArray = field(default_factory=lambda: np.zeros(3))
    noise_in_motion: float = 1.0
    lsb: float | None = None
    bits: int | None = None
    filter_hz: float | None = None
    averaging: bool = False
    bandwidth_hz: float | None = None
    part: str = ""

    def __post_init__(self) -> None:
        for name, shape in (("sensitivity", (3, 3)), ("bias", (3,)), ("random_walk", (3,))):
            object.__setattr__(self, name, as_matrix(getattr(self, name), name, shape))
        if (self.lsb is None) != (self.bits is None):
            raise InputError("lsb and bits of a sensor are only valid together: give both or neither")

    def with_range(self, limit: float) -> Sensor:
        """The sensor with the range +-limit and the same number of counts."""
        if not (math.isfinite(limit) and limit > 0):
            raise InputError(f"the range of a sensor is {limit}: a positive number is needed")
        # With 32 bits the quantisation is far below any noise, so only the saturation has an effect.
        bits = self.bits or 32
        return dataclasses.replace(self, lsb=limit / 2.0 ** (bits - 1), bits=bits)

    def to_dict(self, unit: str) -> dict[str, Any]:
        """The sensor for a unit file; `unit` is the SI unit of the measured quantity."""
        return {
            "part": self.part,
            "sensitivity": Figure(self.sensitivity, "1"),
            "bias": Figure(self.bias, unit),
            "noise_density": Figure(self.noise_density, f"{unit}/sqrt(Hz)"),
            "bias_instability": Figure(self.bias_instability, unit),
            "random_walk": Figure(self.random_walk, f"{unit}/s/sqrt(Hz)"),
            "noise_in_motion": Figure(self.noise_in_motion, "1"),
            "resolution": None if self.lsb is None else Figure(self.lsb, f"{unit}/lsb"),
            "bits": None if self.bits is None else Figure(self.bits, "bit"),
            "bandwidth": None if self.bandwidth_hz is None else Figure(self.bandwidth_hz, "Hz"),
            "filter": None if self.filter_hz is None else Figure(self.filter_hz, "Hz"),
            "averaging": self.averaging,
        }


@dataclass(frozen=True, eq=False)
class Unit:
    """An accelerometer and a gyroscope on one board, with their effects.

    description, sources   description of the unit, and the sources of its datasheet figures
    spread                 standard deviations of datasheet figures over units of this kind, from the
                           tolerances in the file, SI units: accel_bias, accel_scale, accel_misalignment,
                           gyro_bias, gyro_scale and gyro_misalignment; one value, or one per axis
    """

    accelerometer: Sensor = field(default_factory=Sensor)
    gyroscope: Sensor = field(default_factory=Sensor)
    effects: tuple[EffectValues, ...] = ()
    name: str = "unit"
    description: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    spread: Mapping[str, FloatArray] = field(default_factory=dict)

    @staticmethod
    def named(name: str) -> Unit:
        """A unit that the package contains. An unknown name raises InputError with the known names."""
        return unit_from(_shipped(name))

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Unit:
        """Read a unit file; FormatError names the invalid field."""
        return unit_from(read_json(path))

    @staticmethod
    def random(profile: str | os.PathLike[str], seed: int) -> Unit:
        """A random unit within the tolerances of a profile; the same seed gives the same unit.

        Every bias, scale, misalignment and effect with a tolerance is drawn from a normal distribution. The
        mean is the value of a perfect sensor. The standard deviation is the tolerance if the datasheet states
        it as typical, or a third of the tolerance if it is a maximum. Off-diagonal entries of both
        sensitivities are drawn in the frame of the sensor's package and rotated to the body frame, in which
        the accelerometer's sensitivity is symmetric. Noise, quantisation and filters are taken from the
        profile.

        profile  a name of `unit_names()`, or the path of a unit file
        """
        node = (
            _shipped(profile) if isinstance(profile, str) and profile in unit_names() else read_json(profile)
        )
        return _draw(node, seed)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the unit file, atomically; all numbers are preserved exactly."""
        write_json(self.to_dict(), path)

    def to_dict(self) -> dict[str, Any]:
        """The document of the unit file."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "description": self.description,
            "sources": self.sources,
            "accelerometer": self.accelerometer.to_dict("m/s^2"),
            "gyroscope": self.gyroscope.to_dict("rad/s"),
            "effects": effects_to_list(self.effects),
        }


def unit_names() -> tuple[str, ...]:
    """The names of the units in the package."""
    names = (Path(file.name).stem for file in FOLDER.iterdir() if file.name.endswith(".json"))
    return tuple(sorted(names))


def unit_of(unit: Unit | str | os.PathLike[str]) -> Unit:
    """The unit for an argument: a Unit, a name, `random:NAME:SEED`, or the path of a unit file."""
    if isinstance(unit, Unit):
        return unit
    text = os.fspath(unit)
    if text in unit_names():
        return Unit.named(text)
    if text.startswith("random:"):
        # The seed of the unit is separate from the seed of the run, because a run and its control run are of
        # the same unit.
        profile, _, seed = text.removeprefix("random:").partition(":")
        if not (profile and (seed or "1").isdigit()):
            raise InputError(f"the unit {text!r} is not understood: give random:NAME or random:NAME:SEED")
        if profile not in unit_names():
            _require_file(profile)
        return Unit.random(profile, int(seed or "1"))
    _require_file(text)
    return Unit.read(text)


def _require_file(unit: str) -> None:
    """Refuse a word that is neither the name of a unit nor looks like the path of a file."""
    if not Path(unit).exists() and Path(unit).suffix == "":
        raise InputError(
            f"the unit {unit!r} is not known: give one of {', '.join(unit_names())}, random:NAME:SEED for "
            "one drawn from a spread, or a unit file"
        )


def _shipped(name: str) -> Node:
    if name not in unit_names():
        raise InputError(f"the unit {name!r} is not known: give one of {', '.join(unit_names())}")
    return read_json(FOLDER / f"{name}.json")


def unit_from(node: Node) -> Unit:
    """The unit in a file."""
    node.require_schema(SCHEMA)
    require_fields(node, FIELDS, "a unit file")
    sources = {key: node.get("sources").get(key).text() for key in node.get("sources").mapping()}
    spread: dict[str, FloatArray] = {}
    if node.mapping().get("spread") is not None:
        _require_spread(node.get("spread"), sources)
        given = node.get("spread").mapping()
        spread = {
            figure: _deviation(node.get("spread"), figure, unit, size)
            for figure, (size, unit) in DRAWN.items()
            if given.get(figure) is not None
        }
    try:
        name = require_name(node.get("name").value, "$.name")
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None
    return Unit(
        _sensor(node.get("accelerometer"), "m/s^2", sources),
        _sensor(node.get("gyroscope"), "rad/s", sources),
        effects_of(node.get("effects")),
        name,
        node.get("description").text(),
        sources,
        spread,
    )


def _sensor(node: Node, unit: str, sources: Collection[str]) -> Sensor:
    """The sensor in a unit file; every figure may be null or missing."""
    require_fields(node, SENSOR_FIELDS, "a unit file")
    floor = Figure.optional(node, "allan_floor", unit)
    instability = Figure.optional(node, "bias_instability", unit)
    density = Figure.optional(node, "noise_density", f"{unit}/sqrt(Hz)")
    one_sided = Figure.optional(node, "noise_density_one_sided", f"{unit}/sqrt(Hz)")
    for twice, both in (
        ((floor, instability), "allan_floor and bias_instability"),
        ((density, one_sided), "noise_density and noise_density_one_sided"),
    ):
        if None not in twice:
            raise FormatError(f"{node.file}: {node.path} has {both}: give one of them")
    if one_sided is not None:
        density = one_sided * TWO_SIDED_PER_ONE_SIDED
    if floor is not None:
        instability = floor / FLOOR_PER_INSTABILITY
    bits = Figure.optional(node, "bits", "bit")
    if (bits is None) != (Figure.optional(node, "resolution", f"{unit}/lsb") is None):
        raise FormatError(
            f"{node.file}: {node.path}.resolution and {node.path}.bits belong together: give both or neither"
        )
    averaging = "averaging" in node.mapping() and node.get("averaging").flag()
    found: dict[str, Any] = {
        "sensitivity": Figure.optional(node, "sensitivity", "1", (3, 3)),
        "bias": Figure.optional(node, "bias", unit, (3,)),
        "noise_density": density,
        "bias_instability": instability,
        "random_walk": Figure.optional(node, "random_walk", f"{unit}/s/sqrt(Hz)", (3,)),
        "noise_in_motion": Figure.optional(node, "noise_in_motion", "1"),
        "lsb": Figure.optional(node, "resolution", f"{unit}/lsb"),
        "bits": None if bits is None else int(bits),
        "filter_hz": Figure.optional(node, "filter", "Hz"),
        "bandwidth_hz": Figure.optional(node, "bandwidth", "Hz"),
    }
    known = {name: value for name, value in found.items() if value is not None}
    names = {"lsb": "resolution", "filter_hz": "filter", "bandwidth_hz": "bandwidth"}
    if one_sided is not None:
        names["noise_density"] = "noise_density_one_sided"
    figures = {names.get(name, name): value for name, value in known.items() if name != "bias_instability"}
    # Figures that are in the file but are not used by the simulation are also checked.
    figures |= {
        name: value
        for name, of in (
            ("range", unit),
            ("output_rate", "Hz"),
            ("allan_floor", unit),
            ("bias_instability", unit),
        )
        if (value := Figure.optional(node, name, of)) is not None
    }
    figures |= {} if bits is None else {"bits": bits}
    require_sensor(node, figures, unit, sources)
    return Sensor(**known, averaging=averaging, part=node.get("part").text())


def _require_spread(spread: Node, sources: Collection[str]) -> None:
    """Raise FormatError for a tolerance that gives no distribution of a simulated sensor's parameters."""
    largest = {"accel_bias": LARGEST["m/s^2"]["bias"], "gyro_bias": LARGEST["rad/s"]["bias"]}
    for name, given in spread.mapping().items():
        size, unit, typical = (*DRAWN[name], None) if name in DRAWN else _drawn_effect(spread, name)
        if given is None:
            continue
        tolerance = spread.get(name)
        require_figure(tolerance, sources)
        tolerance.get("limit").text(tuple(DEVIATIONS))
        value = Figure.optional(spread, name, unit, per_axis=size == 3)
        require_tolerance(tolerance, value, name, typical, largest)


def _drawn_effect(spread: Node, name: str) -> tuple[int, str, float]:
    """Number of values, unit and typical size of an effect.

    Raises FormatError if no effect has this name.
    """
    try:
        effect = find(name)
    except InputError as error:
        raise FormatError(f"{spread.file}: {spread.path}.{name}: {error}") from None
    return effect.plain, effect.parameters[0].unit, effect.parameters[0].typical


def _draw(node: Node, seed: int) -> Unit:
    """A random unit, drawn from the tolerances in the unit file `node`."""
    check_seed(seed)
    profile = unit_from(node)
    spread = node.get("spread") if "spread" in node.mapping() else Node({}, "$.spread", node.file)
    if not any(value is not None for value in spread.mapping().values()):
        raise InputError(f"{node.file} gives no spread: take its unit as it is, or another profile")
    random = np.random.default_rng(seed)
    # A random number is drawn even for a parameter without a tolerance. A missing tolerance therefore does
    # not change the random numbers of the other parameters.
    drawn = {
        name: random.normal(size=size) * _deviation(spread, name, unit, size)
        for name, (size, unit) in DRAWN.items()
    }
    accel_sensitivity, gyro_sensitivity = _core.convert_frame(
        _sensitivity(drawn["accel_scale"], drawn["accel_misalignment"]),
        _sensitivity(drawn["gyro_scale"], drawn["gyro_misalignment"]),
        "symmetric",
    )
    effects = list(profile.effects)
    for name, value in spread.mapping().items():
        if name not in DRAWN and value is not None:
            effect = find(name)
            deviation = _deviation(spread, name, effect.parameters[0].unit, effect.plain)
            # The time constant is not drawn, because datasheets give no tolerance of it.
            shape = None if effect.shape is None else effect.shape.typical
            effects.append(EffectValues(name, random.normal(size=effect.plain) * deviation, shape))
    return dataclasses.replace(
        profile,
        accelerometer=dataclasses.replace(
            profile.accelerometer, sensitivity=accel_sensitivity, bias=drawn["accel_bias"]
        ),
        gyroscope=dataclasses.replace(
            profile.gyroscope, sensitivity=gyro_sensitivity, bias=drawn["gyro_bias"]
        ),
        effects=tuple(effects),
        name=f"{profile.name}-{seed}",
        description=f"Drawn from the spread of {profile.name} with the seed {seed}. {profile.description}",
    )


def _deviation(spread: Node, name: str, unit: str, count: int) -> FloatArray:
    """Standard deviation of a randomly drawn parameter with `count` numbers; 0 if it has no tolerance.

    All numbers have the same standard deviation. Only a parameter of three numbers may have one per axis.
    """
    tolerance = Figure.optional(spread, name, unit, per_axis=count == 3)
    if tolerance is None:
        return np.zeros(1)
    return np.atleast_1d(tolerance) / DEVIATIONS[spread.get(name).get("limit").text(tuple(DEVIATIONS))]


def _sensitivity(scale: FloatArray, misalignment: FloatArray) -> FloatArray:
    matrix = np.diag(1.0 + scale)
    matrix[~np.eye(3, dtype=bool)] = misalignment
    return matrix
