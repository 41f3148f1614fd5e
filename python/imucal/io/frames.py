"""Conversion of data frames to recordings, and of recordings to Arrow tables with canonical column names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from imucal.data_frame import is_frame
from imucal.errors import FormatError, InputError
from imucal.io.arrow_values import arrow_of
from imucal.io.canonical import chosen
from imucal.io.names import time_unit
from imucal.io.table import Table
from imucal.io.vocabulary import column_names, recording_from_table
from imucal.recording.recording import Recording

__all__ = ["read_frame", "to_table"]

# Name that pandas gives to an index without a name when it exports a data frame.
INDEX: Final = "__index_level_0__"


def read_frame(
    frame: Any, *, columns: str | Sequence[str] | None = None, rate_hz: float | None = None
) -> Recording:
    """The recording in a data frame with the Arrow PyCapsule interface.

    columns  "canonical=name,..." if the frame has other names
    rate_hz  sampling rate, Hz, if there is no time column

    If there is no time column, an index of time stamps is used as the time column. Raises FormatError and
    InputError as for a file.
    """
    import pyarrow as pa

    kind = type(frame).__name__
    if not is_frame(frame):
        raise InputError(f"a {kind} is no data frame with the Arrow interface (__arrow_c_stream__)")
    try:
        # pa.table is not used, because it would import pandas to check the type of the frame.
        reader = pa.RecordBatchReader
        has_stream = hasattr(reader, "from_stream") and hasattr(frame, "__arrow_c_stream__")
        table = reader.from_stream(frame).read_all() if has_stream else pa.table(frame)
    except (pa.ArrowException, TypeError, ValueError, NotImplementedError) as error:
        reason = " ".join(str(error).split())[:200]
        raise FormatError(f"the {kind} cannot be converted to an Arrow table: {reason}") from None
    names, values = list(table.column_names), [_plain(column) for column in table.columns]
    has_time = rate_hz is not None or any(map(time_unit, names)) or columns is not None
    for index, name in enumerate(names):
        if name == INDEX and not has_time and pa.types.is_timestamp(values[index].type):
            names[index] = "time_s"
    kept = [index for index, name in enumerate(names) if name != INDEX]
    whole = Table(
        kind,
        [names[index] for index in kept],
        [values[index] for index in kept],
        lambda row: f"row {row + 1}",
    )
    return recording_from_table(chosen(whole, columns, has_rate=rate_hz is not None), [], rate_hz)


def to_table(recording: Recording) -> Any:
    """A recording as an Arrow table with canonical column names. Every number is preserved bit for bit."""
    import pyarrow as pa

    columns = column_names(recording)
    return pa.table([arrow_of(values) for _, values in columns], names=[name for name, _ in columns])


def _plain(column: Any) -> Any:
    """The column with decimal numbers converted to floating point; other columns are unchanged."""
    import pyarrow as pa

    return column.cast(pa.float64()) if pa.types.is_decimal(column.type) else column
