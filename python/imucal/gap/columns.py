"""Candidates of a search from the further columns of the recordings, such as a supply voltage.

A bias that follows a recorded column looks like a random walk to a search that does not know the column. The
biases of both sensors are therefore always tested against each column, as `gyro: k * (supply_v - 3.3)`.
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

# A column is no candidate if time, temperature, force and rate explain at least this share of its variance:
# counters and clocks, copies of the sensor's own columns, and further temperatures, which effects of the
# catalogue describe. Noise of a supply voltage alone leaves more.
EXPLAINED: Final = 0.95
# Largest number of columns that become candidates. Each one makes a false alarm more likely, and the evidence
# that an effect needs grows with the number of candidates. Columns that vary most independently come first.
MOST_COLUMNS: Final = 6
# Samples that the share is computed from.
SAMPLES: Final = 4000


def column_effects(recordings: Sequence[Recording]) -> tuple[FormulaEffect, ...]:
    """Linear effects of the further columns on both biases; none of a column that known inputs explain."""
    texts = []
    for name in usable_columns(recordings):
        middle = np.mean([np.mean(recording.auxiliary[name]) for recording in recordings])
        texts += [
            f"{sensor}_bias_{name} = {sensor}: k*({name} - {middle:.4g})" for sensor in ("gyro", "accel")
        ]
    return formula_effects(texts, recordings)


def usable_columns(recordings: Sequence[Recording]) -> list[str]:
    """Names of the further columns that vary independently of known inputs, the most independent first."""
    names = set.intersection(*(set(recording.auxiliary) for recording in recordings))
    usable = sorted(
        name for name in names if name.isidentifier() and name not in {*INPUTS, *CONSTANTS, *FUNCTIONS}
    )
    shares = {name: _explained_share(name, recordings) for name in usable}
    chosen = sorted((name for name in usable if shares[name] < EXPLAINED), key=shares.__getitem__)
    return chosen[:MOST_COLUMNS]


def _explained_share(name: str, recordings: Sequence[Recording]) -> float:
    """Share of the variance of a column that a linear function of the known inputs explains.

    It is 1 for a constant column and for one with values that are not finite. The constant of each recording
    is free, so that a counter that starts again is still a counter.
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
    """What effects of the catalogue depend on, centred and scaled, one column each."""
    force, rate = samples_of_both(recording)
    given = [recording.time_s[rows, None], force[rows], rate[rows]]
    if recording.temperature_degc is not None:
        given.append(recording.temperature_degc[rows, None])
    inputs = np.hstack([np.asarray(values, dtype=np.float64) for values in given])
    inputs = np.nan_to_num(inputs - np.nanmean(inputs, axis=0))
    spread = inputs.std(axis=0)
    scaled: FloatArray = inputs / np.where(spread > 0.0, spread, 1.0)
    return scaled
