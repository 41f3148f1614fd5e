"""Conversion of a journal to a recording, used after a completed run and after a crash."""

from __future__ import annotations

import os
from typing import Final

from imucal.errors import InputError
from imucal.io.canonical import write_columns
from imucal.stand.clock_join import joined_angles
from imucal.stand.journal import Logged, read_journal

__all__ = ["recover", "write_recording"]

STAND: Final = ("stand_1_deg", "stand_2_deg", "stand_3_deg")


def recover(journal: str | os.PathLike[str], output: str | os.PathLike[str]) -> Logged:
    """Write the complete samples of a journal as a recording, .csv or .parquet.

    Returns the contents of the journal. Raises FormatError if the file is not a journal, InputError if it
    has no samples or a file cannot be used.
    """
    logged = read_journal(journal)
    if len(logged.samples) == 0:
        raise InputError(
            f"{os.fspath(journal)} contains no samples: the run ended before the unit sent any; record again"
        )
    write_recording(logged, output)
    return logged


def write_recording(logged: Logged, output: str | os.PathLike[str]) -> None:
    """Write the samples with their column names, and the motor positions interpolated to the sample times.

    The angles are missing (NaN) where the stand moved while no position was reported.
    """
    columns = [(name, logged.samples[:, i]) for i, name in enumerate(logged.columns)]
    # The reported motor positions are not added if the unit's samples already include encoder columns.
    if len(logged.positions) and not any(name.startswith("stand_") for name in logged.columns):
        columns += list(zip(STAND, joined_angles(logged).T, strict=True))
    write_columns(columns, output)
