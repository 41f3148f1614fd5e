"""NumPy files: .npz with named arrays, .npy with a structured array or a plain array of shape (N, k)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucal.document.source import open_large, parsing
from imucal.errors import FormatError
from imucal.io.named_arrays import NamedArrays, recording_from_arrays, spread
from imucal.recording.recording import Recording

__all__ = ["read_numpy"]


def read_numpy(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    group: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Read a .npy or .npz file. Pickled objects are refused.

    See `named_arrays` for names, groups and columns.
    """
    source, name = open_large(path), Path(path).name
    with parsing(name, "NumPy", "save plain arrays of numbers again (numpy.savez)"):
        loaded = np.load(os.fspath(path), allow_pickle=False)
        members = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    # np.load opens any zip archive as .npz and returns members that are not arrays as bytes.
    members = {key: member for key, member in members.items() if isinstance(member, np.ndarray)}
    by_path = {}
    for key, array in members.items():
        by_path.update(spread(key, array, "/"))
    if "" in by_path and columns is None:
        raise FormatError(
            f"{name} contains one array of shape {by_path[''].shape} without names: name every column "
            "(columns=..., --columns time_s,accel_x_mps2,...,gyro_z_radps)"
        )
    arrays = NamedArrays(name, by_path, "/")
    return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)
