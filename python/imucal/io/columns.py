"""Text files without a canonical header, whose columns the caller names."""

from __future__ import annotations

import os
from collections.abc import Sequence

from imucal.document.source import open_file
from imucal.errors import InputError
from imucal.io.names import NAMES, SKIP, is_canonical
from imucal.io.text import read_headerless
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["column_list", "mapping_of", "read_columns"]


def read_columns(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str],
    rate_hz: float | None = None,
    skip_rows: int = 0,
) -> Recording:
    """Read columns of numbers separated by comma, semicolon, tab or spaces.

    columns    a name for every column, in the order of the file: canonical names ("accel_x_mps2,..."), `-` or
               `skip` for a column to ignore; columns with other names become auxiliary inputs
    rate_hz    sampling rate, Hz, if there is no time column
    skip_rows  number of lines to skip at the start; further lines that contain text are skipped in any case
    """
    names = column_list(columns)
    if not any(is_canonical(name) for name in names):
        raise InputError(f"columns is {','.join(names)!r}, which contains no canonical name: {NAMES}")
    if skip_rows < 0:
        raise InputError(f"skip_rows is {skip_rows}: give the number of lines to skip, 0 or more")
    file = open_file(path)
    table = read_headerless(file, [SKIP[0] if name in SKIP else name for name in names], skip_rows)
    return recording_from_table(table, [file.source], rate_hz)


def column_list(columns: str | Sequence[str]) -> list[str]:
    """The names in a comma-separated list."""
    return [name.strip() for name in (columns.split(",") if isinstance(columns, str) else columns)]


def mapping_of(columns: str | Sequence[str]) -> dict[str, str] | None:
    """{"time_s": "t"} for "time_s=t"; None for a list of names without `=`.

    Raises InputError if only some names have a `=`, or a canonical name is given twice.
    """
    split = [name.partition("=") for name in column_list(columns)]
    pairs = [(ours.strip(), theirs.strip()) for ours, _, theirs in split]
    if not any(theirs for _, theirs in pairs):
        return None
    for ours, theirs in pairs:
        if not ours or not theirs:
            raise InputError(
                f"columns contains {ours or theirs!r} without a partner: give canonical=name for all "
                "columns, or only names"
            )
        if sum(ours == other for other, _ in pairs) > 1:
            raise InputError(f"columns contains {ours} twice: give it once")
    return dict(pairs)
