"""A plan: a motion and its predicted accuracy, with summary and tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.planning.groups import GROUPS, PlannedParameter
from imucal.rig.motion import Motion, Program
from imucal.units import units_of

__all__ = ["Plan", "headline", "worst_rows"]

# Factor and unit in which standard deviations are shown.
READ_IN: Final = {"1": "ppm", "m/s^2": "ug"}


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion and its predicted accuracy.

    kind              "optimal", "random", "grid", "tumble" or "program"
    motion            the motion; `program` gives it as a program of a stand
    minutes           duration on the stand
    moves, rests      their numbers, without rests that are too short to be found
    parameters        the 21 parameters, then those of the requested effects
    worst             largest standard deviation of each group, {"accel_bias": {value, unit}, ...}; None if
                      a parameter of the group is not determined
    targets           targets by group, SI units
    reached           whether all targets and the permitted duration are kept
    detection_limits  by effect: the smallest size that `imucal gap` would find with 90 % probability
    not_observable    effects that such a run cannot show: {name, needs}
    undetermined      text on parameters that are not determined and what would determine them; None if all
    are
    comparison        the paper's programs with this unit: {name, minutes, worst} of each, and of both
    notes             errors that the prediction does not include
    """

    kind: str
    motion: Motion
    minutes: float
    moves: int
    rests: int
    parameters: tuple[PlannedParameter, ...]
    worst: Mapping[str, Any]
    targets: Mapping[str, float]
    reached: bool
    detection_limits: Mapping[str, Mapping[str, Any]]
    not_observable: tuple[Mapping[str, str], ...]
    undetermined: str | None
    comparison: tuple[Mapping[str, Any], ...]
    notes: tuple[str, ...]
    unit: str
    seed: int

    @property
    def program(self) -> Program:
        """The program of the stand; InputError for a motion without a program."""
        if not isinstance(self.motion, Program):
            raise InputError(f"a {self.kind} is no program of a stand: plan grid, random or optimal")
        return self.motion

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal plan --json` (schema imucal.plan/1)."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del fields["motion"]
        program = self.motion.to_dict() if isinstance(self.motion, Program) else None
        document: dict[str, Any] = without_nan({"schema": "imucal.plan/1", **fields, "program": program})
        return document

    def summary(self) -> str:
        """A summary: duration, the worst standard deviation of each group, and undetermined parameters."""
        return _summary(self)


def headline(plan: Plan) -> str:
    """Duration, moves and rests."""
    return (
        f"{plan.kind}: {plan.minutes:.2f} min, {plan.moves} moves, {plan.rests} rests, "
        f"for the noise of the unit {plan.unit}"
    )


def shown(size: Mapping[str, Any] | None) -> str:
    """A standard deviation with its unit."""
    if size is None:
        return "not determined"
    unit = READ_IN.get(size["unit"], size["unit"])
    return f"{size['value'] / units_of(size['unit'])[unit]:.3g} {unit}"


def worst_rows(plan: Plan) -> list[list[str]]:
    """Worst standard deviation of each group, for this plan and for the paper's programs."""
    rows = [["this plan", f"{plan.minutes:.2f}", *(shown(plan.worst[group]) for group in GROUPS)]]
    for row in plan.comparison:
        rows.append([row["name"], f"{row['minutes']:.2f}", *(shown(row["worst"][group]) for group in GROUPS)])
    return rows


def _summary(plan: Plan) -> str:
    """The summary, several lines."""
    lines = [headline(plan)]
    for group, size in plan.worst.items():
        target = plan.targets.get(group)
        of = "" if target is None or size is None else f" (target: {shown({**size, 'value': target})})"
        lines.append(f"  worst {group}: {shown(size)}{of}")
    if not plan.reached:
        lines.append("  targets not reached")
    if plan.undetermined is not None:
        lines.append(f"  not determined: {plan.undetermined}")
    lines += [f"  {note}" for note in plan.notes]
    return "\n".join(lines)
