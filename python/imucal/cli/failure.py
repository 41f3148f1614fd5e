"""Error messages of commands that end without a result, and the JSON document of the error for scripts.

If a command with --json fails, the JSON document describes the error, so that scripts do not read an old
result.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from click.exceptions import Abort, Exit

from imucal.cli.as_typed import as_typed
from imucal.cli.output import Output
from imucal.errors import ImucalError, NotEnoughMotionError

__all__ = [
    "TRACEBACK",
    "command_offered",
    "is_fault",
    "is_interrupt",
    "message_of",
    "no_result_told",
    "refusal_told",
]

# Environment variable. If it is set, an internal error ends the command with a traceback.
TRACEBACK: Final = "IMUCAL_TRACEBACK"
# OFFERED matches the model with fewer parameters that the message of an error proposes, such as
# model='orthogonal'. WITH_MODEL lists the commands that have the option --model.
OFFERED: Final = r"\bmodel='(\w+)'"
WITH_MODEL: Final = ("calibrate", "gap")
# If the message of an error contains this text, the calibration needs the noise of the mean readings, and the
# command that `command_offered` returns contains the option --noise.
NOISE_NEEDED: Final = "noise_mps2=..."


def message_of(error: BaseException) -> str:
    """The message for an error that ends a command."""
    known = _foreseen(error)
    return _fault(error) if known is None else known


def command_offered(error: BaseException, arguments: Sequence[str]) -> str:
    """The command that estimates fewer parameters, if the error proposes a smaller model; otherwise empty.

    arguments   arguments of the command that ended with the error
    """
    offered = re.search(OFFERED, str(error)) if isinstance(error, NotEnoughMotionError) else None
    if offered is None or not arguments or arguments[0] not in WITH_MODEL:
        return ""
    import shlex

    others = list(arguments[1:])
    for at in reversed([i for i, argument in enumerate(others) if argument.startswith("--model")]):
        del others[at : at + (1 if "=" in others[at] else 2)]
    noise = " --noise MPS2" if NOISE_NEEDED in str(error) else ""
    return f": imucal {shlex.join([arguments[0], '--model', offered[1], *others])}{noise}"


def is_fault(error: BaseException) -> bool:
    """Whether the error is a bug of imucal."""
    return _foreseen(error) is None


def is_interrupt(error: BaseException) -> bool:
    """Whether the user interrupted the command.

    If an interrupt arrives while a class is created, for example during the import of a module, Python 3.11
    and earlier raise a RuntimeError whose cause is the interrupt.
    """
    is_wrapped = isinstance(error, RuntimeError) and isinstance(error.__cause__, KeyboardInterrupt)
    return is_wrapped or isinstance(error, (KeyboardInterrupt, Abort))


def _foreseen(error: BaseException) -> str | None:
    if isinstance(error, ImucalError):
        return as_typed(str(error))
    if is_interrupt(error):
        return "interrupted"
    if isinstance(error, MemoryError):
        return "not enough memory: give a shorter recording"
    if isinstance(error, OSError) and error.strerror is not None:
        # This OSError can only be an error of standard output, because commands convert all other OSErrors to
        # ImucalError.
        what = "standard output cannot be written" if error.filename is None else error.filename
        return f"{what}: {error.strerror}"
    # Errors of the command line parser are recognised by their method `format_message`, because their class
    # has no stable import path.
    if hasattr(error, "format_message"):
        return str(error.format_message())
    return None


def _fault(error: BaseException) -> str:
    """The message for a bug: error, location, and how to show the traceback."""
    import traceback

    last = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(str(error).split())[:500]
    return (
        f"this is a bug of imucal, not an error in your data: {type(error).__name__}: "
        f"{what or 'no message'}\nin {last.name}, {Path(last.filename).name}, line {last.lineno}; no file is "
        f"incomplete\nSet {TRACEBACK}=1 and run the command again to see the traceback, and include it in a "
        "bug report."
    )


@contextlib.contextmanager
def no_result_told(options: Mapping[str, Any]) -> Iterator[None]:
    """If an error ends this block, write the error to the file that the command's option --json names."""
    path = options.get("json")
    before = Output.documents
    try:
        yield
    except (Exit, SystemExit):
        raise
    except BaseException as error:
        # If the user interrupts the command, a result that is already in the JSON file stays there. An
        # ImucalError after the result was written means that another output file could not be written. The
        # document of this error then replaces the result.
        is_told = Output.documents > before and (path == "-" or not isinstance(error, ImucalError))
        if path is not None and not is_told and not _is_read(path, options.values()):
            _write(path, error)
        raise


@contextlib.contextmanager
def refusal_told(arguments: Sequence[str]) -> Iterator[None]:
    """Write an error of the command line parser to the --json file, whose path is among `arguments`."""
    try:
        yield
    except Exception as error:
        path = _json_in(arguments)
        # If the user forgot the value of --json, the next word is taken as its value, and this word may be
        # the name of a data file. Therefore the document is written only if the file does not exist or
        # contains an earlier result.
        if path is not None and hasattr(error, "format_message") and _may_be_replaced(path):
            words = [part for word in arguments for part in word.split("=", 1)]
            if not _is_read(path, words):
                _write(path, error)
        raise


def _write(path: str, error: BaseException) -> None:
    known = error if isinstance(error, ImucalError) else ImucalError(message_of(error))
    # An error while writing the document must not hide the original error.
    with contextlib.suppress(ImucalError, OSError):
        name = "KeyboardInterrupt" if is_interrupt(error) else type(error).__name__
        Output(path).document({**known.to_dict(), "error": name})


def _is_read(path: str, given: Iterable[Any]) -> bool:
    """Whether another argument in `given` has the same path as --json, so that the file may be an input."""
    if path == "-":
        return False
    values = [item for value in given for item in (value if isinstance(value, (list, tuple)) else [value])]
    named = [os.path.realpath(value) for value in values if isinstance(value, (str, Path))]
    # The journal of an interrupted run, OUTPUT.journal, may contain samples and must not be overwritten.
    journals = [f"{name}.journal" for name in named]
    # The value of --json itself is among these names, so a count of 1 means that no other argument has this
    # path.
    return [*named, *journals].count(os.path.realpath(path)) > 1


def _json_in(arguments: Sequence[str]) -> str | None:
    """The value of --json in the words of a command line, or None."""
    found = None
    for word, following in pairwise([*arguments, ""]):
        if word == "--":
            break
        name, equals, value = word.partition("=")
        if name == "--json":
            found = value if equals else following
    return found if found == "-" or (found and not found.startswith("-")) else None


def _may_be_replaced(path: str) -> bool:
    """Whether `path` does not exist, is not a regular file, or contains an earlier result with a verdict."""
    if not Path(path).is_file():
        return True
    import json

    try:
        with Path(path).open("rb") as file:
            # A file is read completely only if it starts like a JSON object, because it may be a large
            # recording.
            document = json.load(file) if file.read(1) == b"{" and file.seek(0) == 0 else None
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and "verdict" in document
