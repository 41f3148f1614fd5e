"""Arrays with names, as MATLAB, HDF5 and NumPy files hold them, on their way to a Recording.

An array is found by its canonical name: a column (`time_s`, `accel_x_mps2`, `temp_degc`) or a whole triad of
shape (N, 3) (`accel_mps2`, `gyro_radps`, `stand_rad`). Other names are given with `columns`:

    time_s=t,accel_mps2=imu/acc,gyro_dps=imu/gyr     ours=theirs, for arrays of other names
    time_s,accel_x_mps2,...,gyro_z_radps             a name for every column of one array of shape (N, k)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from numpy.typing import NDArray

from imucal.errors import FormatError, InputError
from imucal.io.columns import column_list, mapping_of
from imucal.io.source import Table
from imucal.io.vocabulary import AXES, NAMES, SKIP, TO_SI, is_canonical, recording_from_table
from imucal.recording.recording import Recording, Source

__all__ = ["Array", "NamedArrays", "recording_from_arrays", "spread"]

# Of any type of elements, structured ones among them.
Array: TypeAlias = NDArray[Any]

MOST_SHOWN = 30


@dataclass(frozen=True)
class NamedArrays:
    """What a file holds: path -> array; `separator` stands between the groups of a path."""

    file: str
    by_path: dict[str, Array]
    separator: str

    def listed(self) -> str:
        """The paths with their shapes, for messages."""
        shown = [f"{path} {array.shape}" for path, array in self.by_path.items()]
        more = f" and {len(shown) - MOST_SHOWN} more" if len(shown) > MOST_SHOWN else ""
        return (", ".join(shown[:MOST_SHOWN]) + more) if shown else "no arrays of numbers"

    def groups(self) -> dict[str, dict[str, Array]]:
        """Group -> name -> array; the top is ''."""
        groups: dict[str, dict[str, Array]] = {}
        for path, array in self.by_path.items():
            group, _, name = path.rpartition(self.separator)
            groups.setdefault(group, {})[name] = array
        return groups


def spread(path: str, array: Array, separator: str) -> dict[str, Array]:
    """An array under its path; a structured one as an array for each of its fields."""
    if array.dtype.names is None:
        return {path: array}
    prefix = f"{path}{separator}" if path else ""
    return {f"{prefix}{name}": array[name] for name in array.dtype.names}


def recording_from_arrays(
    arrays: NamedArrays,
    sources: Sequence[Source],
    *,
    columns: str | Sequence[str] | None = None,
    group: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """The Recording that these arrays make.

    columns  names, see above; None takes the arrays with canonical names
    group    where the arrays are, if several groups hold a recording; paths in `columns` then start there

    Raises FormatError if arrays are missing, not numbers or of unequal length, InputError if names do not
    fit; both list what there is.
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
        chosen.append((ours, arrays.by_path[path]))
    return chosen


def _split(arrays: NamedArrays, names: list[str]) -> list[tuple[str, Array]]:
    """The columns of the one array that has as many."""
    fitting = [
        path for path, array in arrays.by_path.items() if array.ndim == 2 and len(names) in array.shape
    ]
    if len(fitting) != 1:
        what = "no array has" if not fitting else f"{len(fitting)} arrays ({', '.join(fitting)}) have"
        raise InputError(
            f"{arrays.file}: {len(names)} columns are named, {what} as many; found: {arrays.listed()}. Name "
            "every column ('-' for one to leave out), or the array (group=..., --group)"
        )
    array = arrays.by_path[fitting[0]]
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
            f"found: {arrays.listed()}. Name them (--columns time_s=NAME,accel_mps2=NAME,gyro_radps=NAME): "
            f"{NAMES}"
        )
    if len(groups) > 1:
        listed = ", ".join(name or "(top)" for name in groups)
        raise InputError(
            f"{arrays.file}: {len(groups)} groups hold a recording: {listed}: choose one (group=..., --group)"
        )
    members = next(iter(groups.values()))
    known = {name: array for name, array in members.items() if is_canonical(name) or _triad_of(name)}
    lengths = {max(array.shape, default=0) for array in known.values()}
    # What was recorded along has a number for every sample; anything else is no column.
    along = [
        (name, array)
        for name, array in members.items()
        if name not in known and array.size in lengths and array.size == max(array.shape, default=0)
    ]
    return [*known.items(), *along]


def _triad_of(name: str) -> str | None:
    """The triad, accel for accel_x_mps2 and accel_mps2; None if the name is of no triad."""
    triad, _, unit = re.sub(r"_[xyz123]_", "_", name, count=1).partition("_")
    return triad if unit in TO_SI.get(triad, {}) else None


def _columns(file: str, name: str, array: Array) -> list[tuple[str, Array]]:
    """An array as columns: a triad as three, anything else as one."""
    if array.dtype.kind not in "fiub":
        raise FormatError(
            f"{file}: the array {name} holds {array.dtype}, real numbers are needed: choose another"
        )
    triad, _, unit = name.partition("_")
    if unit in TO_SI.get(triad, {}):
        rows = array if array.ndim == 2 and array.shape[1] == 3 else array.T
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise FormatError(
                f"{file}: {name} has the shape {array.shape}, (N, 3) is needed: rows are samples"
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
            "all columns need one row per sample; save them at common time stamps"
        )
    # Arrow takes numbers in the machine's own byte order alone.
    native = [column.astype(column.dtype.newbyteorder("=")) for _, column in columns]
    values = [pa.chunked_array([pa.array(column)]) for column in native]
    return Table(file, [name for name, _ in columns], values, lambda row: f"row {row + 1}")
