"""The loop closed: the advised motion is simulated, and the question is asked again with both runs."""

import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
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
    # The program tells the stand how to turn; the temperature is that of the advice.
    cycle = any(str(option).startswith("cycle:") for option in part(advice, "simulate"))
    further = sealed.run_again(said, case.seed + (1 << 32), program, cycle)
    return find_gap([further] if part(advice, "on_its_own") else [measured, further], control, case)[0]


def program_of(given: Mapping[str, Any]) -> imucal.Program:
    """The program in the fields of a program file, read as the stand would read it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "program.json"
        path.write_text(json.dumps(given), encoding="utf-8")
        return imucal.Program.read(path)
