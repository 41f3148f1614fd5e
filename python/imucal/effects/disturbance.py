"""What spoils a recording and has no field: noise that is not white, and faults of the data or of the stand.

They complete the catalogue of `imucal.effects`: a simulation can make them, a search names them. They cannot
be taken away, so no calibration carries them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

from imucal.recording.recording import STANDARD_GRAVITY_MPS2

__all__ = ["Disturbance", "DisturbanceParameter", "disturbances"]

DEGREE: Final = math.radians(1.0)


@dataclass(frozen=True)
class DisturbanceParameter:
    """One number that says how large it is, with its SI unit and an ordinary size."""

    name: str
    unit: str
    typical: float


@dataclass(frozen=True)
class Disturbance:
    """Noise, or a fault.

    sensor     "accelerometer", "gyroscope", "both", or "stand"
    kind       "noise" or "fault"
    looks_for  the trace in the data by which it is known
    """

    name: str
    sensor: str
    kind: Literal["noise", "fault"]
    parameters: tuple[DisturbanceParameter, ...]
    looks_for: str


def _axes(unit: str, typical: float) -> tuple[DisturbanceParameter, ...]:
    return tuple(DisturbanceParameter(axis, unit, typical) for axis in "xyz")


def _one(name: str, unit: str, typical: float) -> tuple[DisturbanceParameter, ...]:
    return (DisturbanceParameter(name, unit, typical),)


@cache
def disturbances() -> tuple[Disturbance, ...]:
    """All of them; the numbers are those of ordinary MEMS sensors and of a cheap stand."""
    return (
        Disturbance(
            "gyro_bias_random_walk",
            "gyroscope",
            "noise",
            # 0.001 deg/s/sqrt(s): seen in a run of five minutes.
            _axes("rad/s/s/sqrt(Hz)", 1e-3 * DEGREE),
            "a bias that wanders from rest to rest, the more the longer it is between them",
        ),
        Disturbance(
            "accel_bias_random_walk",
            "accelerometer",
            "noise",
            # 0.02 mg/sqrt(s).
            _axes("m/s^2/s/sqrt(Hz)", 2e-5 * STANDARD_GRAVITY_MPS2),
            "a bias that wanders from rest to rest, the more the longer it is between them",
        ),
        Disturbance(
            "noise_grows_in_motion",
            "both",
            "fault",
            _one("factor", "1", 2.0),
            "more noise, at high frequencies, while the unit turns than while it rests",
        ),
        Disturbance(
            "gyro_saturation",
            "gyroscope",
            "fault",
            _one("range", "rad/s", 250 * DEGREE),
            "samples at one largest or smallest number, in a row or often",
        ),
        Disturbance(
            "accel_saturation",
            "accelerometer",
            "fault",
            _one("range", "m/s^2", 2 * STANDARD_GRAVITY_MPS2),
            "samples at one largest or smallest number, in a row or often",
        ),
        Disturbance(
            "samples_missing",
            "both",
            "fault",
            _one("share", "1", 0.01),
            "steps in time that are a multiple of the usual one",
        ),
        Disturbance(
            "samples_duplicated",
            "both",
            "fault",
            _one("share", "1", 0.01),
            "samples that repeat the one before in all six channels",
        ),
        Disturbance(
            "clock_irregular",
            "both",
            "fault",
            _one("jitter", "s", 1e-3),
            "time stamps that do not advance evenly, or a rate that they contradict",
        ),
        Disturbance(
            "rest_not_still",
            "stand",
            "fault",
            _one("tremor", "rad", 1e-3),
            "scatter or drift within a rest beyond the sensors' noise",
        ),
        Disturbance(
            "mount_slip",
            "stand",
            "fault",
            _one("angle", "rad", DEGREE),
            "a step between the unit's attitude and the stand's angles that stays",
        ),
    )
