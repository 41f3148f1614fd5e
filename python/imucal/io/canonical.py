"""The canonical formats: CSV and Parquet with the unit in each column name (see `vocabulary`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from imucal.arrays import FloatArray
from imucal.document.source import first_bytes, open_large
from imucal.errors import FormatError, ImucalError, InputError
from imucal.io.agreement import require_agreement_of_names
from imucal.io.alone import recording_of_any_text
from imucal.io.arrow_values import arrow_of
from imucal.io.mapping import mapping_of
from imucal.io.named_table import by_header
from imucal.io.names import is_canonical
from imucal.io.parquet_pages import require_plausible_pages, require_plausible_rows
from imucal.io.starts import PARQUET_MAGIC
from imucal.io.table import ROWS_AT_ONCE, Stored, Table
from imucal.io.text import open_path
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = [
    "chosen",
    "parquet_table",
    "read_csv",
    "read_parquet",
    "require_ending",
    "write_columns",
    "write_parts",
]

# Size of the read buffer for a Parquet column chunk, bytes.
BUFFER = 1 << 20
CSV, PARQUET = ".csv", ".parquet"
# Number of rows in each row group of a written Parquet file. It is Arrow's default.
ROWS_WRITTEN = 1 << 20
# Number of rows that are formatted as one block of CSV. Blocks are small, because a single whole number, to
# which `_with_points` appends ".0", makes the formatting of its whole block slower.
ROWS_OF_TEXT = 1 << 16

# Names and values of columns, in the order in which they are written.
Columns: TypeAlias = Sequence[tuple[str, FloatArray]]


def read_csv(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Read a CSV file with a header line.

    columns  "canonical=name,..." if the header has other names. Columns that are not listed are also read if
             their names are canonical and not assigned to another column. All other columns are ignored.
    rate_hz  sampling rate, Hz, if there is no time column
    """
    return recording_of_any_text(open_path(path), columns, rate_hz)


