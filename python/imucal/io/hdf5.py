"""Reads HDF5 files, including MATLAB files from version 7.3 on."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from imucal.document.source import open_large, parsing
from imucal.errors import FormatError
from imucal.io.extra import library
from imucal.io.named_arrays import Array, NamedArrays, StoredArray, recording_from_arrays, spread
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
    with hdf5_arrays(h5py, path, "/", "HDF5") as by_path:
        arrays = NamedArrays(Path(path).name, by_path, "/")
        return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)


@contextmanager
def hdf5_arrays(
    h5py: Any, path: str | os.PathLike[str], separator: str, kind: str
) -> Iterator[dict[str, StoredArray]]:
    """All one- and two-dimensional numeric data sets, each under its path in the file.

    A compound data set becomes one array per field. The file is open only inside the `with` block, so the
    values must be read there. Links to other files are not followed. Data sets that are stored in other files
    are refused when they are read.

    separator   text that replaces `/` in the paths
    kind        name of the format in messages
    """
    file_name = Path(path).name
    found: dict[str, StoredArray] = {}

    def take(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "fiubV" or item.ndim not in (1, 2):
            return

        def load() -> Array:
            if item.external or item.is_virtual:
                raise FormatError(
                    f"{file_name}: the values of {name} are in another file: copy them into this one "
                    "(h5repack)"
                )
            values: Array = item[()]
            return values

        found.update(
            spread(name.replace("/", separator), StoredArray(item.shape, item.dtype, load), separator)
        )

    with parsing(file_name, kind, "write it again"), h5py.File(os.fspath(path), "r") as file:
        file.visititems(take)
        yield found
