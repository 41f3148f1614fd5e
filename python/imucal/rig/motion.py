"""Motions of a simulated unit: a program on a stand, rotation by hand, or rest.

The public interface has angles in degrees and small lengths in millimetres, with the unit in the name. The
same seed gives the same motion.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

import imucal._core as _core
from imucal.document.agreement import require_fields
from imucal.document.json_document import Node, read_json, write_json
from imucal.document.whole import check_count, check_seed
from imucal.errors import FormatError, InputError
from imucal.rig.program_bounds import Fault, fault_of, too_many
from imucal.rig.stand import Stand, stand_of

__all__ = ["Motion", "Program", "Static", "Step", "Tumble"]

SCHEMA: Final = "imucal.program/1"
# Names of the fields of a program. A program file has the field `schema`. A program in a truth file has the
# field `kind` instead.
PROGRAM_FIELDS: Final = ("schema", "kind", "steps", "stand")
STEP_FIELDS: Final = ("turn_deg", "move_s", "hold_s")


@dataclass(frozen=True)
class Step:
    """Rotate the three motors by `turn_deg` (outermost first) in `move_s`, then rest for `hold_s`."""

    turn_deg: tuple[float, float, float]
    move_s: float
    hold_s: float


@dataclass(frozen=True)
class Program:
    """A program for the motors of a stand: a list of steps. All motors start at zero.

    stand  the errors of the stand on which the program runs; None is a perfect stand
    """

    steps: tuple[Step, ...]
    stand: Stand | None = None

    @property
    def duration_s(self) -> float:
        """Total duration of all rotations and rests, s."""
        return sum(step.move_s + step.hold_s for step in self.steps)

    @staticmethod
    def random(
        *, seed: int, moves: int = 45, max_rate_dps: float = 120.0, move_s: float = 2.0, hold_s: float = 5.0
    ) -> Program:
        """The gyroscope program of the paper that docs/model.md cites.

        It consists of random rotations of all motors, each between two rests.

        max_rate_dps  largest mean rate of each motor over a rotation, deg/s
        """
        check_seed(seed)
        check_count(moves, "moves")
        return Program.of_steps(_core.random_program(moves, math.radians(max_rate_dps), move_s, hold_s, seed))

    @staticmethod
    def grid(*, step_deg: float = 20.0, move_s: float = 1.0, hold_s: float = 5.0) -> Program:
        """The accelerometer program of the paper that docs/model.md cites.

        The poses are a grid in the angles of motor 3, over a full turn, and of motor 2, over half a turn.
        """
        return Program.of_steps(_core.grid_program(math.radians(step_deg), move_s, hold_s))

    @staticmethod
    def faces(*, rounds: int = 1, move_s: float = 1.5, hold_s: float = 3.0) -> Program:
        """Program that rolls a box over its faces: four turns of 90 deg about each axis while it is level.

        One round has 14 rests. Both a person at a table and a stand with three motors can run it, because
        every move turns one motor only.
        """
        check_count(rounds, "rounds")
        turns = [motor for round_ in range(rounds) for motor in ROUND_OF_FACES[0 if round_ else 1 :]]
        rest = Step((0.0, 0.0, 0.0), 0.0, hold_s)
        return Program((rest, *(Step(turn_deg, move_s, hold_s) for turn_deg in turns)))

    @staticmethod
    def of_steps(steps: Sequence[tuple[Sequence[float], float, float]]) -> Program:
        """A program from steps of the compiled library: rotations in rad, durations of move and rest in s."""
        return Program(
            tuple(
                Step(_triple([math.degrees(angle) for angle in turn_rad]), move_s, hold_s)
                for turn_rad, move_s, hold_s in steps
            )
        )

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Program:
        """Read a program file (schema imucal.program/1); FormatError names the invalid field."""
        node = read_json(path)
        node.require_schema(SCHEMA)
        return program_of(node)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the program file, atomically."""
        write_json({"schema": SCHEMA, **self.to_dict()}, path)

    def to_dict(self) -> dict[str, Any]:
        """The fields of the program file."""
        stand = {} if self.stand is None else {"stand": self.stand.to_dict()}
        return {"steps": self.steps, **stand}

    def in_si(self) -> StandMotion:
        """The motion as the compiled library reads it."""
        steps = tuple(
            (_triple([math.radians(angle) for angle in step.turn_deg]), step.move_s, step.hold_s)
            for step in self.steps
        )
        return StandMotion(steps, (self.stand or Stand()).in_si())


@dataclass(frozen=True)
class Tumble:
    """A unit rotated by hand: rests in random poses, with rotation and translation between them.

    poses           number of rests
    hold_s, move_s  duration of a rest and of a move
    tremor_deg      standard deviation of the tremor about each axis; 0 is no tremor
    translation_mm  edge of the cube that contains the positions of the poses; 0 for rotation in place
    """

    seed: int
    poses: int = 40
    hold_s: float = 4.0
    move_s: float = 2.0
    tremor_deg: float = 0.0
    translation_mm: float = 100.0

    @property
    def duration_s(self) -> float:
        """Total duration of all rests and moves, s."""
        return self.poses * self.hold_s + (self.poses - 1) * self.move_s

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_count(self.poses, "poses")

    def in_si(self) -> TumbleMotion:
        """The motion as the compiled library reads it."""
        return TumbleMotion(
            self.poses,
            self.hold_s,
            self.move_s,
            math.radians(self.tremor_deg),
            self.translation_mm * 1e-3,
            self.seed,
        )


