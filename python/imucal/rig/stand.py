"""Errors of a stand: geometry, stiffness, vibration and encoders."""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.document.json_document import Node, read_json, write_json
from imucal.document.whole import check_count, check_seed
from imucal.effects.effect import EffectValues
from imucal.effects.table import find
from imucal.effects.values import effects_of, effects_to_list
from imucal.errors import FormatError, InputError
from imucal.rig.program_bounds import MAX_DURATION_S

__all__ = ["Stand"]

SCHEMA: Final = "imucal.stand/1"
# Standard deviations of the errors of a cheap stand. Such a stand has hobby servos, magnetic encoders and
# printed rings, and it is aligned by eye.
CHEAP: Final = {
    "mount_rotation_deg": 1.0,
    "base_tilt_deg": 0.5,
    "non_orthogonality_deg": 0.5,
    "flexure_deg": 0.1,
    "vibration_deg": 0.02,
    "vibration_mm": 0.05,
    "encoder_noise_deg": 0.02,
}
# Largest accepted value of an error of a stand, by the unit suffix of its name: a revolution, a metre,
# 100 kHz, and a week.
LARGEST: Final = {"_deg": 360.0, "_mm": 1000.0, "_hz": 1e5, "_s": MAX_DURATION_S}
NOT_NEGATIVE: Final = (
    *("vibration_deg", "vibration_mm", "vibration_hz", "encoder_noise_deg", "tremor_deg", "slip_time_s"),
)
# The encoders of the cheap stand have 12 bits. Their errors are the effects `CHEAP_ENCODERS` of the
# catalogue, drawn at random with the typical sizes of these effects as standard deviations.
CHEAP_COUNTS: Final = 4096
CHEAP_ENCODERS: Final = ("encoder_eccentricity", "encoder_time_offset", "encoder_backlash")
CHEAP_VIBRATION_HZ: Final = (20.0, 80.0)


@dataclass(frozen=True)
class Stand:
    """Errors of a stand; a perfect stand has all of them at zero.

    mount_rotation_deg     rotation vector of the unit on the innermost ring
    base_tilt_deg          tilt of the base about the x and y axes of the world
    non_orthogonality_deg  deviations from a right angle of axis 2 to axis 1, and of axis 3 to axis 2
    flexure_deg            sag of the innermost ring with axis 3 horizontal
    vibration_deg, vibration_mm, vibration_hz   amplitudes and frequency of the vibration while motors rotate
    encoder_noise_deg      standard deviation of the white noise of a reading
    encoder_counts         counts of an encoder per revolution, or None for no quantisation
    encoder_effects        effects of the catalogue on the encoder readings
    tremor_deg             standard deviation about each axis of a vibration that continues at rest
    tremor_seed            seed of the frequencies and phases of the tremor
    slip_deg, slip_time_s  rotation vector by which the unit slips on its mount, and the time of the slip
    """

    mount_rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_tilt_deg: tuple[float, float] = (0.0, 0.0)
    non_orthogonality_deg: tuple[float, float] = (0.0, 0.0)
    flexure_deg: float = 0.0
    vibration_deg: float = 0.0
    vibration_mm: float = 0.0
    vibration_hz: float = 0.0
    encoder_noise_deg: float = 0.0
    encoder_counts: int | None = None
    encoder_effects: tuple[EffectValues, ...] = ()
    tremor_deg: float = 0.0
    tremor_seed: int = 0
    slip_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slip_time_s: float = 0.0

    def __post_init__(self) -> None:
        if self.encoder_counts is not None:
            check_count(self.encoder_counts, "encoder_counts")
        check_seed(self.tremor_seed)
        for effect in self.encoder_effects:
            if find(effect.name).sensor != "encoder":
                raise InputError(
                    f"{effect.name} is no effect on encoders: give it to the simulation's effects"
                )

    @staticmethod
    def cheap(seed: int) -> Stand:
        """A cheap stand with random errors; the same seed gives the same stand.

        The errors are normally distributed with standard deviations of 1 deg (mount, per axis), 0.5 deg
        (tilt, right angles) and 0.1 deg (flexure). Vibration (0.02 deg, 0.05 mm, at 20 to 80 Hz) and encoder
        noise (0.02 deg) are absolute values of normal draws. The encoders have 4096 counts. Their
        eccentricity, time offset and backlash are normally distributed with the typical sizes of the
        catalogue as standard deviations.
        """
        check_seed(seed)
        random = np.random.default_rng(seed)
        drawn: dict[str, Any] = {}
        for field in dataclasses.fields(Stand):
            if field.name in CHEAP:
                size = len(field.default) if isinstance(field.default, tuple) else None
                value = random.normal(scale=CHEAP[field.name], size=size)
                drawn[field.name] = tuple(value.tolist()) if size else float(value)
        for name in ("vibration_deg", "vibration_mm", "encoder_noise_deg"):
            drawn[name] = abs(drawn[name])
        effects = []
        for name in CHEAP_ENCODERS:
            effect = find(name)
            typical = np.array([parameter.typical for parameter in effect.parameters[: effect.plain]])
            effects.append(EffectValues(name, random.normal(scale=typical)))
        return Stand(
            **drawn,
            vibration_hz=float(random.uniform(*CHEAP_VIBRATION_HZ)),
            encoder_counts=CHEAP_COUNTS,
            encoder_effects=tuple(effects),
        )

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Stand:
        """Read a stand file (schema imucal.stand/1); FormatError names the invalid field."""
        node = read_json(path)
        node.require_schema(SCHEMA)
        return stand_of(node)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the stand file, atomically."""
        write_json({"schema": SCHEMA, **self.to_dict()}, path)

    def to_dict(self) -> dict[str, Any]:
        """The fields of the stand file, and of the section `stand` of a program file."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(Stand)}
        return {**fields, "encoder_effects": effects_to_list(self.encoder_effects)}

    def in_si(self) -> StandErrors:
        """The stand as the compiled library reads it."""
        return StandErrors(
            tuple(map(math.radians, self.mount_rotation_deg)),
            tuple(map(math.radians, self.base_tilt_deg)),
            tuple(map(math.radians, self.non_orthogonality_deg)),
            math.radians(self.flexure_deg),
            math.radians(self.vibration_deg),
            self.vibration_mm * 1e-3,
            self.vibration_hz,
            math.radians(self.encoder_noise_deg),
            self.encoder_counts,
            math.radians(self.tremor_deg),
            self.tremor_seed,
            tuple(map(math.radians, self.slip_deg)),
            self.slip_time_s,
        )


