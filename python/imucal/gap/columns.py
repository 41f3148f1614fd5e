"""Candidate effects that depend on auxiliary columns of the recordings, such as a supply voltage.

If a bias follows a recorded column, and the search does not use this column, the bias looks like a random
walk. The biases of both sensors are therefore always tested against each column, for example by the formula
`gyro: k * (supply_v - 3.3)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.effects.formula import CONSTANTS, FUNCTIONS, INPUTS
from imucal.effects.formula_effect import FormulaEffect, formula_effects
from imucal.recording.recording import Recording, samples_of_both

__all__ = ["column_effects", "usable_columns"]

# A column is not a candidate if time, temperature, force and rate explain at least this share of its
# variance. This limit excludes counters and clocks, copies of the sensor's columns, and further temperatures.
# Effects of the catalogue already describe the dependence on temperature. A supply voltage stays below this
# share because of its own noise.
EXPLAINED: Final = 0.95
# Maximum number of columns that become candidates. The number is limited because an effect needs more
# evidence if there are more candidates. The selected columns are those whose variance is explained least by
# time, temperature, force and rate.
MOST_COLUMNS: Final = 6
# Maximum number of samples of a recording from which the explained share of a column's variance is computed.
SAMPLES: Final = 4000


def column_effects(recordings: Sequence[Recording]) -> tuple[FormulaEffect, ...]:
    """Effects in which a bias depends linearly on an auxiliary column (see `usable_columns`)."""
    texts = []
    for name in usable_columns(recordings):
        middle = np.mean([np.mean(recording.auxiliary[name]) for recording in recordings])
        texts += [
            f"{sensor}_bias_{name} = {sensor}: k*({name} - {middle:.4g})" for sensor in ("gyro", "accel")
        ]
    return formula_effects(texts, recordings)


def usable_columns(recordings: Sequence[Recording]) -> list[str]:
    """Names of the auxiliary columns that time, force, rate and temperature do not explain.

    At most `MOST_COLUMNS` names are returned. The column that is explained least comes first.
    """
    names = set.intersection(*(set(recording.auxiliary) for recording in recordings))
    usable = sorted(
        name for name in names if name.isidentifier() and name not in {*INPUTS, *CONSTANTS, *FUNCTIONS}
    )
    shares = {name: _explained_share(name, recordings) for name in usable}
    chosen = sorted((name for name in usable if shares[name] < EXPLAINED), key=shares.__getitem__)
    return chosen[:MOST_COLUMNS]


def _explained_share(name: str, recordings: Sequence[Recording]) -> float:
    """Share of a column's variance explained by a linear function of time, force, rate and temperature.

    The share is 1 for a constant column and for a column with values that are not finite. Each recording has
    a separate constant term, so that a counter which restarts is still recognised.
    """
    residual, total = 0.0, 0.0
    for recording in recordings:
        rows = np.linspace(0, len(recording) - 1, min(SAMPLES, len(recording))).astype(int)
        column = recording.auxiliary[name][rows]
        if not np.isfinite(column).all():
            return 1.0
        inputs = _inputs(recording, rows)
        centred = column - column.mean()
        fitted = inputs @ np.linalg.lstsq(inputs, centred, rcond=None)[0]
        residual += float(((centred - fitted) ** 2).sum())
        total += float((centred**2).sum())
    return 1.0 - residual / total if total > 0.0 else 1.0


def _inputs(recording: Recording, rows: np.ndarray) -> FloatArray:
    """Time, force, rate and temperature at the given samples, one per column, centred and scaled."""
    force, rate = samples_of_both(recording)
    given = [recording.time_s[rows, None], force[rows], rate[rows]]
    if recording.temperature_degc is not None:
        given.append(recording.temperature_degc[rows, None])
    inputs = np.hstack([np.asarray(values, dtype=np.float64) for values in given])
    inputs = np.nan_to_num(inputs - np.nanmean(inputs, axis=0))
    spread = inputs.std(axis=0)
    scaled: FloatArray = inputs / np.where(spread > 0.0, spread, 1.0)
    return scaled