def read_parquet(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Read a Parquet file, with the arguments of `read_csv`."""
    source = open_large(path)
    table = chosen(parquet_table(path), columns, has_rate=rate_hz is not None)
    return recording_from_table(table, [source], rate_hz)


def write_columns(columns: Columns, path: str | os.PathLike[str]) -> None:
    """Write columns with canonical names as CSV or Parquet, depending on the extension of `path`.

    Reading the file returns every number bit for bit. Raises InputError for another extension, or if the file
    cannot be written.
    """
    write_parts([columns], path)


def write_parts(parts: Iterable[Columns], path: str | os.PathLike[str]) -> None:
    """Write columns that are given in one or more parts. The file equals the file of `write_columns`."""
    from imucal.document.atomic import write_atomically

    require_ending(path)
    written = _parquet_writer if Path(path).suffix.lower() == PARQUET else _csv_writer
    with write_atomically(path) as file:
        tables = (table for columns in parts for table in _tables(columns))
        first = next(tables)
        with written(file, first.schema) as write:
            for table in chain([first], tables):
                write(table)


def require_ending(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless the name of an output file ends with .csv or .parquet."""
    if Path(path).suffix.lower() not in (CSV, PARQUET):
        raise InputError(
            f"{os.fspath(path)}: recordings are written as .csv or .parquet: change the extension"
        )


def _tables(columns: Columns) -> Iterator[Any]:
    """The columns as Arrow tables of at most `ROWS_WRITTEN` rows. Only one table is in memory at a time."""
    import pyarrow as pa

    names, rows = [name for name, _ in columns], len(columns[0][1])
    for start in range(0, max(rows, 1), ROWS_WRITTEN):
        part = slice(start, start + ROWS_WRITTEN)
        yield pa.table([arrow_of(values[part]) for _, values in columns], names=names)


@contextmanager
def _csv_writer(file: BinaryIO, schema: Any) -> Iterator[Callable[[Any], None]]:
    import pyarrow as pa
    from pyarrow import csv

    # The header is written directly because Arrow would quote the names.
    file.write((",".join(schema.names) + "\n").encode())
    options = csv.WriteOptions(include_header=False, quoting_style="none")

    def write(table: Any) -> None:
        for part in table.to_batches(max_chunksize=ROWS_OF_TEXT):
            shown = [_with_points(name, column) for name, column in zip(schema.names, part, strict=True)]
            csv.write_csv(pa.table(shown, names=schema.names), file, options)

    yield write


def _with_points(name: str, column: Any) -> Any:
    """The column as text with 0.0 instead of 0, so that other programs do not infer an integer column."""
    import pyarrow as pa
    from pyarrow import compute

    # float32 values are converted to float64 before formatting. The shortest text of a float32 would be a
    # different number when read as float64.
    column = compute.cast(column, pa.float64())
    whole = compute.equal(column, compute.round(column))
    # No ".0" is needed in columns of raw counts, or if every value of the column has a fractional part.
    if name.endswith("_lsb") or not compute.any(whole).as_py():
        return column
    text = compute.cast(column, pa.string())
    # ".0" is appended to integers only, and not to numbers with an exponent or to infinities.
    pointed = compute.replace_substring_regex(compute.filter(text, whole), "^(-?[0-9]+)$", r"\1.0")
    return compute.replace_with_mask(text, whole, pointed)


@contextmanager
def _parquet_writer(file: BinaryIO, schema: Any) -> Iterator[Callable[[Any], None]]:
    from pyarrow import parquet

    with parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        yield writer.write_table


def chosen(table: Table, columns: str | Sequence[str] | None, *, has_rate: bool) -> Table:
    """The table with the columns that `columns` names, and with other columns whose names are canonical.

    Without `columns`, names that state sensor, axis and unit in other words are also recognised. `has_rate`
    states whether the caller gives the sampling rate, so that no time column is needed.
    """
    if columns is None:
        return by_header(table, has_rate=has_rate)
    mapping = mapping_of(columns)
    if mapping is None:
        raise InputError(f"{table.file} has named columns: give canonical=name pairs, not a list of names")
    for theirs in mapping.values():
        if theirs not in table.names:
            raise InputError(f"{table.file}: there is no column {theirs!r}; found: {', '.join(table.names)}")
    require_agreement_of_names(table.file, [(theirs, ours) for ours, theirs in mapping.items()])
    named = {_meaning(ours) for ours in mapping}
    for name in table.names:
        if is_canonical(name) and _meaning(name) not in named and name not in mapping.values():
            mapping[name] = name
    values = [table.column(theirs) for theirs in mapping.values()]
    return Table(table.file, list(mapping), values, table.place)


def _meaning(name: str) -> str:
    """The canonical name without its unit, such as accel_x for accel_x_mps2."""
    return name.rpartition("_")[0]


def parquet_table(path: str | os.PathLike[str]) -> Table:
    """The columns of a Parquet file, whose values are read from the file on demand."""
    import pyarrow as pa
    from pyarrow import parquet

    name, size = Path(path).name, Path(path).stat().st_size
    if first_bytes(path, len(PARQUET_MAGIC)) != PARQUET_MAGIC:
        raise FormatError(f"{name} is not a Parquet file (it does not start with PAR1): check its format")

    @contextmanager
    def opened() -> Iterator[Any]:
        # Python opens the file, because Arrow only accepts file names in UTF-8. `pre_buffer` and
        # `buffer_size` are set so that Arrow does not prefetch the compressed bytes of many row groups into
        # memory.
        try:
            with Path(path).open("rb") as file:
                yield parquet.ParquetFile(file, pre_buffer=False, buffer_size=BUFFER)
        except (pa.ArrowException, OSError, ValueError) as error:
            if isinstance(error, ImucalError):
                raise
            reason = str(error).splitlines()[0]
            raise FormatError(
                f"{name} is a damaged or truncated Parquet file: {reason}: write it again"
            ) from None

    def batches(names: list[str]) -> Iterator[Any]:
        with opened() as file:
            with Path(path).open("rb") as pages:
                require_plausible_pages(pages, file.metadata, size, names)
            yield from file.iter_batches(ROWS_AT_ONCE, columns=names)

    with opened() as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        require_plausible_rows(file.metadata, size)
    columns = [Stored(field.name, field.type, rows, batches) for field in schema]
    return Table(name, schema.names, columns, lambda row: f"row {row + 1}")
