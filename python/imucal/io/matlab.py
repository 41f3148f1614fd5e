"""Reader of MATLAB .mat files of all versions: variables and fields of structs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from imucal.document.source import first_bytes, open_large, parsing
from imucal.errors import FormatError
from imucal.io.extra import library
from imucal.io.hdf5 import hdf5_arrays
from imucal.io.named_arrays import Array, NamedArrays, StoredArray, recording_from_arrays
from imucal.io.starts import MATLAB_MAGIC
from imucal.recording.recording import Recording

__all__ = ["read_matlab"]

# MATLAB classes of variables that contain numbers.
NUMERIC: Final = (
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
)
SAVE_PLAIN = "save the arrays as plain variables (tables and objects cannot be read), with -v7"

OBJECTS: Final = (
    "contains only tables, timetables or other objects, which only MATLAB reads: write a timetable with "
    "writetimetable(tt, 'run.csv'), a table with writetable(t, 'run.csv'), and give the CSV file"
)


def read_matlab(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    group: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Read the variables of a .mat file. A struct is a group: `imu.acc` is the field acc of the struct imu.

    See `named_arrays` for names, groups and columns.
    """
    source, name = open_large(path), Path(path).name
    if first_bytes(path, 19) == MATLAB_MAGIC[1]:
        h5py = library("h5py", "matlab", "MATLAB files of version 7.3")
        with hdf5_arrays(h5py, path, ".", "MATLAB") as stored:
            # The group `#refs#` contains the contents of cell arrays, which are not read.
            by_path = {p: _transposed(array) for p, array in stored.items() if not p.startswith("#")}
            if any(p.startswith("#subsystem#") for p in stored) and not _has_samples(by_path):
                raise FormatError(f"{name} {OBJECTS}")
            arrays = NamedArrays(name, by_path, ".")
            return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)
    scipy_io = library("scipy.io", "matlab", "MATLAB files")
    with parsing(name, "MATLAB", SAVE_PLAIN):
        names, has_objects = _variables(scipy_io, os.fspath(path))
        variables = scipy_io.loadmat(os.fspath(path), simplify_cells=True, variable_names=names)
    flat = _flat("", {k: v for k, v in variables.items() if not k.startswith("__")})
    if has_objects and not flat:
        raise FormatError(f"{name} {OBJECTS}")
    arrays = NamedArrays(name, {p: StoredArray.of(array) for p, array in flat}, ".")
    return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)


def _variables(scipy_io: Any, path: str) -> tuple[list[str] | None, bool]:
    """The names of variables with numbers (None for all), and whether the file contains objects."""
    try:
        listed = scipy_io.whosmat(path)
    except TypeError:
        # SciPy cannot list a file with objects, but it can load it.
        return None, True
    # Variables of other classes, such as cell arrays of a large log, are not loaded.
    names = [variable for variable, _, kind in listed if kind in NUMERIC or kind == "struct"]
    return names, any(kind in ("opaque", "object", "unknown") for _, _, kind in listed)


def _has_samples(by_path: Mapping[str, StoredArray]) -> bool:
    """Whether a file has an array of floating-point numbers. MATLAB objects are stored as integers only."""
    return any(array.dtype.kind == "f" for array in by_path.values())


def _transposed(array: StoredArray) -> StoredArray:
    """Transpose an array, because MATLAB's columns are rows in HDF5."""
    return StoredArray(array.shape[::-1], array.dtype, lambda: array.load().T)


def _flat(prefix: str, members: Mapping[str, Any]) -> list[tuple[str, Array]]:
    found = []
    for name, value in members.items():
        if isinstance(value, Mapping):
            found += _flat(f"{prefix}{name}.", value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            found.append((f"{prefix}{name}", value))
    return found
