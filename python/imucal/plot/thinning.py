"""Which of many rests or moves are drawn: a report of hours must not grow with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["MOST", "evenly", "numbers", "thinned"]

# A figure holds no more points than this: the page of hours stays below 6 MB, 5 of which are plotly.
MOST: Final = 400


def numbers(items: Sequence[Mapping[str, Any]], name: str) -> FloatArray:
    """The field `name` of each item, (K,); NaN where it does not exist."""
    return np.array([np.nan if item[name] is None else item[name] for item in items], dtype=float)


def evenly(count: int, most: int = MOST) -> list[int]:
    """Indices, increasing, of at most `most` of `count` items, evenly spread."""
    indices: list[int] = np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()
    return indices


def thinned(importance: FloatArray, most: int = MOST) -> list[int]:
    """Indices, increasing, of at most `most` items: half are the most important, half are evenly spread.

    importance  (K,); NaN is the least important
    """
    count = len(importance)
    if count <= most:
        return list(range(count))
    worst = np.argsort(-np.nan_to_num(importance, nan=-np.inf), kind="stable")[: most // 2]
    chosen: list[int] = np.union1d(worst, evenly(count, most - len(worst))).astype(int).tolist()
    return chosen
