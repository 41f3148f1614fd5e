"""Programs by the names that people give them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Final

from imucal.motion import Program
from imucal.plan import plan

__all__ = ["PROGRAMS", "program_named"]

# The choice of `imucal stand`: a name, and a program for a seed.
PROGRAMS: Final[dict[str, Callable[[int], Program]]] = {
    "random": lambda seed: Program.random(seed=seed),
    "grid": lambda _: Program.grid(),
    "optimal": lambda seed: plan("optimal", seed=seed, detection_limits=False).program,
}


def program_named(name: str | os.PathLike[str], seed: int) -> Program:
    """One of `PROGRAMS`, or the program of a file; FormatError names the field of a file that is wrong."""
    made = PROGRAMS.get(os.fspath(name))
    return Program.read(name) if made is None else made(seed)
