"""Import of the optional libraries that some formats need."""

from __future__ import annotations

import importlib
from typing import Any

from imucal.errors import ImucalError

__all__ = ["library"]


def library(module: str, extra: str, what: str) -> Any:
    """Import a library of an optional extra. Raises ImucalError with the install command if it is missing.

    extra   name of the extra of this package that installs the library
    what    the files or messages that the library reads, for the error message
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImucalError(
            f"{what} are read with {module.split('.')[0]}, which cannot be imported ({error}): "
            f'pip install "imucal-rs[{extra}]"'
        ) from None
