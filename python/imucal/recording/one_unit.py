"""Checks of several recordings of one unit: same raw units, unique names, independent control recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from imucal.errors import InputError
from imucal.finding import Finding
from imucal.recording.recording import Recording, as_recordings

__all__ = ["of_one_unit", "require_different", "require_other_data", "with_own_names"]

# To compare two recordings quickly, this number of samples at their starts is compared first. The first
# samples of different runs nearly always differ.
BEGINNING: Final = 100


def of_one_unit(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """The recordings as a list. Raises InputError if their raw units or axes differ."""
    unit_data = as_recordings(recordings)
    if not unit_data:
        raise InputError("there is no recording: give at least one")
    first = unit_data[0]
    for other in unit_data[1:]:
        if other.sensors != first.sensors:
            lacking, having = (other, first) if len(other.sensors) < len(first.sensors) else (first, other)
            missing = next(sensor for sensor in having.sensors if sensor not in lacking.sensors)
            raise InputError(
                f"{having.name} has a {missing}, but {lacking.name} has none [sensor_missing]: recordings of "
                "one unit need the same sensors: if each file contains one sensor, give each recording as a "
                f"folder with both files; in Python, Recording.of_sensor removes the {missing} of "
                f"{having.name}"
            )
        if (other.accel_unit, other.gyro_unit) != (first.accel_unit, first.gyro_unit):
            raise InputError(
                f"{other.name} is in {other.accel_unit} and {other.gyro_unit} but {first.name} in "
                f"{first.accel_unit} and {first.gyro_unit}: recordings of one unit need the same raw units"
            )
        if other.axes != first.axes:
            raise InputError(
                f"{other.name} was read with the axes {other.axes} but {first.name} with the axes "
                f"{first.axes}: read all recordings of one unit with the same axes"
            )
    return with_own_names(unit_data)


def with_own_names(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with unique names, by which results refer to them."""
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


def require_other_data(
    unit_data: Sequence[Recording], judges: Sequence[Recording], without_control: str
) -> None:
    """Raise InputError if a control recording is also a calibration recording.

    without_control  advice how to verify the result without a control recording
    """
    for judge in judges:
        for recording in unit_data:
            if _is_same_run(judge, recording):
                message = (
                    f"the control recording {judge.name} has all {len(judge)} samples of {recording.name}, "
                    "which is a calibration recording"
                )
                way_out = f"give another recording of the unit, or {without_control}"
                finding = Finding(
                    "control_not_independent",
                    "error",
                    judge.name,
                    (),
                    None,
                    len(judge),
                    float(len(judge)),
                    "samples",
                    message,
                    way_out,
                )
                raise InputError(f"{message} [{finding.code}]: {way_out}", [finding])


def require_different(judges: Sequence[Recording]) -> None:
    """Raise InputError if two control recordings have the same samples."""
    for number, judge in enumerate(judges):
        for other in judges[:number]:
            if _is_same_run(judge, other):
                raise InputError(
                    f"the control recordings {other.name} and {judge.name} have the same {len(judge)} "
                    "samples: give every recording once"
                )


def _is_same_run(one: Recording, other: Recording) -> bool:
    """Whether both recordings have the same samples after removal of consecutive duplicates."""
    # Fast path: the first samples of different runs nearly always differ.
    starts = [_changes(recording, BEGINNING) for recording in (one, other)]
    shared = min(map(len, starts))
    if not np.array_equal(starts[0][:shared], starts[1][:shared]):
        return False
    return np.array_equal(_changes(one), _changes(other))


def _changes(recording: Recording, end: int | None = None) -> NDArray[Any]:
    """The samples before index `end` that differ from the previous sample; one row per sample, all axes."""
    there = (recording.specific_force, recording.angular_rate)
    rows = np.hstack([samples[:end] for samples in there if samples is not None])
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.asarray(rows[is_new])
