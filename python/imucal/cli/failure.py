"""A command that comes to no result: the message for a person, and the document for a script.

Where --json asks for the result it is written why there is none: a script must not read the last run's.
"""

from __future__ import annotations

import contextlib
import json
import os
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import typer

from imucal.cli.output import Output
from imucal.errors import ImucalError

__all__ = ["TRACEBACK", "is_fault", "message_of", "no_result_told", "refusal_told"]

# Set to anything, it lets a bug end with its traceback.
TRACEBACK: Final = "IMUCAL_TRACEBACK"


def message_of(error: BaseException) -> str:
    """What is said of an error that ends a command."""
    known = _foreseen(error)
    return _fault(error) if known is None else known


def is_fault(error: BaseException) -> bool:
    """Whether nobody foresaw the error: it is a bug."""
    return _foreseen(error) is None


def _foreseen(error: BaseException) -> str | None:
    if isinstance(error, ImucalError):
        return str(error)
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return "interrupted"
    if isinstance(error, MemoryError):
        return "there is not enough memory: give a shorter recording"
    if isinstance(error, OSError) and error.strerror is not None:
        # Standard output alone is written without InputError.
        what = "standard output cannot be written" if error.filename is None else error.filename
        return f"{what}: {error.strerror}"
    # What the command line parser says; its class has no stable place to import it from.
    if hasattr(error, "format_message"):
        return str(error.format_message())
    return None


def _fault(error: BaseException) -> str:
    """An error that nobody foresaw, in one screen: what, where, and how to see all of it."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(str(error).split())[:500]
    return (
        f"this is a fault of imucal and not of your data: {type(error).__name__}: {what or 'no message'}\n"
        f"in {last.name}, {Path(last.filename).name}, line {last.lineno}; no file is half written\n"
        f"Run it again with {TRACEBACK}=1 before the command for the traceback, and report it with that."
    )


@contextlib.contextmanager
def no_result_told(options: Mapping[str, Any]) -> Iterator[None]:
    """Write the error that ends this block where --json says; `options` are those of the command."""
    path = options.get("json")
    before = Output.documents
    try:
        yield
    except (typer.Exit, SystemExit):
        raise
    except BaseException as error:
        # Who interrupts the summary, or does not read it, has the result; a file that fails after it is said.
        is_told = Output.documents > before and (path == "-" or not isinstance(error, ImucalError))
        if path is not None and not is_told and not _is_read(path, options.values()):
            _write(path, error)
        raise


@contextlib.contextmanager
def refusal_told(arguments: Sequence[str]) -> Iterator[None]:
    """The same for a command line that the parser refuses in this block: --json is one of its words."""
    try:
        yield
    except Exception as error:
        path = _json_in(arguments)
        # With its own value forgotten, --json has the next word, which may be data.
        if path is not None and hasattr(error, "format_message") and _may_be_replaced(path):
            words = [part for word in arguments for part in word.split("=", 1)]
            if not _is_read(path, words):
                _write(path, error)
        raise


def _write(path: str, error: BaseException) -> None:
    known = error if isinstance(error, ImucalError) else ImucalError(message_of(error))
    # The error itself is what must be seen, not that of a second file.
    with contextlib.suppress(ImucalError, OSError):
        Output(path).document({**known.to_dict(), "error": type(error).__name__})


def _is_read(path: str, given: Iterable[Any]) -> bool:
    """Whether --json names a file that stands in another place of the command line, which may be data."""
    if path == "-":
        return False
    values = [item for value in given for item in (value if isinstance(value, (list, tuple)) else [value])]
    named = [os.path.realpath(value) for value in values if isinstance(value, (str, Path))]
    # The samples of a run that was broken off are in OUTPUT.journal.
    journals = [f"{name}.journal" for name in named]
    # One of them is --json itself.
    return [*named, *journals].count(os.path.realpath(path)) > 1


def _json_in(arguments: Sequence[str]) -> str | None:
    """The value of --json among the words of a command line."""
    found = None
    for word, following in pairwise([*arguments, ""]):
        if word == "--":
            break
        name, equals, value = word.partition("=")
        if name == "--json":
            found = value if equals else following
    return found if found == "-" or (found and not found.startswith("-")) else None


def _may_be_replaced(path: str) -> bool:
    """Whether there is nothing, or no file, or a document with a verdict of an earlier run."""
    if not Path(path).is_file():
        return True
    try:
        with Path(path).open("rb") as file:
            # A recording may be large.
            document = json.load(file) if file.read(1) == b"{" and file.seek(0) == 0 else None
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and "verdict" in document
