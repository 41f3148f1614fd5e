"""HTML of results in notebooks.

The method `_repr_html_` of a result calls `html_of`. The package `imucal` registers the name of the module
that makes the HTML. The modules of the results therefore need not import the report package. The registered
module is loaded when the first result is shown.
"""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["html_of", "register"]

_makers: list[str] = []


def register(module: str) -> None:
    """Set the module whose function `html_of` returns the HTML of a result."""
    _makers[:] = [module]


def html_of(result: Any) -> str | None:
    """The HTML of a result, or None if no module is registered; a notebook then shows the repr."""
    if not _makers:
        return None
    html: str = importlib.import_module(_makers[0]).html_of(result)
    return html
