"""Limits of a stand: ranges, rates and accelerations of its motors, and forbidden zones.

The limits come from a file (schema imucal.stand-limits/1, JSON Schema in the package) or from `NAMED`: the
stand of the paper that docs/model.md cites, stands with fewer motors, and a hand.
"""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from typing import Any, Final

from imucal.document.agreement import require_fields
from imucal.document.json_document import Node, read_json, write_json
from imucal.errors import FormatError, InputError
from imucal.rig.program_bounds import (
    MAX_ACCELERATION_DPS2,
    MAX_ANGLE_DEG,
    MAX_DURATION_S,
    MAX_RATE_DPS,
    MAX_STEP_S,
)

__all__ = ["NAMED", "AxisLimits", "StandLimits", "stand_limits_of"]

SCHEMA: Final = "imucal.stand-limits/1"
AXES: Final = ("axis_1", "axis_2", "axis_3")
AXIS_FIELDS: Final = ("max_rate_dps", "max_acceleration_dps2", "range_deg", "cable_wrap_deg")
FIELDS: Final = ("schema", "description", "axes", "settle_s", "min_rest_s", "minutes", "forbidden_deg")
# Largest accepted value of each limit of a stand: the largest rate, acceleration, angle or duration with
# which a program is accepted (`program_bounds`).
LARGEST: Final = {
    "max_rate_dps": MAX_RATE_DPS,
    "max_acceleration_dps2": MAX_ACCELERATION_DPS2,
    "cable_wrap_deg": MAX_ANGLE_DEG,
    "settle_s": MAX_STEP_S,
    "min_rest_s": MAX_STEP_S,
    "minutes": MAX_DURATION_S / 60.0,
}
# Largest rate, deg/s, and acceleration, deg/s^2, of the stand in the paper that docs/model.md cites. The
# paper does not state the acceleration. The value here is the acceleration in the random program of the
# paper, in which a motor rotates by up to 240 deg in 2 s.
PAPER_DPS: Final = 120.0
PAPER_DPS2: Final = 480.0

Range = tuple[float, float]


@dataclass(frozen=True)
class AxisLimits:
    """Limits of one motor.

    max_rate_dps           maximum of the mean rate over a rotation; the peak rate is 4/3 of the mean rate
    max_acceleration_dps2  maximum acceleration
    range_deg              end stops, relative to the start of a program; None if there are none
    cable_wrap_deg         angle by which the cable may wind up in either direction; None for slip rings
    """

    max_rate_dps: float = PAPER_DPS
    max_acceleration_dps2: float = PAPER_DPS2
    range_deg: Range | None = None
    cable_wrap_deg: float | None = None

    def in_si(self) -> tuple[float, float, list[float] | None]:
        """Maximum rate and acceleration, and range, with angles in rad, for the compiled library."""
        low, high = self.range_deg or (-math.inf, math.inf)
        wrap = math.inf if self.cable_wrap_deg is None else self.cable_wrap_deg
        low, high = max(low, -wrap), min(high, wrap)
        is_bounded = math.isfinite(low) or math.isfinite(high)
        return (
            math.radians(self.max_rate_dps),
            math.radians(self.max_acceleration_dps2),
            [math.radians(low), math.radians(high)] if is_bounded else None,
        )


@dataclass(frozen=True)
class StandLimits:
    """Limits of a stand or of a hand.

    axes           the three motors, outermost first; None for a motor that does not exist
    settle_s       duration of the vibration after a rotation, s; rests are extended by this time
    min_rest_s     minimum duration of a rest, s
    minutes        maximum duration of a program, or None
    forbidden_deg  forbidden zones of the motor angles, modulo full revolutions. A zone has one interval per
                   motor, or None if it contains all angles of the motor
    in_hand        whether the unit is hand-held instead of on a stand, with tremor and poses in steps of 45
                   deg
    """

    axes: tuple[AxisLimits | None, AxisLimits | None, AxisLimits | None] = (
        AxisLimits(),
        AxisLimits(),
        AxisLimits(),
    )
    settle_s: float = 0.0
    min_rest_s: float = 1.0
    minutes: float | None = None
    forbidden_deg: tuple[tuple[Range | None, Range | None, Range | None], ...] = ()
    in_hand: bool = False

    @staticmethod
    def read(path: str | os.PathLike[str]) -> StandLimits:
        """Read a file of stand limits; FormatError names the invalid field."""
        node = read_json(path)
        node.require_schema(SCHEMA)
        require_fields(node, FIELDS, "a file of stand limits")
        given = node.mapping()
        numbers: dict[str, Any] = {
            name: _number(node.get(name), most, zero=True)
            for name, most in LARGEST.items()
            if name not in AXIS_FIELDS and given.get(name) is not None
        }
        if "description" in given:
            node.get("description").text()
        first, second, third = _three(node.get("axes"), _axis)
        zones = node.get("forbidden_deg").items() if "forbidden_deg" in given else []
        for zone in zones:
            _require_free_start(zone)
        return StandLimits((first, second, third), **numbers, forbidden_deg=tuple(map(_zone, zones)))

    def write(self, path: str | os.PathLike[str], *, description: str = "") -> None:
        """Write the file, atomically. Raises InputError for the limits of a hand, which have no file form."""
        if self.in_hand:
            raise InputError(
                "the limits of a hand are not written to a file: pass the name hand instead of a file"
            )
        zones = [
            {axis: list(span) for axis, span in zip(AXES, zone, strict=True) if span is not None}
            for zone in self.forbidden_deg
        ]
        document = {
            "schema": SCHEMA,
            "description": description,
            "axes": [None if axis is None else dataclasses.asdict(axis) for axis in self.axes],
            "settle_s": self.settle_s,
            "min_rest_s": self.min_rest_s,
            "minutes": self.minutes,
            "forbidden_deg": zones,
        }
        write_json(document, path)

    @property
    def axis_count(self) -> int:
        """The number of motors."""
        return sum(axis is not None for axis in self.axes)

    def in_si(self) -> CoreLimits:
        """The limits as the compiled library reads them."""
        to_rad = math.radians
        forbidden = tuple(
            tuple(None if span is None else [to_rad(span[0]), to_rad(span[1])] for span in zone)
            for zone in self.forbidden_deg
        )
        return CoreLimits(
            axes=tuple(None if axis is None else axis.in_si() for axis in self.axes),
            settle_s=self.settle_s,
            min_rest_s=self.min_rest_s,
            min_move_s=HAND_MOVE_S if self.in_hand else 0.0,
            forbidden_rad=forbidden,
            pose_step_rad=to_rad(HAND_STEP_DEG if self.in_hand else STEP_DEG),
            most_moves=HAND_MOVES if self.in_hand else MOST_MOVES,
            in_hand=self.in_hand,
        )


