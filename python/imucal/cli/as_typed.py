"""Conversion of options in messages to the form that is typed on the command line.

The library writes an option as the argument of a Python function, `min_rest_s=0.45` or `axes='frd'`. A
command prints the same text with `--min-rest-s 0.45` and `--axes frd`.

The library recommends an axis remapping relative to the axes that the recording has after reading. If the
recording was read with `--axes`, this option already changes the axes. A command then prints the combined
remapping, with which the user must replace the given value of `--axes`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextvars import ContextVar
from typing import Any, Final

__all__ = ["AXES_GIVEN", "as_typed", "document_as_typed"]

# Value of the option --axes of the running command; None if the option is not given.
AXES_GIVEN: Final[ContextVar[str | None]] = ContextVar("axes_given", default=None)

# Arguments of Python functions, such as imucal.read, whose command line options have other names.
RENAMED: Final = {"gravity_mps2": "gravity", "effects": "effect", "noise_mps2": "noise"}
ARGUMENTS: Final = (
    *RENAMED,
    "accel_bias",
    "accel_nominal",
    "accel_unit",
    "axes",
    "columns",
    "exclude_saturated",
    "folds",
    "format",
    "frame",
    "group",
    "gyro_bias",
    "gyro_nominal",
    "gyro_unit",
    "instance",
    "min_rest_s",
    "model",
    "rate_hz",
    "receive_time",
    "skip_rows",
    "temperature_degc",
    "time_unit",
    "topic",
)
# Matches the value of an argument in a message: a value in quotes or brackets, or a plain value. It does not
# match `...`, the placeholder of a value that the user chooses.
VALUE: Final = r"'[^']*'|\"[^\"]*\"|\[[^]]*\]|(?!\.\.\.)[\w+-][\w.+/^-]*(?<!\.)"
ASSIGNED: Final = re.compile(rf"(?<![\w.-])({'|'.join(ARGUMENTS)})( = |=)({VALUE})")
# Names of the fields that contain messages in JSON documents.
TEXTS: Final = {"explanation", "message", "missing", "notes", "reasons", "warnings", "way_out"}


def as_typed(text: str) -> str:
    """Replace the names of Python arguments in a message by command line options."""
    return ASSIGNED.sub(_option, text)


def _option(found: re.Match[str]) -> str:
    name, equals, value = found.groups()
    option = "--" + RENAMED.get(name, name).replace("_", "-")
    if equals == " = ":
        return f"{option} = {value}"
    if value == "True":
        return option
    bare = value[1:-1] if value[0] in "'\"[" else value
    if name == "axes" and (given := AXES_GIVEN.get()) is not None:
        from imucal.recording.axes import Axes

        bare = str(Axes.parse(bare).after(Axes.parse(given)))
    # Values with other characters are quoted, because the shell would split them at spaces or interpret
    # special characters.
    return f"{option} {bare}" if re.fullmatch(r"[\w.,=+/^-]+", bare) else f"{option} '{bare}'"


def document_as_typed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the names of Python arguments in all messages of a document by command line options."""
    return {name: _typed(value) if name in TEXTS else _nested(value) for name, value in document.items()}


def _typed(value: Any) -> Any:
    if isinstance(value, str):
        return as_typed(value)
    return [_typed(item) for item in value] if isinstance(value, (list, tuple)) else _nested(value)


def _nested(value: Any) -> Any:
    if isinstance(value, Mapping):
        return document_as_typed(value)
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], (Mapping, list, tuple)):
        return [_nested(item) for item in value]
    return value
