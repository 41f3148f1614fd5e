"""Reader of NumPy files: .npz with named arrays, .npy with a structured or plain array of shape (N, k)."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, BinaryIO, Final

import numpy as np

from imucal.document.source import Source, first_bytes, open_large, parsing
from imucal.errors import FormatError
from imucal.io.named_arrays import Array, NamedArrays, StoredArray, recording_from_arrays, spread
from imucal.io.packed import ZIP
from imucal.recording.recording import Recording

__all__ = ["read_numpy"]

# A decompressed array may have at most MEMORY_BYTES plus MEMORY_PER_BYTE times its compressed size, bytes.
MEMORY_BYTES: Final = 200_000_000
MEMORY_PER_BYTE: Final = 40


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
    way_out = "save plain arrays of numbers again (numpy.savez)"
    by_path: dict[str, StoredArray] = {}
    with parsing(name, "NumPy", way_out), Path(path).open("rb") as file:
        if first_bytes(path, len(ZIP)) == ZIP:
            archive = zipfile.ZipFile(file)
            for member in archive.infolist():
                # Members of the zip archive that are not arrays are ignored.
                if member.filename.endswith(".npy"):
                    key = member.filename.removesuffix(".npy")
                    by_path.update(spread(key, _member(archive, member), "/"))
        else:
            by_path.update(spread("", _whole(file), "/"))
        return _recording(name, by_path, source, columns, group, rate_hz)


def _whole(file: BinaryIO) -> StoredArray:
    """The array of a .npy file."""
    file.seek(0, os.SEEK_END)
    size = file.tell()
    file.seek(0)
    shape, dtype = _header(file)
    _require_size(shape, dtype, size - file.tell())

    def load() -> Array:
        file.seek(0)
        values: Array = np.lib.format.read_array(file, allow_pickle=False)
        return values

    return StoredArray(shape, dtype, load)


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> StoredArray:
    """An array of a .npz file. The array is decompressed when its values are needed."""
    with archive.open(member) as file:
        shape, dtype = _header(file)
        _require_size(shape, dtype, member.file_size - file.tell())
    if member.file_size > MEMORY_BYTES + MEMORY_PER_BYTE * member.compress_size:
        raise ValueError(f"{member.filename} claims {member.file_size} bytes, from {member.compress_size}")

    def load() -> Array:
        with archive.open(member) as file:
            values: Array = np.lib.format.read_array(file, allow_pickle=False)
        return values

    return StoredArray(shape, dtype, load)


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and element type in the header at the start of an array."""
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    # Headers of version 3 are read as version 2, because they differ only in the encoding of field names and
    # numpy has no public function for them.
    shape, _, dtype = read.get(version, np.lib.format.read_array_header_2_0)(file)
    if dtype.hasobject:
        raise ValueError("it contains objects (pickled), which are not read")
    return shape, dtype


def _require_size(shape: tuple[int, ...], dtype: np.dtype[Any], size: int) -> None:
    """Raises ValueError if an array needs more bytes than the `size` bytes that follow its header."""
    needed = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or needed > size:
        raise ValueError(f"an array of shape {shape} needs {needed} bytes, but only {size} follow")


def _recording(
    name: str,
    by_path: dict[str, StoredArray],
    source: Source,
    columns: str | Sequence[str] | None,
    group: str | None,
    rate_hz: float | None,
) -> Recording:
    if "" in by_path and columns is None:
        raise FormatError(
            f"{name} contains one array of shape {by_path[''].shape} without names: name every column "
            "(columns=..., --columns time_s,accel_x_mps2,...,gyro_z_radps)"
        )
    arrays = NamedArrays(name, by_path, "/")
    return recording_from_arrays(arrays, [source], columns=columns, group=group, rate_hz=rate_hz)
