"""`imucal stand`: moving a stand and recording the unit on it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucal.cli import completion
from imucal.cli.equipment import Equipment, equipment_options
from imucal.cli.output import JsonPath, Output
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.stand.recorder import Done

__all__ = ["app"]

BROKEN_OFF = 1

app = typer.Typer(
    help="Move a stand, record the unit on it, and calibrate.",
    no_args_is_help=True,
    epilog="Example: imucal stand run random --driver simulated --speed 1000 -o stand-run.csv",
)

ProgramName = Annotated[
    str,
    typer.Argument(
        metavar="PROGRAM",
        help="random or grid, or a program file.",
        autocompletion=completion.programs,
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="Of the random program, and of simulated noise.")]


@app.command()
@equipment_options
def run(
    program: ProgramName,
    equipment: Equipment,
    output: Annotated[Path, typer.Option("--output", "-o", help="Recording to write, .csv or .parquet.")],
    target_sigma: Annotated[
        list[str] | None,
        typer.Option(
            "--target-sigma",
            metavar="NAME=SIGMA",
            help="End early when these parameters are expected to be known so well, SI units: "
            "gyro_sensitivity_*=2e-4. Any number of times; all must be reached.",
        ),
    ] = None,
    seed: Seed = 1,
    json: JsonPath = None,
) -> None:
    """Take a stand through a program and record the unit on it.

    All that arrives is kept at once in OUTPUT.journal; after a crash or a power cut `imucal stand recover`
    makes the recording of it. Ends with 1 if the run broke off; what was recorded by then is written.

    Example: imucal stand run random --driver simulated --speed 1000 -o stand-run.csv
    """
    from imucal.stand.live import live_view
    from imucal.stand.programs import program_named
    from imucal.stand.progress import parse_target
    from imucal.stand.recorder import journal_of, record

    targets = [parse_target(text) for text in target_sigma or ()]
    wanted = program_named(program, seed)
    with working("preparing the run"):
        driver, source = equipment.open(wanted, seed)
    about = {"program": program, "seed": seed, "driver": equipment.driver}
    try:
        with live_view(program) as watch:
            done = record(
                driver,
                source,
                output,
                steps=len(wanted.steps),
                about=about,
                targets=targets,
                watch=watch,
            )
    except KeyboardInterrupt:
        if journal_of(output).exists():
            print(
                f"imucal: what was recorded is in {journal_of(output)}: imucal stand recover "
                f"{journal_of(output)} -o {output}",
                file=sys.stderr,
            )
        raise
    out = Output(json)
    out.document(done.to_dict())
    show_run(out, done)
    if not done.good:
        raise typer.Exit(BROKEN_OFF)


def show_run(out: Output, done: Done) -> None:
    """How a run ended, in words."""
    for event in done.events:
        out.line(f"{event['code']}: {event['message']}" if event["message"] else event["code"])
    prospect = done.prospect
    counted = ", ".join(f"{what} {count}" for what, count in done.counts.items() if what != "samples")
    out.line(
        f"{done.output or 'nothing is written'}: {done.samples} samples, {prospect.rests} rests, "
        f"{prospect.coverage:.0%} of all directions within 30 deg of one"
        + (f"; {counted}" if counted else "")
    )
    out.line(f"run: {done.state} at step {done.step + 1} of {done.steps}")


@app.command()
def recover(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Journal of a run that was broken off.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Recording to write, .csv or .parquet.")],
    json: JsonPath = None,
) -> None:
    """Make a recording of the journal of a run that crashed; the journal is kept.

    Example: imucal stand recover broken-off.csv.journal -o recovered.csv
    """
    from imucal.stand.recovery import recover as recover_journal

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
        f"{output}: {len(logged.samples)} samples; {logged.blocks_lost} blocks are damaged, "
        f"{logged.tail_bytes} bytes at the end were being written"
    )
