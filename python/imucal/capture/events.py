"""Events of a guided recording, and the state of the recording for the display in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from imucal.arrays import FloatArray

__all__ = ["Event", "Kind", "Pose", "Row", "Snapshot"]

Kind: TypeAlias = Literal["next", "hold", "taken", "refused", "warning", "info", "finished"]


@dataclass(frozen=True)
class Event:
    """A message to the person who holds the unit.

    time_s  time since the first sample, s, by the time stamps of the samples
    kind    next (pose to rotate to), hold (the unit is still, and its hold time is counted), taken (the pose
            counts), refused (the pose does not count), warning (a fault of the data), info, finished
    code    stable identifier, such as moved_too_early or a finding code
    """

    time_s: float
    kind: Kind
    code: str
    text: str


@dataclass(frozen=True, eq=False)
class Pose:
    """A recorded pose: number from 1, start and end of its rest, s, up direction in the body frame, (3,)."""

    number: int
    start_s: float
    end_s: float
    up: FloatArray


@dataclass(frozen=True)
class Row:
    """A row of the table of predicted accuracies, as text.

    group           name of a group of parameters
    before, after   largest predicted standard deviation of the group before and after the last pose
    target          largest permitted standard deviation; empty without a target
    """

    group: str
    before: str
    after: str
    target: str = ""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of a recording for the views.

    state       waiting (for the unit to be still in a new pose), holding, taken (the person rotates to the
                next pose), finished
    request     pose to hold next, in words
    attitude    attitude of the unit in the requested pose, body to world, (3, 3); None without a request
    held_s      time for which the current pose has been held, s; the required time is `hold_s`
    steadiness  0 (moving) to 1 (steady enough to count as a rest)
    poses       number of poses that count; the required number is `wanted`
    rows        predicted standard deviations of the calibration, by group of parameters
    missing     description of the motion that is still missing; None if the recording determines all
                parameters
    """

    state: Literal["waiting", "holding", "taken", "finished"] = "waiting"
    request: str = ""
    attitude: FloatArray | None = None
    held_s: float = 0.0
    hold_s: float = 0.0
    steadiness: float = 0.0
    poses: int = 0
    wanted: int = 0
    rows: Sequence[Row] = field(default_factory=tuple)
    missing: str | None = None
    time_s: float = 0.0
    samples: int = 0
