"""How long the shortest programs take, and worst standard deviations over minutes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import imucal
from imucal.planning.groups import GROUPS
from plan.agreement import COARSE, FINE, planned

PROPOSALS = 12_000
SEEDS = (1, 2, 3)
# Of grid programs: steps of the motors, deg; of random ones: moves; of optimal ones: minutes.
STEPS_DEG = (60.0, 45.0, 36.0, 30.0, 22.5, 20.0)
MOVES = (8, 15, 25, 45, 90, 160)
MINUTES = (0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 19.0)


@dataclass(frozen=True)
class Duration:
    """Programs that reach some targets, one for each seed."""

    name: str
    plans: tuple[imucal.Plan, ...]

    @property
    def minutes(self) -> list[float]:
        return sorted(plan.minutes for plan in self.plans)

    @property
    def best(self) -> imucal.Plan:
        return min(self.plans, key=lambda plan: plan.minutes)


@dataclass(frozen=True)
class Point:
    """A program in the curve."""

    family: str
    minutes: float
    worst: dict[str, float | None]


def durations() -> list[Duration]:
    """Coarse and fine targets on the paper's stand, and coarse ones on others."""
    motor = imucal.AxisLimits()
    slower = dataclasses.replace(motor, max_rate_dps=90.0)
    weaker = dataclasses.replace(motor, max_acceleration_dps2=240.0)
    stands: dict[str, tuple[dict[str, float | str], imucal.StandLimits | str]] = {
        "coarse": (COARSE, "paper"),
        "fine": (FINE, "paper"),
        "coarse, peak rate 120 deg/s": (COARSE, imucal.StandLimits((slower, slower, slower))),
        "coarse, half the acceleration": (COARSE, imucal.StandLimits((weaker, weaker, weaker))),
        "coarse, 0.5 s to settle": (COARSE, imucal.StandLimits(settle_s=0.5)),
        "coarse, two-axis stand": (COARSE, "two-axis"),
    }
    return [
        Duration(
            name,
            tuple(
                planned("optimal", targets=targets, stand=stand, seed=seed, proposals=PROPOSALS)
                for seed in SEEDS
            ),
        )
        for name, (targets, stand) in stands.items()
    ]


def curve() -> list[Point]:
    """Worst standard deviations of programs of all lengths."""
    return [
        *(_point("grid", planned("grid", options={"step_deg": step})) for step in STEPS_DEG),
        *(_point("random", planned("random", options={"moves": moves})) for moves in MOVES),
        *(_point("optimal", planned("optimal", minutes=minutes)) for minutes in MINUTES),
    ]


def _point(family: str, plan: imucal.Plan) -> Point:
    worst = {group: plan.worst[group] for group in GROUPS}
    # The grid alone does not determine the gyroscope's cross entries.
    known = {
        group: None if size is None or (family == "grid" and group == "gyro_sensitivity") else size.value
        for group, size in worst.items()
    }
    return Point(family, plan.minutes, known)


def visible(durations: list[Duration]) -> dict[str, dict[str, float]]:
    """Detection limits of the catalogue, by program."""
    coarse, fine = (next(d for d in durations if d.name == name).best for name in ("coarse", "fine"))
    found = {}
    for name, motion in (
        ("random", imucal.Program.random(seed=1)),
        ("optimal, coarse", coarse.motion),
        ("optimal, fine", fine.motion),
    ):
        limits = imucal.plan(motion).detection_limits
        found[f"{name}, {planned(motion).minutes:.1f} min"] = {n: limit.value for n, limit in limits.items()}
    both = [imucal.Program.grid(), imucal.Program.random(seed=1)]
    records = [imucal.simulate(motion, seed=seed).recording for seed, motion in enumerate(both)]
    gap = imucal.find_gap(records, control=imucal.simulate("random", seed=7).recording)
    minutes = sum(planned(motion).minutes for motion in both)
    found[f"grid and random, {minutes:.1f} min"] = {
        n: limit["value"] for n, limit in gap.smallest_visible.items()
    }
    return found
