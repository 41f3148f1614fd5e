"""Import of parts of SciPy, when a statistic of a fleet needs them."""

from __future__ import annotations

import importlib
from typing import Any

from imucal.errors import ImucalError

__all__ = ["scipy_part"]


def scipy_part(name: str) -> Any:
    """The module scipy.NAME. Raises ImucalError with the install command if SciPy is missing."""
    try:
        return importlib.import_module(f"scipy.{name}")
    except ImportError as error:
        raise ImucalError(
            f"statistics of a fleet need SciPy, which cannot be imported ({error}): "
            'pip install "imucal-rs[fleet]"'
        ) from None