@dataclass(frozen=True)
class StandErrors:
    """The errors of a stand, as the compiled library reads them: angles in rad, lengths in m."""

    mount_rotation_rad: tuple[float, ...]
    base_tilt_rad: tuple[float, ...]
    non_orthogonality_rad: tuple[float, ...]
    flexure_rad: float
    vibration_rad: float
    vibration_m: float
    vibration_hz: float
    encoder_noise_rad: float
    encoder_counts: int | None
    tremor_rad: float
    tremor_seed: int
    slip_rad: tuple[float, ...]
    slip_time_s: float


def stand_of(node: Node) -> Stand:
    """The stand that a file describes. An error whose field is missing is zero."""
    known = {field.name: field.default for field in dataclasses.fields(Stand)}
    found: dict[str, Any] = {}
    for name in node.mapping():
        if name == "schema":
            continue
        if name not in known:
            raise FormatError(
                f"{node.file}: {node.path}.{name} is no field of a stand: give {', '.join(known)}"
            )
        field, default = node.get(name), known[name]
        if name == "encoder_effects":
            found[name] = effects_of(field)
        elif name == "encoder_counts":
            found[name] = None if field.value is None else field.whole()
        elif name == "tremor_seed":
            found[name] = field.whole()
        elif isinstance(default, tuple):
            found[name] = tuple(field.array(len(default)).tolist())
        else:
            found[name] = field.number()
    for name, value in found.items():
        _require_possible(node, name, value)
    try:
        return Stand(**found)
    except InputError as error:
        raise FormatError(f"{node.file}: {node.path}: {error}") from None


def _require_possible(node: Node, name: str, value: Any) -> None:
    """Raise FormatError if a stand error in the file is larger than that of any real stand."""
    most = next((most for ending, most in LARGEST.items() if name.endswith(ending)), None)
    if most is None:
        return
    low = 0.0 if name in NOT_NEGATIVE else -most
    numbers = np.atleast_1d(value)
    if not ((numbers >= low) & (numbers <= most)).all():
        raise FormatError(
            f"{node.file}: {node.path}.{name} is {node.get(name).value}: give {low:g} to {most:g} in its unit"
        )


def stand_from_name(stand: Stand | str | os.PathLike[str]) -> Stand:
    """The stand for an argument: a Stand, "perfect", "cheap" or "cheap:SEED", or the path of a stand file."""
    if isinstance(stand, Stand):
        return stand
    name, _, seed = os.fspath(stand).partition(":")
    if name == "perfect" and not seed:
        return Stand()
    # The seed of the stand is separate from the seed of the run, because a run and its control run usually
    # share one stand.
    if name == "cheap" and (seed or "1").isdigit():
        return Stand.cheap(int(seed or "1"))
    return Stand.read(stand)
