"""The command `imucal plan`, which plans a motion and predicts the accuracy of a calibration from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

import imucal.cli.completion as completion
from imucal.cli.options import (
    HoldOption,
    JsonPath,
    ModelOption,
    UnitsOption,
    UnitSystem,
    effect_option,
    unit_option,
    writing_option,
)
from imucal.cli.output import POOR_VERDICT, Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.working import working
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration.parameter_text import Units
    from imucal.planning.groups import Size

__all__ = ["plan"]

# Headings of the options in the help.
GOAL = "The optimal program"
NAMED = "Named programs"


def plan(
    program: Annotated[
        str,
        argument(
            metavar="PROGRAM",
            help="optimal; faces (a box rolled over its faces, by hand or on a stand); random or grid (the "
            "paper's programs); or a program file to predict.",
            completion=completion.plans,
        ),
    ],
    output: Annotated[Path | None, writing_option("Program file to write, JSON.")] = None,
    card: Annotated[
        Path | None,
        option(
            "--card",
            metavar="PATH",
            help="HTML page to write, with a picture of each pose; only with --stand hand or the program "
            "faces.",
        ),
    ] = None,
    unit: Annotated[
        str,
        unit_option(
            "Unit with the assumed noise: paper, bmi088, adis16460, icm42688p, mpu6050, lsm6dso, or a "
            "unit file."
        ),
    ] = "paper",
    stand: Annotated[
        str,
        option(
            "--stand",
            metavar="NAME|FILE",
            help="Limits of the stand: paper (three motors, 120 deg/s), two-axis, one-axis, hand (no "
            "stand), or a limits file.",
            completion=completion.stand_limits,
        ),
    ] = "paper",
    target: Annotated[
        list[str] | None,
        option(
            "--target",
            metavar="GROUP=SIGMA",
            help="Target for the largest standard deviation in a group, with a unit or in SI units: "
            "accel_sensitivity='50 ppm', accel_bias='50 ug', gyro_sensitivity=2e-4, gyro_bias=5e-5, or the "
            "name of an effect. May be repeated; the shortest program is searched, or for faces the smallest "
            "number of rounds.",
            panel=GOAL,
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        option(
            "--minutes",
            help="Maximum duration, minutes (default 3). Without a target, the program maximises the "
            "information in this time (D-optimality).",
            panel=GOAL,
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        effect_option(
            "Effect that the program must make observable; may be repeated (see `imucal effects`).",
            completion.effects,
            GOAL,
        ),
    ] = None,
    model: ModelOption = "full",
    hold: HoldOption = None,
    proposals: Annotated[
        int,
        option(
            "--proposals", help="Number of random changes that the search tries; more give better programs."
        ),
    ] = 12000,
    seed: Annotated[int, option("--seed", help="Seed of the search and of the random program.")] = 1,
    rate_hz: Annotated[float, option("--rate-hz", help="Sampling rate of the unit, Hz.")] = 200.0,
    detection_limits: Annotated[
        bool,
        option(
            "--detection-limits/--no-detection-limits",
            help="Compute the smallest detectable size of each effect, from a simulated run.",
        ),
    ] = True,
    moves: Annotated[int | None, option("--moves", help="random: number of moves.", panel=NAMED)] = None,
    max_rate_dps: Annotated[
        float | None,
        option("--max-rate-dps", help="random: mean rate of each motor in a move, deg/s.", panel=NAMED),
    ] = None,
    rounds: Annotated[
        int | None,
        option("--rounds", help="faces: rounds of 14 rests (default 1).", panel=NAMED),
    ] = None,
    step_deg: Annotated[float | None, option("--step-deg", help="grid: step, deg.", panel=NAMED)] = None,
    move_s: Annotated[float | None, option("--move-s", help="Duration of a move, s.", panel=NAMED)] = None,
    hold_s: Annotated[float | None, option("--hold-s", help="Duration of a rest, s.", panel=NAMED)] = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Plan a motion, and predict the standard deviations of the parameters of a calibration from it.

    Prints the predicted standard deviation of every parameter, the duration, and the smallest size of each
    effect that `imucal gap` would detect, and compares the accuracy with the programs grid and random. The
    exit code is 2 if a target is not reached or the program takes longer than allowed.

    Example: imucal plan optimal --minutes 2 --proposals 2000 -o program.json

    Example: imucal plan optimal --target accel_bias='80 ug' --target gyro_sensitivity=4e-4 --proposals 2000

    Example: imucal plan faces --card faces.html

    Example: imucal plan optimal --stand hand --proposals 2000 -o poses.json --card poses.html
    """
    import imucal
    from imucal.estimation.inspection import only_moves_determine
    from imucal.planning.card import write_card
    from imucal.planning.result import headline, not_reached, worst_rows
    from imucal.rig.stand_limits import stand_limits_of

    options = {
        "moves": moves,
        "max_rate_dps": max_rate_dps,
        "rounds": rounds,
        "step_deg": step_deg,
        "move_s": move_s,
        "hold_s": hold_s,
    }
    require_apart([program, unit, stand], {"--output": output, "--card": card, "--json": json})
    limits = stand_limits_of(stand)
    if card is not None and not limits.in_hand and program != "faces":
        raise InputError(
            "--card shows poses for a person: plan faces, or add --stand hand, or leave the card out"
        )
    with working("planning"):
        planned = imucal.plan(
            program,
            unit=unit,
            stand=limits,
            targets=dict(map(_target, target or ())),
            minutes=minutes,
            effects=effect or (),
            model=model,
            hold=hold or (),
            seed=seed,
            proposals=proposals,
            detection_limits=detection_limits,
            rate_hz=rate_hz,
            options={name: value for name, value in options.items() if value is not None},
        )
    if output is not None:
        planned.program.write(output)
    if card is not None:
        write_card(planned.program, card)
    out = Output(json, units)
    out.document(planned.to_dict())
    out.line(headline(planned))
    out.predicted(planned.parameters)
    if planned.detection_limits:
        out.table(
            ("effect", "smallest detectable size", "unit"),
            [_limit(name, size, units.units) for name, size in planned.detection_limits.items()],
        )
    for effect_row in planned.not_observable:
        out.line(f"not observable: {effect_row.name} (needs {effect_row.needs})")
    out.table(
        ("largest 1 sigma", "minutes", "accel sensitivity", "accel bias", "gyro sensitivity", "gyro bias"),
        worst_rows(planned),
    )
    if planned.undetermined is not None:
        out.line(f"not determined: {planned.undetermined}")
    elif planned.through_moves:
        out.line(only_moves_determine(planned.through_moves))
    for note in planned.notes:
        out.line(note)
    for path in (output, card):
        if path is not None:
            out.line(f"written: {path}")
    if not planned.reached:
        out.line(not_reached(planned))
        raise Exit(POOR_VERDICT)


def _limit(name: str, size: Size, units: Units) -> list[str]:
    scale = units(name, size.unit)
    return [name, f"{scale.factor * size.value:.3g}", scale.unit]


def _target(text: str) -> tuple[str, str]:
    group, equals, wish = text.partition("=")
    if not equals:
        raise InputError(f"--target {text}: give GROUP=SIGMA, such as accel_bias='50 ug'")
    return group.strip(), wish
