"""Reader of text files without a canonical header, for which the caller names the columns."""

from __future__ import annotations

import os
from collections.abc import Sequence

from imucal.errors import FormatError, InputError
from imucal.io.agreement import require_agreement
from imucal.io.head import Head
from imucal.io.interleaved import refuse_interleaved
from imucal.io.layout import is_number
from imucal.io.mapping import column_list
from imucal.io.names import NAMES, SKIP, is_canonical
from imucal.io.suggestion import rows_of_several_sensors
from imucal.io.text import Text, open_path, read_rows
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["read_columns"]


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
    skip_rows  number of lines to skip at the start; further lines with text are always skipped
    """
    names = column_list(columns)
    if not any(is_canonical(name) for name in names):
        raise InputError(f"columns is {','.join(names)!r}, which contains no canonical name: {NAMES}")
    if skip_rows < 0:
        raise InputError(f"skip_rows is {skip_rows}: give the number of lines to skip, 0 or more")
    names = [SKIP[0] if name in SKIP else name for name in names]
    used = [index for index, name in enumerate(names) if is_canonical(name)]
    text = open_path(path, width=len(names), used=used, skip_rows=skip_rows)
    layout = text.layout
    if not layout.first:
        raise FormatError(
            f"{text.name}: no line consists of numbers only: check that it is the right file, and a text "
            "file of numbers without labels"
        )
    if len(layout.first) == len(names) + 1 and not layout.first[-1]:
        names.append(SKIP[0])
    if len(layout.first) != len(names):
        raise FormatError(
            f"{text.name}: line {layout.line} has {len(layout.first)} values but {len(names)} columns are "
            f"named ({', '.join(names)}): name every column, '-' for a column to ignore"
        )
    require_agreement(text.name, layout, names, check_axes=True)
    if layout.names is None and SKIP[0] in names and not all(map(is_number, layout.first)):
        _refuse_rows_of_several_sensors(text, names)
    refuse_interleaved(text, names)
    return recording_from_table(read_rows(text, names), text.sources, rate_hz)


def _refuse_rows_of_several_sensors(text: Text, names: Sequence[str]) -> None:
    """Raises FormatError if an ignored column names the sensor of each row, such as `acc` or `gyro`."""
    cells = Head(text).cells
    ignored = [cells[str(index)] for index, name in enumerate(names) if name in SKIP and str(index) in cells]
    # Cells of one or two letters are ignored, because they can be other labels, such as classes `a` and `w`.
    words = {str(at): [cell for cell in column if len(cell) > 2] for at, column in enumerate(ignored, 1)}
    several = rows_of_several_sensors(words)
    if several:
        raise FormatError(f"{text.name}: {several.rstrip()}")
