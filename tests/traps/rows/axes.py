"""Traps of axes and signs: mirrored, reversed and exchanged columns, z down, and the sign of gravity."""

import itertools

import numpy as np

from changes import changed, stand_run, truth_of
from recordings import calibrating
from trap import good, incomplete, refused

PAIRS = tuple(itertools.combinations(range(3), 2))


def reversed_axes(*axes):
    """The matrix that reverses these axes."""
    return np.diag([-1.0 if axis in axes else 1.0 for axis in range(3)])


def exchanged(one, other):
    """The matrix that exchanges two axes."""
    matrix = np.eye(3)
    matrix[[one, other]] = matrix[[other, one]]
    return matrix


def columns(accel, gyro, stand=False):
    """The recording with these matrices applied to the columns of its sensors."""

    def change(r):
        angles = {"stand_rad": r.stand_rad} if stand else {}
        return changed(
            r, specific_force=r.specific_force @ accel.T, angular_rate=r.angular_rate @ gyro.T, **angles
        )

    return change


def truth_along(matrix):
    """The true parameters of the simulated unit, along other axes of the body and of both sensors."""
    unit = stand_run().truth.calibration
    truth = truth_of(stand_run())
    for sensor, triad in (("accel", unit.accelerometer), ("gyro", unit.gyroscope)):
        sensitivity, bias = matrix @ triad.sensitivity @ matrix.T, matrix @ triad.bias
        for i, j in itertools.product(range(3), repeat=2):
            name = f"{sensor}_sensitivity_{'xyz'[i]}{'xyz'[j]}"
            truth |= {name: float(sensitivity[i, j])} if name in truth else {}
        truth |= {f"{sensor}_bias_{'xyz'[i]}": float(bias[i]) for i in range(3)}
    return truth


SAME = np.eye(3)

MIRRORED = tuple(
    calibrating(
        "both sensors are mirrored",
        name,
        columns(matrix, matrix),
        refused("two causes fit.*both sensors are mirrored"),
    )
    for name, matrix in (
        *((f"{'xyz'[i]} and {'xyz'[j]} exchanged", exchanged(i, j)) for i, j in PAIRS),
        *((f"{'xyz'[i]} reversed", reversed_axes(i)) for i in range(3)),
    )
)

GYROSCOPE = tuple(
    calibrating("the gyroscope's axes are wrong", name, columns(SAME, matrix), refused("left_handed_axes"))
    for name, matrix in (
        *((f"{'xyz'[i]} reversed", reversed_axes(i)) for i in range(3)),
        *((f"{'xyz'[i]} and {'xyz'[j]} exchanged", exchanged(i, j)) for i, j in PAIRS),
        ("all reversed", -SAME),
    )
)

ACCELEROMETER = tuple(
    calibrating(
        "the accelerometer's axes are wrong", name, columns(matrix, SAME), refused("left_handed_axes")
    )
    for name, matrix in (
        *((f"{'xyz'[i]} reversed", reversed_axes(i)) for i in range(3)),
        *((f"{'xyz'[i]} and {'xyz'[j]} exchanged", exchanged(i, j)) for i, j in PAIRS),
    )
)

FRD = reversed_axes(1, 2)
GRAVITY = (
    calibrating(
        "z points down",
        "FRD",
        columns(FRD, FRD),
        good("gravity_sign.*frd"),
        incomplete("gravity_sign.*frd"),
        truth=truth_along(FRD),
    ),
    calibrating(
        "z points down",
        "FRD with stand angles",
        columns(FRD, FRD, stand=True),
        good("motor angles show axes with z down"),
        refused("axes"),
        truth=truth_along(FRD),
    ),
    calibrating(
        "z points down",
        "NED, x and y exchanged and z reversed",
        columns(exchanged(0, 1) @ reversed_axes(2), exchanged(0, 1) @ reversed_axes(2)),
        good("gravity_sign"),
        incomplete("gravity_sign"),
        truth=truth_along(exchanged(0, 1) @ reversed_axes(2)),
    ),
    calibrating(
        "the sign of gravity is reversed",
        "with stand angles",
        columns(-SAME, SAME, stand=True),
        refused("motor angles show that the accelerometer reads -g"),
    ),
)

TRAPS = (*MIRRORED, *GYROSCOPE, *ACCELEROMETER, *GRAVITY)
