"""Selection of rests or moves to draw, so that the size of a report does not grow with the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["MOST", "evenly", "numbers", "thinned"]

# Maximum number of rests or moves in a figure. With this number, the size of a page stays below 6 MB, of
# which plotly.js is 5 MB.
MOST: Final = 360


def numbers(items: Sequence[object], name: str) -> FloatArray:
    """The field `name` of each item, (K,); NaN where it is None."""
    values = [getattr(item, name) for item in items]
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def evenly(count: int, most: int = MOST) -> list[int]:
    """At most `most` evenly spaced indices of `count` items, increasing."""
    indices: list[int] = np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()
    return indices


def thinned(importance: FloatArray, most: int = MOST) -> list[int]:
    """Select at most `most` of the items by their importance; returns their indices, increasing.

    One half are the indices of the most important items, and the other half are evenly spaced.

    importance  (K,); NaN counts as the lowest importance
    """
    count = len(importance)
    if count <= most:
        return list(range(count))
    worst = np.argsort(-np.nan_to_num(importance, nan=-np.inf), kind="stable")[: most // 2]
    chosen: list[int] = np.union1d(worst, evenly(count, most - len(worst))).astype(int).tolist()
    return chosen
