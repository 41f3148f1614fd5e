"""Where a demonstration writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from imucal.errors import InputError

__all__ = ["prepare_folder"]


def prepare_folder(folder: Path, files: Sequence[str]) -> None:
    """Make the folder; what an earlier demonstration left there is written over, all of `files`.

    Raises InputError if it cannot be made, and if some of them are there and others are not: the names are
    those that recordings of real units have.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made: {error.strerror}: give another folder with -o") from None
    there = [name for name in files if (folder / name).exists()]
    if there and len(there) < len(files):
        raise InputError(
            f"{folder / there[0]} is there already and of no demonstration: give another folder (-o)"
        )
