"""The output folder of a demonstration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from imucal.errors import InputError

__all__ = ["prepare_folder"]


def prepare_folder(folder: Path, files: Sequence[str]) -> None:
    """Create the folder. A folder with all of `files` is an earlier demonstration and may be overwritten.

    Raises InputError if the folder cannot be created. Also raises InputError if the folder contains only some
    of `files`, because these files may be recordings of real units.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be created: {error.strerror}: give another folder (-o)") from None
    there = [name for name in files if (folder / name).exists()]
    if there and len(there) < len(files):
        raise InputError(
            f"{folder / there[0]} exists and is not from a demonstration: give another folder (-o)"
        )
