"""Conversion of data frames to recordings and of recordings to Arrow tables.

A data frame is any object with the Arrow PyCapsule interface (`__arrow_c_stream__`), for example of pandas,
polars, pyarrow or DuckDB. The conversion itself is in the package of the file readers, which the class
`Recording` must not import. `Recording` therefore calls the functions of this module. The package `imucal`
registers the name of the module that converts data frames (`register`). The registered module is loaded when
the first data frame is used.
"""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["is_frame", "recording_of", "register", "table_of"]

_converters: list[str] = []


def register(module: str) -> None:
    """Set the module that has the conversion functions `read_frame` and `to_table`."""
    _converters[:] = [module]


def is_frame(given: Any) -> bool:
    """Whether an object has the Arrow PyCapsule interface, or is a data frame of pandas before 2.2."""
    if hasattr(given, "__arrow_c_stream__"):
        return True
    return type(given).__name__ == "DataFrame" and type(given).__module__.partition(".")[0] == "pandas"


def recording_of(frame: Any) -> Any:
    """Convert a data frame, whose columns have names such as accel_x_mps2, to a Recording."""
    return _converter().read_frame(frame)


def table_of(recording: Any) -> Any:
    """Convert the columns of a recording to a pyarrow table."""
    return _converter().to_table(recording)


def _converter() -> Any:
    if not _converters:
        # The import is inside the function, because `import imucal` loads this module and must not load
        # further modules.
        from imucal.errors import InputError

        raise InputError("data frames need the whole package: use `import imucal` and not only a submodule")
    return importlib.import_module(_converters[0])
