"""A hidden case: what the tool is given, and what is hidden in it under a seal."""

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

import imucal
from gap.scene import Scene, cycle, record, simulated

# Seed of the benchmarks of laws, units and temperatures.
OTHERS_SEED: Final = 20240
_SEED: ContextVar[int] = ContextVar("seed", default=OTHERS_SEED)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Cases that are made inside belong to this seed."""
    token = _SEED.set(seed)
    try:
        yield
    finally:
        _SEED.reset(token)


@dataclass(frozen=True)
class Answer:
    """What is hidden.

    effects   of the catalogue or the user's own, with their numbers; empty for a clean run
    verdicts  what a tool may say; the first is the best
    names     names that are right for it though the form is another (off-form cases)
    block     "gyroscope" or "accelerometer" and "bias" or "scale"; "encoder"; or ""
    fault     of spoilt data, else ""
    """

    effects: tuple[imucal.EffectValues, ...] = ()
    verdicts: tuple[str, ...] = ("named",)
    names: tuple[str, ...] = ()
    block: str = ""
    fault: str = ""

    @property
    def truth(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects) or self.names


class Sealed:
    """The answer; it opens for whoever has answered first."""

    def __init__(self, answer: Answer, scene: Scene) -> None:
        self.__answer = answer
        self.__scene = scene

    def open(self, said: object) -> Answer:
        if said is None:
            raise ValueError("the answer is sealed until the tool has answered")
        return self.__answer

    def run_again(
        self, said: object, seed: int, program: imucal.Program, heat_and_cool: bool
    ) -> imucal.Recording:
        """What the unit measures in the motion that the tool asked for."""
        if said is None:
            raise ValueError("the tool has not asked for a motion yet")
        scene = self.__scene
        if heat_and_cool:
            scene = replace(scene, temperature=cycle(program.duration_s))
        return record(scene, seed, program, name="advised")

    def truth(self, said: object, seed: int) -> imucal.Truth:
        """What the unit underwent in the run of this seed."""
        if said is None:
            raise ValueError("the truth is sealed until the tool has answered")
        truth: imucal.Truth = simulated(self.__scene, seed).truth
        return truth


@dataclass(frozen=True)
class Case:
    """One question to a tool.

    group       what it counts for
    label       what it is, for the table; it may give the answer away, so no tool sees it
    given       what a user would give besides the recordings: candidates, user_effects
    base        seed of the benchmark
    """

    group: str
    label: str
    index: int
    scene: Scene = field(repr=False)
    answer: Answer = field(repr=False)
    given: dict[str, object] = field(default_factory=dict, repr=False)
    level: str = ""
    base: int = field(default_factory=_SEED.get, repr=False)

    @property
    def kind(self) -> str:
        return self.scene.kind

    @property
    def seed(self) -> int:
        """Differs from case to case, and is the same in every run of the benchmark."""
        return seed_of(self.base, self.group, self.label, self.level, self.index)

    @property
    def control_seed(self) -> int:
        return self.seed + 1

    @property
    def key(self) -> tuple[str, str, str, str, int]:
        """What tells it from all others."""
        return self.group, self.label, self.level, self.kind, self.index

    @property
    def mixed(self) -> int:
        """A number that mixes the cases."""
        return zlib.crc32("/".join(map(str, self.key)).encode())

    def pose(self) -> tuple[imucal.Recording, imucal.Recording, Sealed]:
        """The recording, the control recording, and the sealed answer."""
        measured = record(self.scene, self.seed)
        control = record(self.scene, self.control_seed, name="control")
        return measured, control, Sealed(self.answer, self.scene)


def seed_of(base: int, *names: object) -> int:
    """A seed out of names, far from all others."""
    words = "/".join(map(str, names)).encode()
    return (base << 33) + (zlib.crc32(words) << 1)


def generator(*names: object) -> np.random.Generator:
    """The numbers that are drawn for a case; another stream than that of its noise."""
    return np.random.default_rng([_SEED.get(), zlib.crc32("/".join(map(str, names)).encode())])


def spread(cases: Sequence[Case], share: float) -> list[Case]:
    """The first cases of every cell, at least one of each."""
    cells: dict[tuple[str, str, str, str], list[Case]] = {}
    for case in cases:
        cells.setdefault((case.group, case.label, case.level, case.kind), []).append(case)
    return [case for cell in cells.values() for case in cell[: max(1, round(share * len(cell)))]]
