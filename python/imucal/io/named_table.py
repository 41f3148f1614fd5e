"""Assigns canonical names to columns of Parquet files and data frames whose names state all units."""

from __future__ import annotations

from dataclasses import replace

from imucal.io.first_cells import TableCells
from imucal.io.headed import as_read, canonical_names, certain_time, with_corrections
from imucal.io.header import header_of
from imucal.io.names import SKIP, triad_part
from imucal.io.stamps import joined_stamps
from imucal.io.table import Table

__all__ = ["by_header"]


def by_header(table: Table, *, has_rate: bool) -> Table:
    """The table with canonical names if its names are unambiguous; otherwise the table unchanged.

    has_rate  whether the caller gives the sampling rate, so that no time column is needed
    """
    if any(map(triad_part, table.names)):
        return table
    header, cells = header_of(table.names), TableCells(table)
    certain = certain_time(header, cells, has_rate)
    if certain is None:
        return table
    time, ticks = certain
    names = canonical_names(table.names, header, time)
    used = [index for index, name in enumerate(names) if name not in SKIP]
    named = replace(
        table,
        names=[names[index] for index in used],
        columns=[table.columns[index] for index in used],
        ticks_per_s=ticks,
        findings=(*table.findings, as_read(table.file, header, time)),
    )
    return with_corrections(joined_stamps(named), header.program)
