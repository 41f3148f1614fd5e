"""From a journal to a recording's file: the same after a good run and after a crash."""

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
    """Write what is whole in a journal as a recording, .csv or .parquet; returns what was read.

    Raises FormatError if it is no journal, InputError if it has no sample or a file cannot be used.
    """
    logged = read_journal(journal)
    if len(logged.samples) == 0:
        raise InputError(
            f"{os.fspath(journal)} holds no sample: the run ended before the unit sent any; record again"
        )
    write_recording(logged, output)
    return logged


def write_recording(logged: Logged, output: str | os.PathLike[str]) -> None:
    """Write the samples under their own names, and the positions of the motors at their instants."""
    columns = [(name, logged.samples[:, i]) for i, name in enumerate(logged.columns)]
    # A unit's own encoders are read with its samples and need no joining.
    if len(logged.positions) and not any(name.startswith("stand_") for name in logged.columns):
        at_s = _host_instants(logged)
        columns += [
            (name, np.interp(at_s, logged.positions[:, 0], logged.positions[:, motor]))
            for motor, name in enumerate(STAND, start=1)
        ]
    write_columns(columns, output)


def _host_instants(logged: Logged) -> FloatArray:
    """The host's time at which each sample was taken.

    Arrival is late by what lies in buffers, now more, now less: the unit's clock is even, and the straight
    line through arrivals, lowered to the earliest of them, has the least delay.
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
