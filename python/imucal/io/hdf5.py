"""HDF5 files, including MATLAB files from version 7.3 on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imucal.document.source import open_large, parsing
from imucal.io.extra import library
from imucal.io.named_arrays import Array, NamedArrays, recording_from_arrays, spread
from imucal.recording.recording import Recording

__all__ = ["hdf5_arrays", "read_hdf5"]


def read_hdf5(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    group: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Read the data sets of an HDF5 file; see `named_arrays` for names, groups and columns."""
    source = open_large(path)
    h5py = library("h5py", "hdf5", "HDF5 files")
    by_path = hdf5_arrays(h5py, path, "/", "HDF5")
    arrays = NamedArrays(Path(path).name, by_path, "/")
    return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)


def hdf5_arrays(h5py: Any, path: str | os.PathLike[str], separator: str, kind: str) -> dict[str, Array]:
    """All one- and two-dimensional numeric data sets by path; compound ones as one array per field."""
    found: dict[str, Array] = {}

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiubV" and item.ndim in (1, 2):
            found.update(spread(name.replace("/", separator), item[()], separator))

    with parsing(Path(path).name, kind, "write it again"), h5py.File(os.fspath(path), "r") as file:
        file.visititems(take)
    return found
