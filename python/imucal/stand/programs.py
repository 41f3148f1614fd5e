"""Motion programs by name. The program of a control recording has the same poses in another order."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from typing import Final

import numpy as np

from imucal.document.whole import check_seed
from imucal.errors import InputError
from imucal.planning.plan import plan
from imucal.rig.motion import Program, Step

__all__ = ["PROGRAMS", "in_another_order", "program_named", "ranges_deg", "require_determined"]

# Built-in programs of `imucal stand`, as functions of the seed.
PROGRAMS: Final[dict[str, Callable[[int], Program]]] = {
    "random": lambda seed: Program.random(seed=seed),
    "grid": lambda _: Program.grid(),
    "optimal": lambda seed: plan("optimal", seed=seed, detection_limits=False).program,
}


def program_named(name: str | os.PathLike[str], seed: int) -> Program:
    """A program from `PROGRAMS` or from a file. Raises FormatError for an invalid file."""
    made = PROGRAMS.get(os.fspath(name))
    return Program.read(name) if made is None else made(seed)


def in_another_order(program: Program, seed: int) -> Program:
    """The poses of a program in another order on the same path.

    The motors follow the path of the program forward and then backward, because no other path is known to be
    free of end stops and obstacles. Some poses are held on the way out, and the others on the way back. The
    program ends in the pose of the first step.

    seed  seed of the random choice of the poses that are held on the way out. On the way out, the motors pass
          all other poses without a hold
    """
    check_seed(seed)
    steps = program.steps
    # Of each pair of neighbouring poses, such as those of steps 1 and 2, one is held on the way out and the
    # other on the way back. The moves between held poses are therefore short, which limits the attitude error
    # due to gyroscope noise.
    first = np.random.default_rng(seed).random(len(steps)) < 0.5
    on_way_out = np.ones(len(steps), dtype=bool)
    on_way_out[1::2] = first[1::2]
    on_way_out[2::2] = ~first[1:-1:2]
    on_way_out[-1] = True
    out = [
        step if held else dataclasses.replace(step, hold_s=0.0)
        for step, held in zip(steps, on_way_out, strict=True)
    ]
    back = []
    for number in range(len(steps) - 1, 0, -1):
        x, y, z = (-turn for turn in steps[number].turn_deg)
        # The last pose on the way back is always held, because a move can only be used if a rest follows it.
        held = number == 1 or not on_way_out[number - 1]
        back.append(Step((x, y, z), steps[number].move_s, steps[number - 1].hold_s if held else 0.0))
    return dataclasses.replace(program, steps=(*out, *back))


def ranges_deg(program: Program) -> list[list[float]]:
    """The smallest and the largest angle of each motor, deg, if all motors start at 0 deg."""
    angles = np.cumsum([(0.0, 0.0, 0.0), *(step.turn_deg for step in program.steps)], axis=0)
    ranges: list[list[float]] = np.stack([angles.min(axis=0), angles.max(axis=0)], axis=1).tolist()
    return ranges


def require_determined(program: Program, name: str) -> None:
    """Raises InputError, with parameter names, if a program does not determine all parameters of a unit."""
    planned = plan(program, detection_limits=False)
    if planned.undetermined is not None:
        unknown = [parameter.name for parameter in planned.parameters if parameter.std is None]
        raise InputError(
            f"the program {name} does not determine {', '.join(unknown) or 'the parameters'}, so it cannot "
            f"be used to judge a unit: {planned.undetermined}; or give another program, such as random"
        )
