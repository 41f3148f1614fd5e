"""The setup of a simulated run. Simulations of the same setup give the same bytes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.agreement import require_fields
from imucal.document.json_document import Node
from imucal.document.whole import check_seed
from imucal.effects.definition import UserEffect, by_name
from imucal.effects.effect import EffectValues
from imucal.effects.formula_effect import FormulaEffect
from imucal.effects.table import catalogue
from imucal.effects.values import effects_of, effects_to_list
from imucal.errors import FormatError, InputError
from imucal.rig.motion import Motion, Program, Tumble, motion_from, motion_to_dict
from imucal.rig.stand import Stand
from imucal.rig.temperature import REFERENCE_DEGC, Temperature
from imucal.rig.unit import Sensor, Unit, unit_from
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Setup"]

# Fields of the clock and of the data link, each with the range of values that are accepted in a file. Shares
# of samples are from 0 to 1. The rate error of the clock is a ratio, and its jitter is in s; the ranges of
# both are wider than the errors of any real clock.
LINK: Final = {
    "missing_share": (0.0, 1.0),
    "duplicated_share": (0.0, 1.0),
    "clock_rate_error": (-0.5, 0.5),
    "clock_jitter_s": (0.0, 10.0),
}
# Fields of the section `setup` of a truth file.
SETUP_FIELDS: Final = (
    *("motion", "unit", "effects", "user_effects", "rate_hz", "gravity_mps2", "temperature"),
    *LINK,
    "seed",
)


@dataclass(frozen=True, eq=False)
class Setup:
    """Inputs of a simulated run: motion, unit and its errors, gravity, temperature, faults, and seed.

    effects             effects of the catalogue, in addition to those of `unit` and of the stand's encoders
    user_effects        definitions of user-defined effects, and their values
    missing_share       share of lost samples
    duplicated_share    share of samples that repeat the previous sample
    clock_rate_error    relative error of the unit's clock, positive if fast
    clock_jitter_s      standard deviation of the time stamp minus the sampling instant, s

    Raises InputError for an invalid seed and for an effect given twice.
    """

    motion: Motion
    seed: int
    unit: Unit = field(default_factory=Unit)
    effects: tuple[EffectValues, ...] = ()
    user_effects: tuple[tuple[UserEffect, EffectValues], ...] = ()
    rate_hz: float = 200.0
    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    temperature: Temperature = field(default_factory=lambda: Temperature.constant(REFERENCE_DEGC))
    missing_share: float = 0.0
    duplicated_share: float = 0.0
    clock_rate_error: float = 0.0
    clock_jitter_s: float = 0.0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        names = [effect.name for effect in self.all_effects]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"the effect {twice} occurs twice: give it once")

    @property
    def all_effects(self) -> tuple[EffectValues, ...]:
        """The effects of unit, stand and setup; those of the setup replace effects with the same name."""
        given = {effect.name for effect in self.effects}
        own = [effect for effect in self.unit.effects if effect.name not in given]
        stand = self.motion.stand if isinstance(self.motion, Program) else None
        encoders = [effect for effect in stand.encoder_effects if effect.name not in given] if stand else []
        return (*own, *encoders, *self.effects)

    @property
    def needs_temperature(self) -> bool:
        """Whether the temperature changes, or an effect depends on it."""
        needs = {row.name: row.needs for row in catalogue()}
        return len(self.temperature.time_s) > 1 or any(
            "temperature" in needs.get(effect.name, ()) for effect in self.all_effects
        )

    def noise_free(self) -> Setup:
        """The setup with the same motion and clock, without errors of the unit and without lost samples."""
        return dataclasses.replace(
            self, unit=Unit(), effects=(), user_effects=(), missing_share=0.0, duplicated_share=0.0
        )

    def for_core(
        self, *, added_force: FloatArray | None = None, added_rate: FloatArray | None = None
    ) -> CoreSetup:
        """The setup for the compiled library. Both arrays are added to the true force and rate."""
        return CoreSetup(
            motion=self.motion.in_si(),
            unit=self.unit,
            effects=self.all_effects,
            rate_hz=float(self.rate_hz),
            gravity_mps2=float(self.gravity_mps2),
            temperature_time_s=self.temperature.time_s,
            temperature_degc=self.temperature.temp_degc,
            missing_share=float(self.missing_share),
            duplicated_share=float(self.duplicated_share),
            clock_rate_error=float(self.clock_rate_error),
            clock_jitter_s=float(self.clock_jitter_s),
            seed=self.seed,
            added_force=added_force,
            added_rate=added_rate,
        )

    def to_dict(self) -> dict[str, Any]:
        """The section `setup` of a truth file."""
        return {
            "motion": motion_to_dict(self.motion),
            "unit": self.unit.to_dict(),
            "effects": effects_to_list(self.effects),
            "user_effects": [_own_to_dict(own, values) for own, values in self.user_effects],
            "rate_hz": self.rate_hz,
            "gravity_mps2": self.gravity_mps2,
            "temperature": {"time_s": self.temperature.time_s, "temp_degc": self.temperature.temp_degc},
            **{name: getattr(self, name) for name in LINK},
            "seed": self.seed,
        }


@dataclass(frozen=True, eq=False)
class CoreSetup:
    """The setup in SI units, with the field names that the compiled library reads."""

    motion: Any
    unit: Unit
    effects: tuple[EffectValues, ...]
    rate_hz: float
    gravity_mps2: float
    temperature_time_s: FloatArray
    temperature_degc: FloatArray
    missing_share: float
    duplicated_share: float
    clock_rate_error: float
    clock_jitter_s: float
    seed: int
    added_force: FloatArray | None
    added_rate: FloatArray | None


def setup_from(node: Node, user_effects: Sequence[UserEffect] = ()) -> Setup:
    """The setup in a truth file.

    Raises InputError if the definition of an effect written in Python is missing.
    """
    require_fields(node, SETUP_FIELDS, "the setup of a run")
    require_fields(node.get("temperature"), ("time_s", "temp_degc"), "a temperature")
    for name, (low, high) in LINK.items():
        value = node.get(name).number()
        if not low <= value <= high:
            raise FormatError(f"{node.file}: {node.path}.{name} is {value}: give {low:g} to {high:g}")
    definitions = by_name(user_effects)
    for item in node.get("user_effects").items():
        name = item.get("name").text()
        if name not in definitions and "formula" in item.mapping():
            definitions[name] = _formula_of(item, name)
        if name not in definitions:
            raise InputError(
                f"{node.file}: the definition of the effect {name} is not in it: give it in user_effects"
            )
    own = effects_of(node.get("user_effects"), tuple(definitions.values()))
    knots = node.get("temperature")
    count = len(knots.get("time_s").items())
    try:
        return Setup(
            motion=motion_from(node.get("motion")),
            seed=node.get("seed").whole(),
            unit=unit_from(node.get("unit")),
            effects=effects_of(node.get("effects")),
            user_effects=tuple((definitions[values.name], values) for values in own),
            rate_hz=node.get("rate_hz").number(),
            gravity_mps2=node.get("gravity_mps2").number(),
            temperature=Temperature(knots.get("time_s").array(count), knots.get("temp_degc").array(count)),
            **{name: node.get(name).number() for name in LINK},
        )
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None


def _own_to_dict(own: UserEffect, values: EffectValues) -> dict[str, Any]:
    """A user-defined effect for a truth file, with its formula if a formula defines it."""
    (item,) = effects_to_list([values])
    if isinstance(own, FormulaEffect):
        item |= {"formula": own.text, "columns": list(own.auxiliary)}
    return item


def _formula_of(item: Node, name: str) -> FormulaEffect:
    columns = [column.text() for column in item.get("columns").items()]
    try:
        return FormulaEffect.of(item.get("formula").text(), columns=columns, name=name)
    except InputError as error:
        raise FormatError(f"{item.file}: {item.path}.formula: {error}") from None


def with_disturbances(setup: Setup, disturbances: Iterable[EffectValues]) -> Setup:
    """The setup with noise processes and faults added, whose names and values are in `disturbances`.

    Raises InputError for a fault that the motion cannot have (such as `mount_slip` without a stand).
    """
    for disturbance in disturbances:
        setup = DISTURB[disturbance.name](setup, disturbance.values)
    return setup


def _sensors(setup: Setup, **changed: Callable[[Sensor], Sensor]) -> Setup:
    """The setup with one or both sensors replaced."""
    sensors: dict[str, Any] = {name: change(getattr(setup.unit, name)) for name, change in changed.items()}
    return dataclasses.replace(setup, unit=dataclasses.replace(setup.unit, **sensors))


def _noisy(factor: float) -> Callable[[Sensor], Sensor]:
    return lambda sensor: dataclasses.replace(sensor, noise_in_motion=factor)


def _wandering(random_walk: FloatArray) -> Callable[[Sensor], Sensor]:
    return lambda sensor: dataclasses.replace(sensor, random_walk=random_walk)


def _ranged(limit: float) -> Callable[[Sensor], Sensor]:
    return lambda sensor: sensor.with_range(limit)


def _trembling(setup: Setup, tremor_rad: FloatArray) -> Setup:
    motion, tremor_deg = setup.motion, math.degrees(tremor_rad[0])
    if isinstance(motion, Tumble):
        return dataclasses.replace(setup, motion=dataclasses.replace(motion, tremor_deg=tremor_deg))
    if isinstance(motion, Program):
        shaking = dataclasses.replace(motion.stand or Stand(), tremor_deg=tremor_deg, tremor_seed=setup.seed)
        return dataclasses.replace(setup, motion=dataclasses.replace(motion, stand=shaking))
    raise InputError("rest_not_still needs a stand or a hand: give another motion than static")


def _slipping(setup: Setup, angle_rad: FloatArray) -> Setup:
    """The setup with a slip of the unit on its mount, during the move closest to the middle of the run.

    The axis of the slip is the diagonal of the body frame.
    """
    if not isinstance(setup.motion, Program):
        raise InputError("mount_slip needs a stand: give the motion random, grid or a program file")
    starts_s = np.cumsum([0.0, *(step.move_s + step.hold_s for step in setup.motion.steps)])
    turns_s = [
        start_s + step.move_s / 2
        for start_s, step in zip(starts_s[:-1].tolist(), setup.motion.steps, strict=True)
        if any(step.turn_deg)
    ]
    time_s = min(turns_s, key=lambda turn_s: abs(turn_s - starts_s[-1] / 2), default=starts_s[-1] / 2)
    axis_deg = math.degrees(angle_rad[0]) / math.sqrt(3.0)
    stand = setup.motion.stand or Stand()
    slipped = dataclasses.replace(stand, slip_deg=(axis_deg, axis_deg, axis_deg), slip_time_s=float(time_s))
    return dataclasses.replace(setup, motion=dataclasses.replace(setup.motion, stand=slipped))


DISTURB: Final[dict[str, Callable[[Setup, FloatArray], Setup]]] = {
    "gyro_bias_random_walk": lambda setup, walk: _sensors(setup, gyroscope=_wandering(walk)),
    "accel_bias_random_walk": lambda setup, walk: _sensors(setup, accelerometer=_wandering(walk)),
    "noise_grows_in_motion": lambda setup, factor: _sensors(
        setup, gyroscope=_noisy(float(factor[0])), accelerometer=_noisy(float(factor[0]))
    ),
    "gyro_saturation": lambda setup, limit: _sensors(setup, gyroscope=_ranged(float(limit[0]))),
    "accel_saturation": lambda setup, limit: _sensors(setup, accelerometer=_ranged(float(limit[0]))),
    "samples_missing": lambda setup, share: dataclasses.replace(setup, missing_share=float(share[0])),
    "samples_duplicated": lambda setup, share: dataclasses.replace(setup, duplicated_share=float(share[0])),
    "clock_irregular": lambda setup, jitter: dataclasses.replace(setup, clock_jitter_s=float(jitter[0])),
    "rest_not_still": _trembling,
    "mount_slip": _slipping,
}
