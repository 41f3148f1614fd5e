"""Conversion of array arguments to C-contiguous arrays with one sample per row.

Values become float64, except sensor samples in float32 or int16, which keep their type.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucal.errors import InputError

__all__ = ["FloatArray", "SampleArray", "as_matrix", "as_rows", "as_samples"]

FloatArray: TypeAlias = NDArray[np.float64]
# Arrays of sensor samples. Samples in float32 or int16 are not converted to float64, because the copy of a
# long recording would need more memory.
SampleArray: TypeAlias = NDArray[np.float64] | NDArray[np.float32] | NDArray[np.int16]
SMALLER: Final = (np.dtype(np.float32), np.dtype(np.int16))


def as_rows(values: ArrayLike, what: str, width: int | None = None, rows: int | None = None) -> FloatArray:
    """`values` as a read-only array of shape (rows,), or (rows, width) if a width is given.

    A C-contiguous float64 array is not copied. Any other input is converted once. Masked values become NaN.

    what   name of the argument for messages
    rows   required number of rows; None accepts any number

    Raises InputError if the shape is wrong or the values are not real numbers.
    """
    return _as_array(values, what, width, rows, ())


def as_samples(values: ArrayLike, what: str, rows: int) -> SampleArray:
    """`values` as a read-only array of shape (rows, 3), in float64, float32 or int16; see `as_rows`."""
    return _as_array(values, what, 3, rows, SMALLER)


def _as_array(
    values: ArrayLike, what: str, width: int | None, rows: int | None, kept: tuple[np.dtype[Any], ...]
) -> NDArray[Any]:
    """`values` as float64, or unchanged if their type is in `kept`."""
    shape = "(N,)" if width is None else f"(N, {width})"
    try:
        # asanyarray keeps the mask of a masked array, which marks values that are not measurements.
        array = np.asanyarray(values)
        numeric = array.dtype.kind in "fiub" or array.size == 0
        # The type is compared before np.ma is accessed. The first access loads the module numpy.ma, which
        # takes as long as reading a small file.
        masked = type(array) is not np.ndarray and isinstance(array, np.ma.MaskedArray)
        # A masked array of integers is converted to float64, because integers have no NaN for masked values.
        if numeric and (array.dtype not in kept or masked):
            array = array.astype(np.float64, order="C", copy=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{what} cannot be made an array: {error}: give real numbers, shape {shape}"
        ) from None
    if not numeric:
        raise InputError(f"{what} has the type {array.dtype}: give real numbers, shape {shape}")
    if masked:
        array = np.ma.filled(array, np.nan)
    if width is not None and array.shape == (0,):
        array = array.reshape(0, width)
    if array.ndim != (1 if width is None else 2) or (width is not None and array.shape[1] != width):
        hint = ": rows are samples, give its transpose" if array.ndim == 2 and array.shape[0] == width else ""
        raise InputError(f"{what} has the shape {array.shape}, {shape} is needed{hint}")
    if rows is not None and len(array) != rows:
        raise InputError(
            f"{what} has {len(array)} rows but {rows} are needed: all columns need one row per sample"
        )
    # The read-only flag is set on a view, so that the caller's array stays writable.
    view = np.ascontiguousarray(array).view(np.ndarray).view()
    view.flags.writeable = False
    return view


def as_matrix(values: ArrayLike, what: str, shape: tuple[int, ...]) -> FloatArray:
    """`values` as a read-only float64 array.

    Raises InputError if the values do not have the shape `shape` or are not finite.
    """
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise InputError(f"{what} cannot be made an array: give real numbers, shape {shape}") from None
    if array.shape != shape:
        raise InputError(f"{what} has the shape {array.shape}, {shape} is needed")
    if not np.isfinite(array).all():
        raise InputError(
            f"{what} contains the value {array[~np.isfinite(array)][0]}: finite numbers are needed"
        )
    array.flags.writeable = False
    return array
