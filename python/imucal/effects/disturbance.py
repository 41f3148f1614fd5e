"""Disturbances: coloured noise, and faults of the data or of the stand.

Unlike an effect, a disturbance is not a function of the true state of the unit. A simulation can include
disturbances, and a search for missing effects can report them. Disturbances cannot be compensated, so they
are not part of a calibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Disturbance", "DisturbanceParameter", "disturbances"]

DEGREE: Final = math.radians(1.0)


@dataclass(frozen=True)
class DisturbanceParameter:
    """A parameter for the size of a disturbance, with its SI unit and its typical size."""

    name: str
    unit: str
    typical: float


@dataclass(frozen=True)
class Disturbance:
    """A noise process or a fault.

    sensor     "accelerometer", "gyroscope", "both", or "stand"
    kind       "noise" or "fault"
    looks_for  how the disturbance appears in the data
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
    """All noise processes and faults, with typical sizes for MEMS sensors and a cheap stand."""
    return (
        Disturbance(
            "gyro_bias_random_walk",
            sensor="gyroscope",
            kind="noise",
            parameters=_axes("rad/s/s/sqrt(Hz)", 1e-3 * DEGREE),
            looks_for="a bias that changes randomly from rest to rest, more over longer intervals",
        ),
        Disturbance(
            "accel_bias_random_walk",
            sensor="accelerometer",
            kind="noise",
            parameters=_axes("m/s^2/s/sqrt(Hz)", 2e-5 * STANDARD_GRAVITY_MPS2),
            looks_for="a bias that changes randomly from rest to rest, more over longer intervals",
        ),
        Disturbance(
            "noise_grows_in_motion",
            sensor="both",
            kind="fault",
            parameters=_one("factor", "1", 2.0),
            looks_for="more high-frequency noise during moves than at rest",
        ),
        Disturbance(
            "gyro_saturation",
            sensor="gyroscope",
            kind="fault",
            parameters=_one("range", "rad/s", 250 * DEGREE),
            looks_for="repeated samples at one maximum or minimum value",
        ),
        Disturbance(
            "accel_saturation",
            sensor="accelerometer",
            kind="fault",
            parameters=_one("range", "m/s^2", 2 * STANDARD_GRAVITY_MPS2),
            looks_for="repeated samples at one maximum or minimum value",
        ),
        Disturbance(
            "samples_missing",
            sensor="both",
            kind="fault",
            parameters=_one("share", "1", 0.01),
            looks_for="time steps that are a multiple of the usual step",
        ),
        Disturbance(
            "samples_duplicated",
            sensor="both",
            kind="fault",
            parameters=_one("share", "1", 0.01),
            looks_for="samples that equal the previous one in all six channels",
        ),
        Disturbance(
            "clock_irregular",
            sensor="both",
            kind="fault",
            parameters=_one("jitter", "s", 1e-3),
            looks_for="irregular time stamps, or time stamps that contradict the sampling rate",
        ),
        Disturbance(
            "rest_not_still",
            sensor="stand",
            kind="fault",
            parameters=_one("tremor", "rad", 1e-3),
            looks_for="scatter or drift within a rest that exceeds the sensor noise",
        ),
        Disturbance(
            "mount_slip",
            sensor="stand",
            kind="fault",
            parameters=_one("angle", "rad", DEGREE),
            looks_for="a lasting step between the attitude of the unit and the angles of the stand",
        ),
    )
