"""`imucal plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import imucal.cli.completion as completion
from imucal.cli.output import POOR_VERDICT, JsonPath, Output, require_apart
from imucal.cli.working import working
from imucal.errors import InputError

__all__ = ["plan"]

# The panels of the help.
GOAL = "The optimal program"
NAMED = "The paper's programs"


def plan(
    program: Annotated[
        str,
        typer.Argument(
            metavar="PROGRAM",
            help="optimal; random or grid (the paper's programs); or a program file, to be predicted.",
            autocompletion=completion.plans,
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="PATH", help="Program file to write, JSON.")
    ] = None,
    card: Annotated[
        Path | None,
        typer.Option(
            "--card",
            metavar="PATH",
            help="Page with a picture of each pose to write, HTML: for --stand hand.",
        ),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(
            "--unit",
            metavar="NAME|FILE",
            help="Whose noise it is: paper, bmi088, adis16460, icm42688p, mpu6050, lsm6dso, or a unit file.",
            autocompletion=completion.units,
        ),
    ] = "paper",
    stand: Annotated[
        str,
        typer.Option(
            "--stand",
            metavar="NAME|FILE",
            help="What the stand can do: paper (three motors, 120 deg/s), two-axis, one-axis, hand (no "
            "stand), or a limits file.",
            autocompletion=completion.stand_limits,
        ),
    ] = "paper",
    target: Annotated[
        list[str] | None,
        typer.Option(
            "--target",
            metavar="GROUP=SIGMA",
            help="Standard deviation that the worst of a group must reach, with a unit or in SI units: "
            "accel_sensitivity='50 ppm', accel_bias='50 ug', gyro_sensitivity=2e-4, gyro_bias=5e-5, or an "
            "effect's name. Any number of times; the shortest program is found.",
            rich_help_panel=GOAL,
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes",
            help="Most that the program may take. Without a target it has the most information in this time "
            "(D-optimal); 3 if not said.",
            rich_help_panel=GOAL,
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            metavar="NAME",
            help="An effect that the program is to show, too. Any number of times; `imucal effects` lists "
            "them.",
            autocompletion=completion.effects,
            rich_help_panel=GOAL,
        ),
    ] = None,
    proposals: Annotated[
        int,
        typer.Option("--proposals", help="Changes that the search tries: more take longer and find better."),
    ] = 12000,
    seed: Annotated[int, typer.Option("--seed", help="Of the search and of the random program.")] = 1,
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Sample rate of the unit.")] = 200.0,
    detection_limits: Annotated[
        bool,
        typer.Option(
            "--detection-limits/--no-detection-limits",
            help="How small each effect of the catalogue could be and still be found: of a simulated run.",
        ),
    ] = True,
    moves: Annotated[int | None, typer.Option("--moves", help="Of random.", rich_help_panel=NAMED)] = None,
    max_rate_dps: Annotated[
        float | None,
        typer.Option(
            "--max-rate-dps", help="Of each motor in random, mean over a turn.", rich_help_panel=NAMED
        ),
    ] = None,
    step_deg: Annotated[
        float | None, typer.Option("--step-deg", help="Of grid.", rich_help_panel=NAMED)
    ] = None,
    move_s: Annotated[
        float | None, typer.Option("--move-s", help="Length of a move.", rich_help_panel=NAMED)
    ] = None,
    hold_s: Annotated[
        float | None, typer.Option("--hold-s", help="Length of a rest.", rich_help_panel=NAMED)
    ] = None,
    json: JsonPath = None,
) -> None:
    """Plan a motion, and say what it will determine before anything moves.

    For any program: the standard deviation of every parameter, the minutes on the stand, the smallest size of
    each effect that `imucal gap` would find, and the same of the paper's programs. Ends with 2 if a target is
    not reached or the program takes longer than allowed.

    Example: imucal plan optimal --minutes 2 --proposals 2000 -o program.json

    Example: imucal plan optimal --target accel_bias='80 ug' --target gyro_sensitivity=4e-4 --proposals 2000

    Example: imucal plan optimal --stand hand --proposals 2000 -o poses.json --card poses.html
    """
    import imucal
    from imucal.planning.card import write_card
    from imucal.planning.result import headline, worst_rows
    from imucal.rig.stand_limits import stand_limits_of

    options = {
        "moves": moves,
        "max_rate_dps": max_rate_dps,
        "step_deg": step_deg,
        "move_s": move_s,
        "hold_s": hold_s,
    }
    require_apart([program, unit, stand], {"--output": output, "--card": card, "--json": json})
    limits = stand_limits_of(stand)
    if card is not None and not limits.in_hand:
        raise InputError("--card shows poses to hold in a hand: add --stand hand, or leave it out")
    with working("planning"):
        planned = imucal.plan(
            program,
            unit=unit,
            stand=limits,
            targets=dict(map(_target, target or ())),
            minutes=minutes,
            effects=effect or (),
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
    out = Output(json)
    out.document(planned.to_dict())
    out.line(headline(planned))
    out.table(
        ("parameter", "predicted 1 sigma", "unit"),
        [[p.name, "not determined" if p.std is None else f"{p.std:.2e}", p.unit] for p in planned.parameters],
    )
    if planned.detection_limits:
        out.table(
            ("effect", "smallest that would be found", "unit"),
            [[name, f"{size['value']:.2e}", size["unit"]] for name, size in planned.detection_limits.items()],
        )
    for effect_row in planned.not_observable:
        out.line(f"not seen: {effect_row['name']} (needs {effect_row['needs']})")
    out.table(
        ("worst 1 sigma", "minutes", "accel sensitivity", "accel bias", "gyro sensitivity", "gyro bias"),
        worst_rows(planned),
    )
    if planned.undetermined is not None:
        out.line(f"not determined: {planned.undetermined}")
    for note in planned.notes:
        out.line(note)
    for path in (output, card):
        if path is not None:
            out.line(f"written: {path}")
    if not planned.reached:
        out.line("what was wished for is not reached: allow more minutes, or wish for less")
        raise typer.Exit(POOR_VERDICT)


def _target(text: str) -> tuple[str, str]:
    group, equals, wish = text.partition("=")
    if not equals:
        raise InputError(f"--target {text}: give GROUP=SIGMA, such as accel_bias='50 ug'")
    return group.strip(), wish
