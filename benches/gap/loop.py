"""The loop closed: the advised motion is simulated, and the question is asked again with both runs."""

import os
from pathlib import Path
from typing import Any

import imucal
from gap.case import Case, Sealed
from gap.said import Said, find_gap, part


def ask_again(
    case: Case, measured: imucal.Recording, control: imucal.Recording, said: Said, gap: Any, sealed: Sealed
) -> Said | None:
    """The answer with the advised motion; None if no motion was advised."""
    advice = None if gap is None else part(gap, "next_motion")
    if advice is None:
        return None
    program = program_of(part(advice, "program"))
    further = sealed.run_again(said, case.seed + (1 << 32), program)
    return find_gap([measured, further], control, case)[0]


def program_of(given: Any) -> imucal.Program | None:
    """A program as it is given, or out of a file."""
    if isinstance(given, (str, os.PathLike)):
        return imucal.Program.read(Path(given))
    return given if isinstance(given, imucal.Program) else None
