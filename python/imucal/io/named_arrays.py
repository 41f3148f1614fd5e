"""Named arrays of MATLAB, HDF5 and NumPy files, and their conversion to a Recording.

An array is found by its canonical name: a column (`time_s`, `accel_x_mps2`, `temp_degc`) or a whole triad of
shape (N, 3) (`accel_mps2`, `gyro_radps`, `stand_rad`). If the file has other names, the option `columns`
assigns them:

    time_s=t,accel_mps2=imu/acc,gyro_dps=imu/gyr     canonical=name, for arrays with other names
    time_s,accel_x_mps2,...,gyro_z_radps             a name for every column of one array of shape (N, k)
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.document.source import Source
from imucal.errors import FormatError, InputError
from imucal.io.mapping import column_list, mapping_of
from imucal.io.names import AXES, NAMES, SKIP, is_canonical
from imucal.io.table import Table
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording
from imucal.units import COLUMN_UNITS

__all__ = ["Array", "NamedArrays", "StoredArray", "recording_from_arrays", "spread"]

# An array with any element type, including structured types.
Array: TypeAlias = NDArray[Any]

# Largest number of arrays listed in an error message.
MOST_SHOWN = 30


@dataclass(frozen=True)
class StoredArray:
    """An array in a file. `load` reads its values."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], Array]

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @classmethod
    def of(cls, array: Array) -> StoredArray:
        """A `StoredArray` for an array that is in memory."""
        return cls(array.shape, array.dtype, lambda: array)


@dataclass(frozen=True)
class NamedArrays:
    """The arrays of a file by path. `separator` separates the groups in a path."""

    file: str
    by_path: dict[str, StoredArray]
    separator: str

    def listed(self) -> str:
        """The paths with the shapes of their arrays, for error messages."""
        shown = [f"{path} {array.shape}" for path, array in self.by_path.items()]
        more = f" and {len(shown) - MOST_SHOWN} more" if len(shown) > MOST_SHOWN else ""
        return (", ".join(shown[:MOST_SHOWN]) + more) if shown else "no arrays of numbers"

    def groups(self) -> dict[str, dict[str, StoredArray]]:
        """The arrays by group and name; the top level is ''."""
        groups: dict[str, dict[str, StoredArray]] = {}
        for path, array in self.by_path.items():
            group, _, name = path.rpartition(self.separator)
            groups.setdefault(group, {})[name] = array
        return groups


def spread(path: str, array: StoredArray, separator: str) -> dict[str, StoredArray]:
    """A dictionary with the array under its path, or with one entry per field of a structured array."""
    fields = array.dtype.names
    if fields is None:
        return {path: array}
    prefix = f"{path}{separator}" if path else ""

    def field(name: str) -> StoredArray:
        inner = array.dtype[name]
        return StoredArray((*array.shape, *inner.shape), inner.base, lambda: array.load()[name])

    return {f"{prefix}{name}": field(name) for name in fields}


