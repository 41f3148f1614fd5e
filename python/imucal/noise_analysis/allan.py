"""Overlapping Allan deviations of equally spaced samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.document.whole import check_threads
from imucal.errors import InputError

__all__ = ["allan_deviation"]


def allan_deviation(
    values: ArrayLike,
    rate_hz: float,
    taus_s: Literal["octave", "decade"] | Sequence[float] | FloatArray = "octave",
    *,
    threads: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Returns averaging times, (K,), s, and overlapping Allan deviations of `values`, (K,) or (K, C).

    values   (N,), or (N, C) with one series in each column, in any unit, which is also the unit of the
             deviations; a float64 array is not copied, even if it is not contiguous
    taus_s   "octave" (1, 2, 4, ... samples), "decade" (1, 2, 4, 10, ...), or averaging times in s, of which
             each is rounded to whole samples
    threads  number of threads; None uses all processors. The result does not depend on it.

    The definition is docs/model.md (29). Raises InputError for values that are not numbers, and for an
    averaging time of less than one sample or of more than half of the samples.
    """
    check_threads(threads)
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"rate_hz is {rate_hz}: give the sample rate in Hz")
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"values cannot be made an array: {error}: give numbers, (N,) or (N, C)") from None
    if array.ndim not in (1, 2) or (array.ndim == 2 and array.shape[1] == 0):
        raise InputError(f"values have the shape {array.shape}: give (N,) or (N, C)")
    if isinstance(taus_s, str):
        factors = _core.allan_factors(len(array), taus_s)
    else:
        wanted = np.asarray(taus_s, dtype=np.float64)
        if wanted.ndim != 1 or not np.all(np.isfinite(wanted)) or np.any(wanted < 0):
            raise InputError("taus_s needs finite averaging times in s, or octave or decade")
        # The numbers of samples per average are clipped before the conversion to int64, because a very long
        # averaging time would overflow. Averaging times that are too long are refused below.
        most = float(len(array) + 1)
        factors = np.unique(np.minimum(np.round(wanted * rate_hz), most)).astype(np.int64).tolist()
    columns = _core.allan_deviations(array, factors, threads)
    deviations = columns[0] if array.ndim == 1 else np.column_stack(columns)
    return np.array(factors, dtype=np.float64) / rate_hz, deviations
