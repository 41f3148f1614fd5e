"""Conversion of a journal to a recording, used after a completed run and after a crash."""

from __future__ import annotations

import os
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.io.canonical import write_columns
from imucal.stand.journal import Logged, read_journal
from imucal.stand.stream import TICKS_PER_S

__all__ = ["recover", "write_recording"]

STAND: Final = ("stand_1_deg", "stand_2_deg", "stand_3_deg")


def recover(journal: str | os.PathLike[str], output: str | os.PathLike[str]) -> Logged:
    """Write the complete samples of a journal as a recording, .csv or .parquet, and return its contents.

    Raises FormatError if the file is no journal, InputError if it has no samples or a file cannot be used.
    """
    logged = read_journal(journal)
    if len(logged.samples) == 0:
        raise InputError(
            f"{os.fspath(journal)} contains no samples: the run ended before the unit sent any; record again"
        )
    write_recording(logged, output)
    return logged


def write_recording(logged: Logged, output: str | os.PathLike[str]) -> None:
    """Write the samples with their column names, and the motor positions interpolated to the sample times."""
    columns = [(name, logged.samples[:, i]) for i, name in enumerate(logged.columns)]
    # If the unit's samples include encoder columns, the positions are not added.
    if len(logged.positions) and not any(name.startswith("stand_") for name in logged.columns):
        at_s = _host_instants(logged)
        columns += [
            (name, np.interp(at_s, logged.positions[:, 0], logged.positions[:, motor]))
            for motor, name in enumerate(STAND, start=1)
        ]
    write_columns(columns, output)


def _host_instants(logged: Logged) -> FloatArray:
    """The host time at which each sample was taken, (N,), s.

    Arrival times are delayed by a varying time in buffers, while the unit's clock is regular. So a straight
    line is fitted to arrival time over unit time, and lowered to the sample with the smallest delay.
    """
    name = next((column for column in logged.columns if column in TICKS_PER_S), None)
    if name is None or len(logged.samples) < 2:
        return logged.host_s
    unit_s = logged.samples[:, logged.columns.index(name)] / TICKS_PER_S[name]
    unit_s = unit_s - unit_s[0]
    if not np.isfinite(unit_s).all() or unit_s[-1] <= 0:
        return logged.host_s
    start_s = logged.host_s[0]
    slope, offset = np.polyfit(unit_s, logged.host_s - start_s, 1)
    line = slope * unit_s + offset
    instants: FloatArray = start_s + line + np.min(logged.host_s - start_s - line)
    return instants
