"""Conversion of the samples of a run (rows of numbers with column names) to a recording."""

from __future__ import annotations

from collections.abc import Sequence

from imucal.arrays import FloatArray
from imucal.io.table import Table
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["recording_of"]


def recording_of(columns: Sequence[str], rows: FloatArray, name: str) -> Recording:
    """The recording `name` of the samples `rows`, (N, columns). InputError if a needed column is missing."""
    import pyarrow as pa

    table = Table(name, list(columns), [pa.array(column) for column in rows.T], lambda row: f"row {row + 1}")
    return recording_from_table(table, ())
