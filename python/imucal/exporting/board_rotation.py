"""Rotations from the sensor to the body of a flight controller, as ArduPilot numbers them (AHRS_ORIENTATION).

    v_body = R v_sensor,  R = Rz(yaw) Ry(pitch) Rx(roll)

v is any vector, and Rx, Ry and Rz are the rotations about the axes.

Source: enum Rotation in AP_Math/rotations.h and Vector3::rotate in AP_Math/vector3.cpp. MAVLink uses the same
numbers (MAV_SENSOR_ORIENTATION).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError

__all__ = ["board_rotation"]

# Roll, pitch and yaw, deg, of each orientation. The index in this list is the value of AHRS_ORIENTATION.
ORIENTATIONS: Final = (
    *((0, 0, yaw) for yaw in range(0, 360, 45)),
    *((180, 0, yaw) for yaw in (0, 45, 90, 135)),
    (0, 180, 0),
    *((180, 0, yaw) for yaw in (225, 270, 315)),
    *((90, 0, yaw) for yaw in (0, 45, 90, 135)),
    *((270, 0, yaw) for yaw in (0, 45, 90, 135)),
    (0, 90, 0),
    (0, 270, 0),
    (0, 180, 90),
    (0, 180, 270),
    *((roll, 90, 0) for roll in (90, 180, 270)),
    *((roll, 180, 0) for roll in (90, 270)),
    *((roll, 270, 0) for roll in (90, 180, 270)),
    (90, 180, 90),
    (90, 0, 270),
    (90, 68.8, 293.3),
    (0, 315, 0),
    (90, 315, 0),
    (0, 7, 0),
    (45, 0, 0),
    (315, 0, 0),
)


def board_rotation(orientation: int | str) -> FloatArray:
    """The rotation matrix (3, 3) for a value of AHRS_ORIENTATION, or for angles "ROLL,PITCH,YAW" in deg.

    Raises InputError for anything else.
    """
    words = str(orientation).split(",")
    try:
        angles = ORIENTATIONS[_number(words[0])] if len(words) == 1 else tuple(map(float, words))
    except (ValueError, IndexError):
        angles = ()
    if len(angles) != 3 or not np.isfinite(angles).all():
        raise InputError(
            f"board_orientation is {orientation!r}: give AHRS_ORIENTATION as a number from 0 to "
            f"{len(ORIENTATIONS) - 1}, or the three angles ROLL,PITCH,YAW in deg (CUST_ROT1_ROLL, ...)"
        )
    roll, pitch, yaw = angles
    return _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)


def _number(word: str) -> int:
    if not word.strip().isdecimal():
        raise ValueError
    return int(word)


def _turn(axis: int, angle_deg: float) -> FloatArray:
    """The matrix of a rotation about one axis, exact for multiples of 90 deg."""
    quarter, rest = divmod(angle_deg, 90.0)
    if rest == 0:
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[int(quarter) % 4]
    else:
        cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = cosine
    matrix[i, j], matrix[j, i] = -sine, sine
    return matrix