def recording_from_arrays(
    arrays: NamedArrays,
    sources: Sequence[Source],
    *,
    columns: str | Sequence[str] | None = None,
    group: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """The recording that these arrays form.

    columns  names of the arrays, see the start of this module; None uses the arrays with canonical names
    group    group that contains the arrays. It is required if several groups contain a recording. Paths in
             `columns` are relative to this group
    rate_hz  sampling rate, Hz, if there is no time array

    Raises FormatError if arrays are missing, not numeric or of unequal length, and InputError for names that
    do not exist. Both messages list the arrays of the file.
    """
    if group is not None:
        arrays = _within(arrays, group)
    mapping = None if columns is None else mapping_of(columns)
    if mapping is not None:
        chosen = _mapped(arrays, mapping)
    elif columns is not None:
        chosen = _split(arrays, column_list(columns))
    else:
        chosen = _canonical(arrays)
    all_columns = [column for name, array in chosen for column in _columns(arrays.file, name, array)]
    return recording_from_table(_table(arrays.file, all_columns), sources, rate_hz)


def _within(arrays: NamedArrays, group: str) -> NamedArrays:
    prefix = group.strip(arrays.separator) + arrays.separator
    inside = {p.removeprefix(prefix): a for p, a in arrays.by_path.items() if p.startswith(prefix)}
    if not inside and group.strip(arrays.separator) in arrays.by_path:
        path = group.strip(arrays.separator)
        inside = {path: arrays.by_path[path]}
    if not inside:
        known = ", ".join(name or "(top)" for name in arrays.groups())
        raise InputError(f"{arrays.file}: there is no group {group!r}: give one of {known}")
    return NamedArrays(arrays.file, inside, arrays.separator)


def _mapped(arrays: NamedArrays, mapping: dict[str, str]) -> list[tuple[str, Array]]:
    chosen = []
    for ours, theirs in mapping.items():
        path = theirs.strip(arrays.separator)
        if path not in arrays.by_path:
            raise InputError(f"{arrays.file}: there is no array {theirs!r}; found: {arrays.listed()}")
        chosen.append((ours, arrays.by_path[path].load()))
    return chosen


def _split(arrays: NamedArrays, names: list[str]) -> list[tuple[str, Array]]:
    """The named columns of the only array that has as many columns as there are names."""
    fitting = [
        path for path, array in arrays.by_path.items() if len(array.shape) == 2 and len(names) in array.shape
    ]
    if len(fitting) != 1:
        what = "no array has" if not fitting else f"{len(fitting)} arrays ({', '.join(fitting)}) have"
        raise InputError(
            f"{arrays.file}: {len(names)} columns are named, but {what} as many columns; found: "
            f"{arrays.listed()}. Name every column ('-' for a column to ignore), or give the array "
            "(group=..., --group)"
        )
    array = arrays.by_path[fitting[0]].load()
    rows = array if array.shape[1] == len(names) else array.T
    return [(name, rows[:, i]) for i, name in enumerate(names) if name not in SKIP]


def _canonical(arrays: NamedArrays) -> list[tuple[str, Array]]:
    groups = {
        group: members
        for group, members in arrays.groups().items()
        if all(any(_triad_of(name) == triad for name in members) for triad in ("accel", "gyro"))
    }
    if not groups:
        raise FormatError(
            f"{arrays.file}: no arrays with names like accel_mps2 and gyro_radps (or accel_x_mps2, ...); "
            f"found: {arrays.listed()}. Give their names (--columns time_s=NAME,accel_mps2=NAME,"
            f"gyro_radps=NAME): {NAMES}"
        )
    if len(groups) > 1:
        listed = ", ".join(name or "(top)" for name in groups)
        raise InputError(
            f"{arrays.file}: {len(groups)} groups contain a recording: {listed}: choose one (group=..., "
            "--group)"
        )
    members = next(iter(groups.values()))
    known = {name: array for name, array in members.items() if is_canonical(name) or _triad_of(name)}
    lengths = {max(array.shape, default=0) for array in known.values()}
    # All other arrays with one number per sample become auxiliary inputs.
    along = [
        (name, array)
        for name, array in members.items()
        if name not in known and array.size in lengths and array.size == max(array.shape, default=0)
    ]
    return [(name, array.load()) for name, array in (*known.items(), *along)]


def _triad_of(name: str) -> str | None:
    """The triad of a column name, for example accel for accel_x_mps2 and accel_mps2; None for other names."""
    triad, _, unit = re.sub(r"_[xyz123]_", "_", name, count=1).partition("_")
    return triad if unit in COLUMN_UNITS.get(triad, {}) else None


def _columns(file: str, name: str, array: Array) -> list[tuple[str, Array]]:
    """An array as named columns: three columns for a triad, otherwise one column."""
    if array.dtype.kind not in "fiub":
        raise FormatError(
            f"{file}: the array {name} has elements of type {array.dtype}, not real numbers: choose another"
        )
    triad, _, unit = name.partition("_")
    if unit in COLUMN_UNITS.get(triad, {}):
        rows = array if array.ndim == 2 and array.shape[1] == 3 else array.T
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise FormatError(
                f"{file}: {name} has the shape {array.shape}, (N, 3) is needed: one row per sample"
            )
        return [(f"{triad}_{axis}_{unit}", rows[:, i]) for i, axis in enumerate(AXES[triad])]
    flat = array.reshape(-1)
    if flat.size != max(array.shape, default=0):
        raise FormatError(
            f"{file}: {name} has the shape {array.shape}, (N,) is needed: one number per sample"
        )
    return [(name, flat)]


def _table(file: str, columns: list[tuple[str, Array]]) -> Table:
    import pyarrow as pa

    shortest = min(columns, key=lambda column: len(column[1]))
    longest = max(columns, key=lambda column: len(column[1]))
    if len(shortest[1]) != len(longest[1]):
        raise FormatError(
            f"{file}: {shortest[0]} has {len(shortest[1])} samples but {longest[0]} has {len(longest[1])}: "
            "all columns need one row per sample; resample them to common time stamps"
        )
    # Arrow only accepts numbers in native byte order, of at most 64 bits.
    native = [column.astype(_native(column.dtype), copy=False) for _, column in columns]
    values = [pa.chunked_array([pa.array(column)]) for column in native]
    return Table(file, [name for name, _ in columns], values, lambda row: f"row {row + 1}")


def _native(kind: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype(np.float64) if kind.itemsize > np.dtype(np.float64).itemsize else kind.newbyteorder("=")
