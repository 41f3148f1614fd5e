"""Conversion of Arrow arrays to NumPy arrays without pandas.

The buffers are read directly, because Arrow's `to_numpy` imports pandas if it is installed, which takes
longer than reading a short file.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["arrow_of", "numpy_of", "present_of", "ticks_of", "truth_of"]

# NumPy types by name of the Arrow type. Time stamps are represented by integer ticks.
_TYPES: Final[dict[str, np.dtype[Any]]] = {
    **{f"{kind}{bits}": np.dtype(f"{kind}{bits}") for kind in ("int", "uint") for bits in (8, 16, 32, 64)},
    **{"halffloat": np.dtype("f2"), "float": np.dtype("f4"), "double": np.dtype("f8")},
}


def numpy_of(array: Any) -> NDArray[Any]:
    """The numbers of an Arrow array or chunked array. Integers with empty cells become float64 with NaN.

    Numbers without empty cells are views of Arrow's memory, read-only. Time stamps become integers. A NumPy
    array is returned unchanged.
    """
    if isinstance(array, np.ndarray):
        return array
    import pyarrow as pa

    if isinstance(array, pa.ChunkedArray):
        parts = [numpy_of(chunk) for chunk in array.chunks]
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.empty(0)])
    if pa.types.is_timestamp(array.type):
        array = array.view(pa.int64())
    if pa.types.is_null(array.type):
        return np.full(len(array), np.nan)
    dtype = _TYPES[str(array.type)]
    buffer = array.buffers()[1]
    if buffer is None or not len(array):
        return np.empty(len(array), dtype)
    values: NDArray[Any] = np.frombuffer(buffer, dtype, len(array), array.offset * dtype.itemsize)
    if not array.null_count:
        return values
    filled: NDArray[Any] = values.astype(dtype if dtype.kind == "f" else np.float64)
    filled[~present_of(array)] = np.nan
    return filled


def ticks_of(array: Any) -> NDArray[Any]:
    """The integers that an Arrow array stores, such as ticks of time stamps; undefined for empty cells."""
    if isinstance(array, np.ndarray):
        return array
    dtype = _TYPES[str(array.type)]
    if not len(array):
        return np.empty(0, dtype)
    return np.frombuffer(array.buffers()[1], dtype, len(array), array.offset * dtype.itemsize)


def present_of(array: Any) -> NDArray[np.bool_]:
    """Boolean mask of an Arrow array: True for each cell that is not empty."""
    # The mask is computed from the validity bits of the array, because Arrow's method `is_valid` loads
    # Arrow's function library.
    if isinstance(array, np.ndarray) or not array.null_count:
        return np.ones(len(array), bool)
    return _bits(array.buffers()[0], array)


def arrow_of(values: NDArray[Any]) -> Any:
    """Convert numbers to an Arrow array, without a copy if they are contiguous; NaN stays NaN."""
    import pyarrow as pa

    whole = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    kind = pa.from_numpy_dtype(whole.dtype)
    return pa.Array.from_buffers(kind, len(whole), [None, pa.py_buffer(whole)])


def truth_of(array: Any) -> NDArray[np.bool_]:
    """The values of an Arrow array of booleans; empty cells are False."""
    import pyarrow as pa

    if isinstance(array, pa.ChunkedArray):
        return np.concatenate([truth_of(chunk) for chunk in array.chunks] or [np.empty(0, bool)])
    if array.null_count:
        array = array.fill_null(False)
    buffer = array.buffers()[1]
    if buffer is None or not len(array):
        return np.zeros(len(array), bool)
    return _bits(buffer, array)


def _bits(buffer: Any, array: Any) -> NDArray[np.bool_]:
    """One bit per cell of an array, from a buffer with the bits of all cells of the column.

    The array may be a slice of the column.
    """
    first, end = array.offset // 8, (array.offset + len(array) + 7) // 8
    bits = np.unpackbits(np.frombuffer(buffer, np.uint8)[first:end], bitorder="little")
    return bits[array.offset - 8 * first :][: len(array)].astype(bool)
