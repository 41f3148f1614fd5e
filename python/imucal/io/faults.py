"""Conversion of any failure of a reader to an error that names file, format and remedy."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from imucal.errors import FormatError, ImucalError

__all__ = ["WAY_OUT", "faults_named", "shown_names", "too_large"]

WAY_OUT: Final = (
    "it is damaged or of an unknown version: write it again, or convert it to CSV or Parquet with the "
    "program that wrote it"
)


@contextmanager
def faults_named(paths: Sequence[str | os.PathLike[str]], title: str) -> Iterator[None]:
    """Convert any exception but ImucalError to a FormatError; `title` is the name of the format.

    Libraries raise all kinds of exceptions on damaged files, including MemoryError for wrong lengths in the
    file.
    """
    try:
        yield
    except ImucalError:
        raise
    except MemoryError as error:
        raise too_large(paths, title) from error
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(
            f"{shown_names(paths)} cannot be read as {title}: {reason[:200]}: {WAY_OUT}"
        ) from error


def too_large(paths: Sequence[str | os.PathLike[str]], title: str) -> FormatError:
    """The error for a file whose reader needs too much memory.

    The memory exceeds the limit for a file of this size, or the memory of the computer.
    """
    return FormatError(
        f"{shown_names(paths)} cannot be read as {title}: reading it needs more memory than a file of this "
        f"size normally does, or more than is available: {WAY_OUT}; or give a shorter recording"
    )


def shown_names(paths: Sequence[str | os.PathLike[str]]) -> str:
    """The names of the files without their folders, for messages."""
    return " + ".join(Path(path).name or os.fspath(path) for path in paths)
