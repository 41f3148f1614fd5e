"""All traps: each module of this folder has the rows of related kinds in its `TRAPS`."""

import importlib
import pkgutil

from trap import Trap

__all__ = ["TRAPS"]

TRAPS: tuple[Trap, ...] = tuple(
    trap
    for module in sorted(info.name for info in pkgutil.iter_modules(__path__))
    for trap in importlib.import_module(f"rows.{module}").TRAPS
)
