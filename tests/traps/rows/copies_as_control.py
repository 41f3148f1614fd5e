"""Traps of recordings that are not independent: altered copies as control, and recordings given twice."""

import imucal
from copies import ALTERATIONS, CONTROL_SEEDS, altered, with_knock
from imucal import Program
from recordings import calibrating, same
from trap import good, refused


def another():
    """The same program as that of the calibrated run, with other noise."""
    program = Program.random(seed=1, moves=30, hold_s=2.0)
    return same(imucal.simulate(program, unit="paper", rate_hz=100, seed=2).recording)


COPIES = tuple(
    calibrating(
        "the control recording is a copy",
        alteration,
        same,
        # Values in other units are refused for their units first.
        refused("accel_units" if alteration == "g and deg/s" else "control_not_independent"),
        control=lambda r, alteration=alteration: altered(r, alteration, 1),
    )
    for alteration in ALTERATIONS
)

TOGETHER = tuple(
    calibrating(
        "a recording is given twice",
        alteration,
        lambda r, alteration=alteration: [same(r), altered(r, alteration, 1)],
        refused("recordings_overlap"),
    )
    for alteration in ("half of it", "every second sample", "rounded to 4 decimals", "a gain of 1.001")
)

KNOCKED = tuple(
    calibrating(
        "an independent recording of the same motion",
        f"one knock in each, seed {seed}",
        lambda r, seed=seed: with_knock(r, seed),
        good(),
        control=lambda r, seed=seed: with_knock(another(), seed + CONTROL_SEEDS),
    )
    for seed in (10, 46)
)

INDEPENDENT = (
    calibrating(
        "an independent recording of the same motion",
        "as control",
        same,
        good(),
        control=lambda r: another(),
    ),
    calibrating(
        "an independent recording of the same motion",
        "calibrated together",
        lambda r: [same(r), another()],
        good(),
    ),
)

TRAPS = (*COPIES, *TOGETHER, *INDEPENDENT, *KNOCKED)
