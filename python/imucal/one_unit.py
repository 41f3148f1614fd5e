"""Recordings of one unit: of the same raw units, each with a name of its own, and none that judges itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.recording import Recording, as_recordings

__all__ = ["of_one_unit", "require_other_data", "with_own_names"]


def of_one_unit(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """The recordings as a list; they must agree on what the numbers are."""
    unit_data = as_recordings(recordings)
    if not unit_data:
        raise InputError("there is no recording: give at least one")
    first = unit_data[0]
    for other in unit_data[1:]:
        if (other.accel_unit, other.gyro_unit) != (first.accel_unit, first.gyro_unit):
            raise InputError(
                f"{other.name} is in {other.accel_unit} and {other.gyro_unit} but {first.name} in "
                f"{first.accel_unit} and {first.gyro_unit}: recordings of one unit need the same raw units"
            )
    return with_own_names(unit_data)


def with_own_names(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, each with a name that no other has: results say by name which one a rest is of."""
    names: list[str] = []
    for recording in recordings:
        name, number = recording.name, 1
        while name in names:
            number += 1
            name = f"{recording.name} ({number})"
        names.append(name)
    return [
        recording if recording.name == name else replace(recording, name=name)
        for recording, name in zip(recordings, names, strict=True)
    ]


def require_other_data(unit_data: Sequence[Recording], judges: Sequence[Recording]) -> None:
    """A control recording must not be one that the calibration is made of."""
    made_of = [(recording, _changes(recording)) for recording in unit_data]
    for judge in judges:
        rows = _changes(judge)
        for recording, others in made_of:
            if np.array_equal(rows, others):
                raise InputError(
                    f"the control recording {judge.name} has all {len(judge)} samples of {recording.name}, "
                    "which the calibration is made of: give another recording of the unit, or use folds"
                )


def _changes(recording: Recording) -> FloatArray:
    """The rows that differ from the one before, (n, 6): one that was held or logged twice counts once."""
    rows = np.hstack((recording.specific_force, recording.angular_rate))
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    new: FloatArray = rows[is_new]
    return new
