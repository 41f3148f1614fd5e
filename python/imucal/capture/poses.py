"""Poses to hold by hand: their order and their descriptions.

A pose is defined by the up direction, a unit vector in the axes of the sensor. The rotation about the
vertical is arbitrary, because gravity does not depend on it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["angle_deg", "attitude_with", "next_pose", "pose_words", "standard_poses", "turn_words"]

# Two rests are the same pose if their up directions differ by less than this angle, deg. The closest up
# directions of the standard poses, those of an edge and a corner of a box, differ by 35 deg.
SAME_DEG: Final = 20.0
# A requested pose counts as held if the up direction of the unit is within this angle of the requested up
# direction, deg.
NEAR_DEG: Final = 30.0
# A pose within this angle of the current pose, deg, is requested only after all other poses, because small
# rotations determine the gyroscope's sensitivity less accurately.
SHORT_TURN_DEG: Final = 60.0
# The six faces of a box, as up directions. Consecutive faces differ by a rotation of 90 deg, and the axis
# changes from each rotation to the next.
FACES: Final = ((0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, -1), (-1, 0, 0), (0, -1, 0))
# The description of a pose, such as `+x and -z up`, names an axis if the component of the up direction along
# this axis has at least this magnitude.
NAMED_SHARE: Final = 0.3


def standard_poses() -> list[FloatArray]:
    """The six faces of a box, then its twelve edges and eight corners (26 unit vectors)."""
    grid = [np.array(ends, dtype=np.float64) for ends in itertools.product((1, 0, -1), repeat=3) if any(ends)]
    edges = [ends for ends in grid if np.abs(ends).sum() == 2]
    corners = [ends for ends in grid if np.abs(ends).sum() == 3]
    ordered = [np.array(face, dtype=np.float64) for face in FACES]
    for group in (edges, corners):
        left = list(group)
        while left:
            # The next pose is the one farthest from the previous two, which gives long rotations about
            # changing axes.
            near = [max(float(pose @ before) for before in ordered[-2:]) for pose in left]
            ordered.append(left.pop(int(np.argmin(near))))
    return [pose / np.linalg.norm(pose) for pose in ordered]


def next_pose(poses: Sequence[FloatArray], is_held: Sequence[bool], current: FloatArray | None) -> int | None:
    """Index of the pose to request next; None if all poses were held."""
    left = [number for number, held in enumerate(is_held) if not held]
    if not left or current is None:
        return left[0] if left else None
    far = [number for number in left if angle_deg(poses[number], current) >= SHORT_TURN_DEG]
    return (far or left)[0]


def pose_words(up: FloatArray) -> str:
    """Description of a pose: `+x up`, or `+x and -z up, on an edge`."""
    named = [i for i in np.argsort(-np.abs(up), kind="stable") if abs(up[i]) >= NAMED_SHARE]
    names = [f"{'+' if up[i] > 0 else '-'}{'xyz'[i]}" for i in sorted(named)]
    if len(names) == 1:
        return f"{names[0]} up"
    place = "an edge" if len(names) == 2 else "a corner"
    return f"{', '.join(names[:-1])} and {names[-1]} up, on {place}"


def turn_words(current: FloatArray, following: FloatArray) -> str:
    """The rotation from one pose to another: `by 90 deg about the y axis`."""
    angle = angle_deg(current, following)
    axis = np.cross(current, following)
    size = float(np.linalg.norm(axis))
    if size < 1e-6:
        return f"by {angle:.0f} deg"
    main = int(np.argmax(np.abs(axis)))
    # The rotation axis is named only if it is close to an axis of the sensor.
    about = f" about the {'xyz'[main]} axis" if abs(axis[main]) > 0.9 * size else ""
    return f"by {angle:.0f} deg{about}"


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Angle between two vectors, deg."""
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-30)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def attitude_with(up: FloatArray, before: FloatArray) -> FloatArray:
    """The attitude, body to world, that is nearest to `before` and has the up direction `up`."""
    raised = before @ up
    axis = np.array([raised[1], -raised[0], 0.0])
    sine, cosine = float(np.linalg.norm(axis)), float(raised[2])
    if sine < 1e-9:
        flip = np.diag([1.0, 1.0, 1.0]) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
        upside: FloatArray = flip @ before
        return upside
    x, y, _ = axis / sine
    k = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    turned: FloatArray = (np.eye(3) + sine * k + (1.0 - cosine) * (k @ k)) @ before
    return turned