@dataclass(frozen=True)
class CoreLimits:
    """The limits in rad and s, with the field names that the compiled library reads."""

    axes: Any
    settle_s: float
    min_rest_s: float
    min_move_s: float
    forbidden_rad: Any
    pose_step_rad: float
    most_moves: int
    in_hand: bool


# Values for programs on a stand: the motor angles of a pose are multiples of STEP_DEG, deg, and a program has
# at most MOST_MOVES moves.
STEP_DEG: Final = 0.1
MOST_MOVES: Final = 400
# Values for hand-held programs: the angles of a pose are multiples of HAND_STEP_DEG, deg, a move takes at
# least HAND_MOVE_S, s, and a program has at most HAND_MOVES moves. The angle is large enough to distinguish
# the pictures of poses on a card. The duration leaves time to look at the next picture.
HAND_STEP_DEG: Final = 45.0
HAND_MOVE_S: Final = 2.0
HAND_MOVES: Final = 40
_MOTOR: Final = AxisLimits()

NAMED: Final[dict[str, StandLimits]] = {
    "paper": StandLimits(),
    "two-axis": StandLimits((None, _MOTOR, _MOTOR)),
    "one-axis": StandLimits((None, _MOTOR, None)),
    "hand": StandLimits(
        (AxisLimits(90.0, 1e4), AxisLimits(90.0, 1e4), AxisLimits(90.0, 1e4)),
        settle_s=0.5,
        min_rest_s=2.5,
        in_hand=True,
    ),
}


def stand_limits_of(limits: StandLimits | str | os.PathLike[str]) -> StandLimits:
    """The limits for an argument, which is a StandLimits, a name of `NAMED`, or the path of a file."""
    if isinstance(limits, StandLimits):
        return limits
    if isinstance(limits, str) and limits in NAMED:
        return NAMED[limits]
    return StandLimits.read(limits)


def _axis(node: Node) -> AxisLimits | None:
    if node.value is None:
        return None
    require_fields(node, AXIS_FIELDS, "a motor")
    given = node.mapping()
    numbers = {
        name: _number(node.get(name), LARGEST[name])
        for name in AXIS_FIELDS
        if name != "range_deg" and given.get(name) is not None
    }
    span = _span(node.get("range_deg")) if given.get("range_deg") is not None else None
    if span is not None and not span[0] <= 0.0 <= span[1]:
        raise FormatError(
            f"{node.file}: {node.path}.range_deg is {list(span)}: angles count from the start of a program, "
            "so the range must contain 0"
        )
    return AxisLimits(**numbers, range_deg=span)


def _zone(node: Node) -> tuple[Range | None, Range | None, Range | None]:
    require_fields(node, AXES, "a forbidden zone")
    first, second, third = (_span(node.get(axis)) if axis in node.mapping() else None for axis in AXES)
    if first is second is third is None:
        raise FormatError(f"{node.file}: {node.path} has no axis, so the zone would forbid every position")
    return first, second, third


def _require_free_start(node: Node) -> None:
    """Raise FormatError for a forbidden zone that contains the start of every program (all motors at 0)."""
    spans = [span for span in _zone(node) if span is not None]
    if all(math.ceil(low / 360.0) * 360.0 <= high for low, high in spans):
        raise FormatError(
            f"{node.file}: {node.path} contains 0 for every motor, where every program starts: correct it, "
            "or leave it out"
        )


def _span(node: Node) -> Range:
    low, high = node.array(2).tolist()
    for number in (low, high):
        if abs(number) > MAX_ANGLE_DEG:
            raise FormatError(
                f"{node.file}: {node.path} has {number:g}: give angles up to {MAX_ANGLE_DEG:g} deg"
            )
    if not low < high:
        raise FormatError(f"{node.file}: {node.path} is [{low}, {high}]: the lower angle comes first")
    return low, high


def _number(node: Node, most: float, *, zero: bool = False) -> float:
    number = node.number()
    if number > most:
        raise FormatError(f"{node.file}: {node.path} is {number}: give at most {most:g}")
    if number < 0 or (number == 0 and not zero):
        raise FormatError(
            f"{node.file}: {node.path} is {number}, it must be {'zero or more' if zero else 'positive'}"
        )
    return number


def _three(node: Node, of: Any) -> list[Any]:
    items = node.items()
    if len(items) != 3:
        raise FormatError(
            f"{node.file}: {node.path} has {len(items)} items: three are needed, outer motor first, "
            "null where there is none"
        )
    return [of(item) for item in items]