@dataclass(frozen=True)
class Static:
    """A unit at rest; the quaternion `rotation_wxyz` maps a vector from body to world (x north, z up)."""

    duration_s: float = 60.0
    rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        norm = float(np.linalg.norm(np.asarray(self.rotation_wxyz, dtype=np.float64)))
        if len(self.rotation_wxyz) != 4 or not 1e-6 < norm < 1e6:
            raise InputError(f"rotation_wxyz is {self.rotation_wxyz}: four numbers, not all zero, are needed")

    def in_si(self) -> Static:
        """The same object, because it contains no angle that has to be converted to rad."""
        return self


# Rotations of the motors in one round over the faces, deg. The first rotation returns from the end of the
# previous round to the start. Four rotations about the level x axis of the unit follow, and then four
# rotations about the level y axis. One rotation makes the z axis level, and the last four rotations are about
# the z axis.
ROUND_OF_FACES: Final = (
    (0.0, -90.0, 0.0),
    *((90.0, 0.0, 0.0),) * 4,
    *((0.0, 90.0, 0.0),) * 5,
    *((0.0, 0.0, 90.0),) * 4,
)

Motion: TypeAlias = Program | Tumble | Static


@dataclass(frozen=True)
class StandMotion:
    """A program on a stand, as the compiled library reads it: angles in rad, lengths in m."""

    steps: tuple[tuple[tuple[float, float, float], float, float], ...]
    stand: Any


@dataclass(frozen=True)
class TumbleMotion:
    """A simulated hand-held run, as the compiled library reads it: angles in rad, lengths in m."""

    poses: int
    hold_s: float
    move_s: float
    tremor_rad: float
    translation_m: float
    seed: int


def motion_of(
    program: Motion | str | os.PathLike[str], seed: int, options: dict[str, float | int] | None = None
) -> Motion:
    """The motion for an argument: an object, a program file, or the name of a motion.

    The names are "random", "grid", "faces", "tumble" and "static".

    seed     seed of the moves of the random program and of the poses of the tumble
    options  arguments of the named motion, such as `moves` of "random"

    Raises InputError for an option that the motion does not have.
    """
    options = options or {}
    named: dict[str, Any] = {
        "random": lambda **given: Program.random(seed=seed, **given),
        "grid": Program.grid,
        "faces": Program.faces,
        "tumble": lambda **given: Tumble(seed, **given),
        "static": Static,
    }
    known = {
        "random": ("moves", "max_rate_dps", "move_s", "hold_s"),
        "grid": ("step_deg", "move_s", "hold_s"),
        "faces": ("rounds", "move_s", "hold_s"),
        "tumble": ("poses", "hold_s", "move_s", "tremor_deg", "translation_mm"),
        "static": ("duration_s",),
    }
    name = program if isinstance(program, str) and program in named else None
    unfit = [option for option in options if option not in known.get(name or "", ())]
    if unfit:
        having = [motion for motion, names in known.items() if unfit[0] in names]
        raise InputError(
            f"{unfit[0]} is an option of {' and '.join(having)}: leave it out, or give that motion"
        )
    if name is not None:
        motion: Motion = named[name](**options)
        return motion
    return program if isinstance(program, (Program, Tumble, Static)) else Program.read(program)


def motion_to_dict(motion: Motion) -> dict[str, Any]:
    """The motion for a truth file: "program", "tumble" or "static", and the parameters that reproduce it."""
    if isinstance(motion, Program):
        return {"kind": "program", **motion.to_dict()}
    kind = "tumble" if isinstance(motion, Tumble) else "static"
    return {"kind": kind, **dataclasses.asdict(motion)}


def motion_from(node: Node) -> Motion:
    """The motion in a truth file."""
    kind = node.get("kind").text(("program", "tumble", "static"))
    if kind == "program":
        return program_of(node)
    known = Static if kind == "static" else Tumble
    require_fields(node, ("kind", *(field.name for field in dataclasses.fields(known))), "a motion")
    if kind == "static":
        w, x, y, z = node.get("rotation_wxyz").array(4).tolist()
        return Static(node.get("duration_s").number(), (w, x, y, z))
    numbers = {name: node.get(name).number() for name in ("hold_s", "move_s", "tremor_deg", "translation_mm")}
    return Tumble(node.get("seed").whole(), node.get("poses").whole(), **numbers)


def program_of(node: Node) -> Program:
    """The program in a file."""
    require_fields(node, PROGRAM_FIELDS, "a program file")
    items = node.get("steps").items()
    _refuse(node, too_many(len(items)))
    steps = []
    for item in items:
        require_fields(item, STEP_FIELDS, "a step")
        turn_deg = _triple(item.get("turn_deg").array(3).tolist())
        steps.append(Step(turn_deg, item.get("move_s").number(), item.get("hold_s").number()))
    if not steps:
        raise FormatError(f"{node.file}: $.steps is empty: a program needs at least one step")
    _refuse(node, fault_of(steps))
    return Program(tuple(steps), stand_of(node.get("stand")) if "stand" in node.mapping() else None)


def _refuse(node: Node, fault: Fault | None) -> None:
    if fault is not None:
        raise FormatError(f"{node.file}: {fault.path.replace('$', node.path, 1)} {fault.reason}")


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = values
    return (first, second, third)
