"""A plan in words, and its tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from imucal.planning.targets import GROUPS
from imucal.units import units_of

if TYPE_CHECKING:
    from imucal.planning.plan import Plan

__all__ = ["headline", "summary", "worst_rows"]

# How people say sizes of this kind.
READ_IN: Final = {"1": "ppm", "m/s^2": "ug"}


def headline(plan: Plan) -> str:
    """Time, moves and rests."""
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
    """Worst standard deviation of each group: of this plan, and of the paper's programs."""
    rows = [["this plan", f"{plan.minutes:.2f}", *(shown(plan.worst[group]) for group in GROUPS)]]
    for row in plan.comparison:
        rows.append([row["name"], f"{row['minutes']:.2f}", *(shown(row["worst"][group]) for group in GROUPS)])
    return rows


def summary(plan: Plan) -> str:
    """A few lines."""
    lines = [headline(plan)]
    for group, size in plan.worst.items():
        wish = plan.targets.get(group)
        wished = "" if wish is None or size is None else f" (wished: {shown({**size, 'value': wish})})"
        lines.append(f"  worst {group}: {shown(size)}{wished}")
    if not plan.reached:
        lines.append("  what was wished for is not reached")
    if plan.undetermined is not None:
        lines.append(f"  not determined: {plan.undetermined}")
    lines += [f"  {note}" for note in plan.notes]
    return "\n".join(lines)
