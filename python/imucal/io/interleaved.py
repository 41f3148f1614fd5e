"""Detection of text tables that contain the samples of several units (IMUs).

In such a table, a column names the unit of each row, for example by its address. If the table were read as
the recording of one unit, the samples and the sampling rate would be wrong. A column may also contain labels
that do not name a unit, such as classes of a motion. In this case, samples of two consecutive rows with
different labels differ no more than samples of two consecutive rows with the same label.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import FormatError
from imucal.io.head import Head
from imucal.io.names import is_canonical, triad_part
from imucal.io.text import Text

__all__ = ["refuse_interleaved"]

# Largest number of different labels in a column for the labels to count as names of units (IMUs).
MOST_UNITS: Final = 8
# A column can name units if the table has at least LEAST_ROWS rows, and if the label in at least the share
# LEAST_CHANGES of the rows differs from the label in the previous row.
LEAST_ROWS: Final = 40
LEAST_CHANGES: Final = 0.1
# The samples belong to several units if their median change from a row to a row with another label exceeds
# this multiple of the median change between successive samples with the same label.
CLEAR: Final = 5.0


def refuse_interleaved(text: Text, names: Sequence[str], head: Head | None = None) -> None:
    """Raises FormatError if a column without a canonical name shows that the rows are from several units.

    names  names of the columns, canonical or not
    head   the first cells, if they are known
    """
    keys = text.layout.names or [str(index) for index in range(len(names))]
    others = [key for key, name in zip(keys, names, strict=False) if not is_canonical(name)]
    triads = {
        part: key for key, name in zip(keys, names, strict=False) if (part := triad_part(name)) is not None
    }
    if not others or not triads:
        return
    head = head or Head(text)
    sensor = min(part[0] for part in triads)
    samples = np.column_stack(
        [head.numbers(key) for part, key in sorted(triads.items()) if part[0] == sensor]
    )
    for other in others:
        labels = head.cells.get(other, [])
        if len(labels) == len(samples) >= LEAST_ROWS and _divide(labels, samples):
            units = list(dict.fromkeys(labels))
            raise FormatError(
                f"{text.name}: each row belongs to one of {len(units)} units, named in the column {other!r} "
                f"({', '.join(units)[:60]}): write the rows of each unit to a separate file"
            )


def _divide(labels: Sequence[str], samples: FloatArray) -> bool:
    kinds = set(labels)
    if not 2 <= len(kinds) <= MOST_UNITS:
        return False
    array = np.array(labels)
    is_change = array[1:] != array[:-1]
    if is_change.mean() < LEAST_CHANGES:
        return False
    across = _sizes(samples)[is_change]
    within = np.concatenate([_sizes(samples[array == kind]) for kind in kinds])
    return bool(np.nanmedian(across) > CLEAR * np.nanmedian(within)) if len(within) else False


def _sizes(samples: FloatArray) -> FloatArray:
    """Magnitude of the difference between each sample and the previous sample."""
    return np.asarray(np.linalg.norm(np.diff(samples, axis=0), axis=1))
