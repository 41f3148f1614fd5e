"""The package's own format: CSV and Parquet with the unit in the column's name (see `vocabulary`)."""

from __future__ import annotations

import io
import os

from imucal.atomic import write_atomically
from imucal.errors import FormatError
from imucal.io.source import File, Table, open_file
from imucal.io.text import read_headed
from imucal.io.vocabulary import column_names, recording_from_table
from imucal.recording import Recording

__all__ = ["read_csv", "read_parquet", "write_csv", "write_parquet"]

PARQUET_MAGIC = b"PAR1"


def read_csv(path: str | os.PathLike[str], *, rate_hz: float | None = None) -> Recording:
    """Read a canonical CSV file; `rate_hz` if it has no time column."""
    file = open_file(path)
    return recording_from_table(read_headed(file), [file.source], rate_hz)


def read_parquet(path: str | os.PathLike[str], *, rate_hz: float | None = None) -> Recording:
    """Read a canonical Parquet file; `rate_hz` if it has no time column."""
    file = open_file(path)
    return recording_from_table(_parquet_table(file), [file.source], rate_hz)


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as canonical CSV; reading it gives every number back bit for bit."""
    import pyarrow as pa
    from pyarrow import csv

    columns = column_names(recording)
    table = pa.table([values for _, values in columns], names=[name for name, _ in columns])
    with write_atomically(path) as file:
        # The header by hand: Arrow would put it in quotes.
        file.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


def write_parquet(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as canonical Parquet."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = column_names(recording)
    table = pa.table([values for _, values in columns], names=[name for name, _ in columns])
    with write_atomically(path) as file:
        parquet.write_table(table, file, compression="zstd")


def _parquet_table(file: File) -> Table:
    import pyarrow as pa
    from pyarrow import parquet

    if not file.content.startswith(PARQUET_MAGIC):
        raise FormatError(
            f"{file.name} is not a Parquet file (it does not start with PAR1): check its format"
        )
    try:
        table = parquet.read_table(io.BytesIO(file.content))
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise FormatError(f"{file.name} is a damaged or truncated Parquet file: {reason}") from None
    return Table(file.name, table.column_names, table.columns, lambda row: f"row {row + 1}")
