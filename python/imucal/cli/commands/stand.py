"""`imucal stand`: moving a stand and recording the unit on it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import imucal.cli.completion as completion
from imucal.cli.commands import stand_calibrate, stand_resume
from imucal.cli.equipment import Equipment, equipment_options
from imucal.cli.group import Commands
from imucal.cli.options import JsonPath, RecordingPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.working import working
from imucal.errors import InputError

__all__ = ["app"]

app = Commands(
    "stand",
    help="Move a stand, record the unit on it, and calibrate.",
    epilog="Example: imucal stand run random --driver simulated --speed 1000 -o stand-run.csv",
)

ProgramName = Annotated[
    str,
    argument(
        metavar="PROGRAM",
        help="random, grid or optimal, or a program file.",
        completion=completion.plans,
    ),
]
Seed = Annotated[int, option("--seed", help="Seed of the random program and of simulated noise.")]


@app.subcommand
@equipment_options
def run(
    program: ProgramName,
    equipment: Equipment,
    output: RecordingPath,
    target_sigma: Annotated[
        list[str] | None,
        option(
            "--target-sigma",
            metavar="NAME=SIGMA",
            help="End early when the predicted standard deviations reach this target, SI units: "
            "gyro_sensitivity_*=2e-4. May be repeated; all targets must be reached.",
        ),
    ] = None,
    seed: Seed = 1,
    force: Annotated[bool, option("--force", help="Overwrite OUTPUT if it exists.")] = False,
    json: JsonPath = None,
) -> None:
    """Run a program on a stand and record the unit.

    Each sample is written to OUTPUT.journal immediately; after a crash or a power failure, `imucal stand
    recover` converts this journal to a recording. The exit code is 1 if the run was interrupted; the samples
    until then are written.

    Example: imucal stand run random --driver simulated --speed 1000 -o stand-run.csv

    Example: imucal stand run grid --driver grbl --port /dev/ttyS0 --source /dev/ttyS1 --packet p -o run.csv
    """
    from imucal.document.plain import plain
    from imucal.stand.live import live_view, recoverable
    from imucal.stand.programs import program_named
    from imucal.stand.progress import parse_target
    from imucal.stand.recorder import journal_of, record

    require_apart(
        [program, *equipment.files],
        {"--output": output, "the journal": journal_of(output), "--json": json},
    )
    # An existing recording is overwritten only with --force, because the samples of a real unit cannot be
    # produced again. Other output files are overwritten without --force.
    if output.exists() and not force:
        raise InputError(f"{output} exists: give another file, or --force to overwrite it")
    targets = [parse_target(text) for text in target_sigma or ()]
    wanted = program_named(program, seed)
    with working("preparing the run"):
        driver, source = equipment.open(wanted, seed)
    about = {
        "program": program,
        "seed": seed,
        "driver": equipment.driver,
        "resume": {
            "command": "run",
            "program": plain(wanted.steps),
            "equipment": equipment.to_dict(),
            "targets": list(target_sigma or ()),
        },
    }
    with (
        recoverable(output),
        live_view(Path(program).name, prints_steps=equipment.driver == "manual") as watch,
    ):
        done = record(
            driver,
            source,
            output,
            steps=len(wanted.steps),
            about=about,
            targets=targets,
            watch=watch,
        )
    stand_resume.end_run(Output(json), done)


@app.subcommand
def gcode(
    program: ProgramName,
    output: Annotated[Path, option("--output", "-o", metavar="FILE", help="G-code file to write.")],
    axes: Annotated[str, option("--axes", help="Axis letters of the three motors, outermost first.")] = "XYZ",
    max_rate_dps: Annotated[
        str,
        option(
            "--max-rate-dps",
            metavar="A[,B,C]",
            help="Highest rate of each motor, deg/s: settings $110 to $112 of the controller, divided by 60.",
        ),
    ] = "360",
    acceleration_dps2: Annotated[
        str,
        option(
            "--acceleration-dps2",
            metavar="A[,B,C]",
            help="Acceleration of each motor, deg/s^2: settings $120 to $122 of the controller.",
        ),
    ] = "1000",
    seed: Seed = 1,
    json: JsonPath = None,
) -> None:
    """Write a program as G-code for GRBL 1.1, with 1 mm for 1 deg, and print its duration.

    Example: imucal stand gcode random -o run.nc --axes ABC
    """
    import numpy as np

    from imucal.document.atomic import write_text
    from imucal.stand.gcode import Axes, MotorLimits, blocks_of, duration_s, gcode as gcode_of, late
    from imucal.stand.programs import program_named

    require_apart([program], {"--output": output, "--json": json})
    letters = Axes(axes.upper())
    blocks = blocks_of(
        program_named(program, seed), MotorLimits(_three(max_rate_dps), _three(acceleration_dps2))
    )
    write_text(output, gcode_of(blocks, letters, Path(program).name))
    angles = np.array([block.angles_deg for block in blocks])
    ranges = [[min(low, 0.0), max(high, 0.0)] for low, high in zip(angles.min(0), angles.max(0), strict=True)]
    too_late = late(blocks)
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "steps": len(blocks),
            "duration_s": duration_s(blocks),
            "range_deg": ranges,
            "late_steps": too_late,
        }
    )
    if too_late:
        longest_s = max(block.late_s for block in blocks)
        print(
            f"imucal: {len(too_late)} of {len(blocks)} moves take up to {longest_s:.2f} s longer than in the "
            "program, because the motors are not fast enough; the poses are unchanged",
            file=sys.stderr,
        )
    turned = ", ".join(
        f"{letter} {low:.0f} to {high:.0f} deg"
        for letter, (low, high) in zip(letters.letters, ranges, strict=True)
    )
    out.line(f"{output}: {len(blocks)} steps, {duration_s(blocks):.1f} s; {turned}: mind the cables")


def _three(text: str) -> tuple[float, float, float]:
    """Three numbers, one per motor, from a text with three numbers or with one number for all motors."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 3):
        raise InputError(
            f"{text!r} is not valid: give one number for all motors or three, such as 360 or 90,180,360"
        )
    x, y, z = values * 3 if len(values) == 1 else values
    return (x, y, z)


app.subcommand(stand_calibrate.calibrate)
app.subcommand(stand_resume.resume)


@app.subcommand
def recover(
    journal: Annotated[Path, argument(metavar="JOURNAL", help="Journal of an interrupted run.")],
    output: RecordingPath,
    json: JsonPath = None,
) -> None:
    """Convert the journal of an interrupted run to a recording; the journal is kept.

    Example: imucal stand recover broken-off.csv.journal -o recovered.csv
    """
    from imucal.stand.recovery import recover as recover_journal

    require_apart([journal], {"--output": output, "--json": json})
    logged = recover_journal(journal, output)
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "samples": len(logged.samples),
            "positions": len(logged.positions),
            "blocks_lost": logged.blocks_lost,
            "tail_bytes": logged.tail_bytes,
            "events": list(logged.events),
            "header": dict(logged.header),
        }
    )
    for event in logged.events:
        out.line(f"{event['code']}: {event['message']}" if event["message"] else event["code"])
    out.line(
        f"{output}: {len(logged.samples)} samples; {logged.blocks_lost} damaged blocks, "
        f"{logged.tail_bytes} bytes of an incomplete block at the end"
    )
