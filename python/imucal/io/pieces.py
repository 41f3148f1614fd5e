"""Reading of recordings in pieces, so that memory does not grow with the size of the file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucal.document.source import Source, open_large
from imucal.errors import FormatError, InputError
from imucal.io.canonical import chosen, parquet_table, read_csv, read_parquet
from imucal.io.copies import has_equal_stamps
from imucal.io.headed import names_given
from imucal.io.interleaved import refuse_interleaved
from imucal.io.layout import Layout
from imucal.io.names import is_canonical
from imucal.io.requested_columns import Clock
from imucal.io.separate_rows import has_separate_rows
from imucal.io.table import Table, parts
from imucal.io.text import NotInPartsError, headed_parts, open_path
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["Whole", "csv_pieces", "parquet_pieces"]


def csv_pieces(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
) -> Iterator[Recording]:
    """Read a CSV file in pieces; arguments as for `read_csv`.

    Raises NotInPartsError at a later piece if the column types, the clock of the samples, or the cause of an
    error can only be determined from the whole file.
    """
    return _or_whole(
        _csv_pieces(path, columns, rate_hz), lambda: read_csv(path, columns=columns, rate_hz=rate_hz)
    )


def parquet_pieces(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
) -> Iterator[Recording]:
    """Read a Parquet file in pieces; arguments as for `read_parquet`, errors as for `csv_pieces`."""
    return _or_whole(
        _parquet_pieces(path, columns, rate_hz),
        lambda: read_parquet(path, columns=columns, rate_hz=rate_hz),
    )


def _or_whole(pieces: Iterator[Recording], whole: Callable[[], Recording]) -> Iterator[Recording]:
    """The pieces; the whole recording if there are none, or if the first cannot be read alone."""
    is_given = False
    try:
        for piece in pieces:
            is_given = True
            yield piece
    except NotInPartsError:
        if is_given:
            raise
    if not is_given:
        yield whole()


def _csv_pieces(
    path: str | os.PathLike[str], columns: str | Sequence[str] | None, rate_hz: float | None
) -> Iterator[Recording]:
    source, clock = open_large(path), Clock()
    for table in headed_parts(path, lambda layout: _names(path, layout, columns)):
        yield _piece(table, source, rate_hz, clock)


def _parquet_pieces(
    path: str | os.PathLike[str], columns: str | Sequence[str] | None, rate_hz: float | None
) -> Iterator[Recording]:
    source, clock = open_large(path), Clock()
    whole = chosen(parquet_table(path), columns, has_rate=rate_hz is not None)
    for part in parts(whole.columns):
        piece = recording_from_table(replace(whole, columns=part), [source], rate_hz, clock)
        if rate_hz is None:
            _refuse_in_parts(piece)
        yield piece


def _names(path: str | os.PathLike[str], layout: Layout, columns: str | Sequence[str] | None) -> list[str]:
    """The names of the columns. Raises NotInPartsError if the whole text is needed to determine them."""
    name = Path(path).name
    if columns is None and not any(map(is_canonical, layout.names or [])):
        raise NotInPartsError(name)
    try:
        names = names_given(name, layout, columns)
    except InputError:
        raise NotInPartsError(name) from None
    refuse_interleaved(open_path(path), names)
    return names


def _piece(table: Table, source: Source, rate_hz: float | None, clock: Clock) -> Recording:
    try:
        piece = recording_from_table(table, [source], rate_hz, clock)
    except FormatError:
        # The file is read again as a whole, because the error message of the reader of whole files contains
        # the line number.
        raise NotInPartsError(table.file) from None
    if rate_hz is None:
        _refuse_in_parts(piece)
    return piece


def _refuse_in_parts(piece: Recording) -> None:
    """Raises NotInPartsError if the reader of whole files may remove or resample rows of the recording.

    Rows that were written twice can be counted only in the whole recording. Whether sensors in separate rows
    are resampled to one clock depends on all rows.
    """
    if has_equal_stamps(piece.time_s):
        raise NotInPartsError(piece.name, "time stamps repeat or decrease")
    if has_separate_rows(piece):
        raise NotInPartsError(piece.name, "rows lack the samples of one sensor")


class Whole:
    """Iterator over the pieces of a recording that also counts its samples and determines its duration.

    samples  number of samples
    lacking  number of samples of which a component of the force or the rate is not a finite number
    """

    def __init__(self, pieces: Iterable[Recording]) -> None:
        self._pieces = pieces
        self._first: Recording | None = None
        self._last_s = 0.0
        self.samples = 0
        self.lacking = 0

    def __iter__(self) -> Iterator[Recording]:
        for piece in self._pieces:
            self._first = self._first or piece
            self.samples += len(piece)
            there = [own for own in (piece.specific_force, piece.angular_rate) if own is not None]
            is_complete = np.logical_and.reduce([np.isfinite(samples).all(axis=1) for samples in there])
            self.lacking += len(piece) - int(np.count_nonzero(is_complete))
            if len(piece):
                self._last_s = float(piece.time_s[-1])
            yield piece

    @property
    def first(self) -> Recording:
        """The first piece of the recording. Raises ValueError if no piece has been read yet."""
        if self._first is None:
            raise ValueError("no piece has been read yet")
        return self._first

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s; 0 with fewer than two samples."""
        return self._last_s - float(self.first.time_s[0]) if self.samples > 1 else 0.0

    def __repr__(self) -> str:
        return self.first.said(self.samples, self.duration_s)
