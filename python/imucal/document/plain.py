"""Conversion of results to dictionaries, lists, numbers and texts for JSON and tables."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["plain", "without_nan"]

# Fast path: values of these types are returned unchanged. Nearly all values have these types, and the general
# checks take ten times as long.
_AS_THEY_ARE = frozenset({bool, float, int, str, type(None)})


def plain(value: Any) -> Any:
    """`value` with arrays and tuples as lists, NumPy numbers as numbers, and dataclasses as dictionaries."""
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
    """`value` as plain values, with None for NaN and infinity, for reports in which a number is undefined."""
    if type(value) in _AS_THEY_ARE:
        return None if type(value) is float and not math.isfinite(value) else value
    return _without_nan(plain(value))


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        # Most values are short lists of floats. For these lists, no function is called per float, because the
        # calls would take most of the time.
        finite = math.isfinite
        return [
            (item if finite(item) else None) if type(item) is float else _without_nan(item) for item in value
        ]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return value
