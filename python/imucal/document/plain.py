"""Results as plain values: what JSON and tables hold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["plain", "without_nan"]

# What nearly all values of a result are: seen at once, where the checks for all else take ten times as long.
_AS_THEY_ARE = frozenset({bool, float, int, str, type(None)})


def plain(value: Any) -> Any:
    """`value` with arrays, NumPy numbers, tuples and dataclasses made lists, numbers and dictionaries."""
    if type(value) in _AS_THEY_ARE:
        return value
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def without_nan(value: Any) -> Any:
    """`value` made plain, NaN and infinity made null: for reports, where a figure may not exist."""
    if type(value) in _AS_THEY_ARE:
        return None if type(value) is float and not math.isfinite(value) else value
    return _without_nan(plain(value))


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        # Most are short lists of floats: a call for each costs more than the rest.
        finite = math.isfinite
        return [
            (item if finite(item) else None) if type(item) is float else _without_nan(item) for item in value
        ]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return value
