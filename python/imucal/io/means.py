"""Reads tables of mean readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from imucal.errors import InputError
from imucal.io import read
from imucal.recording.means import Means

__all__ = ["read_means"]

# Arbitrary sampling rate, Hz. A table of mean readings has no time column, but the reader of recordings needs
# a time column or a sampling rate. The times that result from this rate are not used.
ANY_RATE_HZ: Final = 1.0


def read_means(
    path: Any, *, columns: str | Sequence[str] | None = None, axes: str | None = None, **options: Any
) -> Means:
    """Read a table of mean readings: one row for each pose in which the unit rested, without a time column.

    path, columns, axes   as for `imucal.read`; all other options of `imucal.read` are also accepted. The
                          columns of the table are accel_x_mps2, ..., and, optionally, gyro_x_radps, ...,
                          accel_x_std_mps2, ... (standard deviation of each mean) and duration_s (time over
                          which a mean was taken)

    Raises the errors of `imucal.read`.
    """
    if options.get("rate_hz") is not None:
        raise InputError("a table of means has no sampling rate: leave rate_hz out")
    given = {name: value for name, value in options.items() if name != "rate_hz"}
    return Means.of_rows(read(path, columns=columns, axes=axes, rate_hz=ANY_RATE_HZ, **given))
