"""A plan: a motion, the predicted standard deviations, and their text and tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.estimation.inspection import only_moves_determine
from imucal.planning.groups import GROUPS, PlannedParameter, Size
from imucal.rig.motion import Motion, Program
from imucal.units import units_of

__all__ = ["ROUNDING", "Plan", "headline", "is_within", "not_reached", "worst_rows"]

# A target counts as met if the standard deviation is at most the target times this factor. The duration of a
# plan may be at most the allowed duration times this factor. The factor allows for rounding errors.
ROUNDING: Final = 1.001
# SI units that the text of a plan does not show, each with the unit that it shows instead.
SHOWN_IN: Final = {"1": "ppm", "m/s^2": "ug"}


@dataclass(frozen=True, slots=True)
class NotObservable:
    """An effect that is not observable in a run, and the data in which it would be observable."""

    name: str
    needs: str


@dataclass(frozen=True, slots=True)
class ComparedProgram:
    """A program of the paper cited in docs/model.md: duration, largest standard deviation of each group."""

    name: str
    minutes: float
    worst: Mapping[str, Size | None]


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion and the predicted standard deviations of a calibration from it.

    kind              "optimal", "random", "grid", "faces", "tumble" or "program"
    motion            the motion; the property `program` returns it if a stand can run it
    minutes           duration on the stand
    moves, rests      numbers of moves and rests, without rests that are too short to be detected
    parameters        the 21 parameters, then those of the requested effects
    worst             largest standard deviation of each group; None if a parameter of the group is not
                      determined
    targets           requested standard deviations by group, SI units
    reached           whether all targets and the allowed duration are met
    allowed_minutes   the allowed duration on the stand; None without a limit
    detection_limits  for each effect, the smallest size that `imucal gap` would detect with 90 % probability
    not_observable    effects that are not observable in a run with this motion
    undetermined      the parameters that the motion does not determine, and the motion to add; None if the
                      motion determines all parameters
    through_moves     names of the parameters that only the moves determine. The directions of gravity at the
                      rests, such as those on the six faces of a box, are not sufficient for them
    comparison        the programs grid and random with this unit: each program alone, and both together
    notes             errors that the predicted standard deviations do not include, as text
    """

    kind: str
    motion: Motion
    minutes: float
    moves: int
    rests: int
    parameters: tuple[PlannedParameter, ...]
    worst: Mapping[str, Size | None]
    targets: Mapping[str, float]
    reached: bool
    allowed_minutes: float | None
    detection_limits: Mapping[str, Size]
    not_observable: tuple[NotObservable, ...]
    undetermined: str | None
    through_moves: tuple[str, ...]
    comparison: tuple[ComparedProgram, ...]
    notes: tuple[str, ...]
    unit: str
    seed: int

    @property
    def program(self) -> Program:
        """The program for a stand. Raises InputError for a motion without one, such as a tumble by hand."""
        if not isinstance(self.motion, Program):
            raise InputError(
                f"the motion {self.kind} has no program for a stand: use grid, random, faces or optimal"
            )
        return self.motion

    def to_dict(self) -> dict[str, Any]:
        """The plan as the JSON document of `imucal plan --json` (schema imucal.plan/1)."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del fields["motion"]
        program = self.motion.to_dict() if isinstance(self.motion, Program) else None
        document: dict[str, Any] = without_nan({"schema": "imucal.plan/1", **fields, "program": program})
        return document

    def summary(self) -> str:
        """Plain text: duration, largest standard deviation in each group of parameters, motions to add."""
        return _summary(self)


def headline(plan: Plan) -> str:
    """One line: duration of the motion, numbers of moves and rests, and the unit whose noise is assumed."""
    return (
        f"{plan.kind}: {plan.minutes:.2f} min, {plan.moves} moves, {plan.rests} rests, "
        f"for the noise of the unit {plan.unit}"
    )


def is_within(plan: Plan) -> bool:
    """Whether the plan takes no longer than allowed."""
    return plan.allowed_minutes is None or plan.minutes <= plan.allowed_minutes * ROUNDING


def not_reached(plan: Plan) -> str:
    """Text for a plan that misses a target or the allowed duration: what it misses, and what to change."""
    relax = "allow more time (--minutes), or relax the targets (--target)"
    if is_within(plan):
        return f"targets not reached: {relax}"
    duration = f"the program takes {plan.minutes:.2f} min, and {plan.allowed_minutes:g} min are allowed"
    if not plan.targets:
        return f"{duration}: allow more time (--minutes), or plan a shorter program"
    return f"targets not reached in time: {duration}: {relax}"


def shown(size: Size | None) -> str:
    """A standard deviation as text with its unit; "not determined" if it is None."""
    if size is None:
        return "not determined"
    unit = SHOWN_IN.get(size.unit, size.unit)
    return f"{size.value / units_of(size.unit)[unit]:.3g} {unit}"


def worst_rows(plan: Plan) -> list[list[str]]:
    """Table rows for this plan and the compared programs: name, minutes, largest std of each group."""
    rows = [["this plan", f"{plan.minutes:.2f}", *(shown(plan.worst[group]) for group in GROUPS)]]
    for row in plan.comparison:
        rows.append([row.name, f"{row.minutes:.2f}", *(shown(row.worst[group]) for group in GROUPS)])
    return rows


def _summary(plan: Plan) -> str:
    """The plan as text: duration, largest standard deviation of each group, missed targets, and notes."""
    lines = [headline(plan)]
    for group, size in plan.worst.items():
        wish = plan.targets.get(group)
        wished = "" if wish is None or size is None else f" (target: {shown(Size(wish, size.unit))})"
        lines.append(f"  worst {group}: {shown(size)}{wished}")
    if not plan.reached:
        lines.append(f"  {not_reached(plan)}")
    if plan.undetermined is not None:
        lines.append(f"  not determined: {plan.undetermined}")
    elif plan.through_moves:
        lines.append(f"  {only_moves_determine(plan.through_moves)}")
    lines += [f"  {note}" for note in plan.notes]
    return "\n".join(lines)
