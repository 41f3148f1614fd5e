"""`imucal stand resume`: continues a run that was killed or interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from imucal.cli.commands import stand_calibrate
from imucal.cli.equipment import Equipment
from imucal.cli.options import JsonPath
from imucal.cli.output import NO_RESULT, POOR_VERDICT, Output, require_apart
from imucal.cli.parameters import argument, option

if TYPE_CHECKING:
    from imucal.stand.recorder import Done

__all__ = ["end_run", "resume"]


def resume(
    folder: Annotated[
        Path,
        argument(metavar="FOLDER", help="Folder of an interrupted run or unit, or the journal of the run."),
    ],
    start_here: Annotated[
        bool,
        option("--start-here", help="The motors were brought to zero by hand."),
    ] = False,
    home: Annotated[bool, option("--home", help="Run the homing cycle ($H) first.")] = False,
    unlock: Annotated[
        bool, option("--unlock", help="Unlock a controller that is locked by an alarm ($X).")
    ] = False,
    json: JsonPath = None,
) -> None:
    """Continue a run of `stand run` or `stand calibrate` that was killed or interrupted.

    The journal contains the options and the program. The run continues with the first step that was not done,
    in the same recording. If the motors are no longer where the run has left them, bring them to zero and
    give --start-here. The stand then repeats the completed steps without stopping at the rests.

    Example: imucal stand resume units/0042
    """
    from imucal.calibration.verdict import verdict_of
    from imucal.errors import InputError
    from imucal.limits.limits import Limits
    from imucal.stand.line import Order, resume_unit
    from imucal.stand.progress import parse_target
    from imucal.stand.recorder import record
    from imucal.stand.resuming import interrupted_in, program_from

    require_apart([folder], {"--json": json})
    interrupted = interrupted_in(folder)
    about = interrupted.about
    equipment = Equipment.of_dict(
        about["equipment"], start_here=start_here, home=home, unlock=unlock, unwind=False
    )
    view = stand_calibrate.view_for(equipment)
    if about["command"] == "run":
        program = program_from(about["program"])
        driver, source = equipment.open(program, 1, resume=interrupted.progress, clock=interrupted.clock)
        with view(interrupted.output) as watch:
            done = record(
                driver,
                source,
                interrupted.output,
                steps=len(program.steps),
                targets=[parse_target(text) for text in about.get("targets", ())],
                watch=watch,
                resume=interrupted.logged,
                clock=interrupted.clock,
            )
        end_run(Output(json), done)
        return
    if about["command"] != "calibrate":
        raise InputError(
            f"{folder} is of another version of imucal: save its samples with `imucal stand recover`"
        )
    programs = {name: program_from(steps) for name, steps in about["programs"].items()}
    order = Order(
        programs["run"],
        about["program_name"],
        about["seed"],
        about["control_seed"],
        about["serial_number"],
        about["operator"],
        Limits.load(about["limits"]) if about["limits"] else None,
        tuple(about["exports"]),
        about["gravity_mps2"],
        control=programs["control"],
        control_name=about["control_name"],
        driver=about["driver"],
        require=verdict_of(about["require"]),
        resume=about,
    )
    stand_calibrate.end_unit(Output(json), resume_unit(order, equipment.open, interrupted, view=view))


def end_run(out: Output, done: Done) -> None:
    """Print the events and the result of a run, and end the command with the exit code of the result."""
    out.document(done.to_dict())
    for event in done.events:
        out.line(f"{event['code']}: {event['message']}" if event["message"] else event["code"])
    prospect = done.prospect
    counted = ", ".join(f"{what} {count}" for what, count in done.counts.items() if what != "samples")
    out.line(
        f"{done.output or 'nothing is written'}: {done.samples} samples, {prospect.rests} rests, "
        f"covering {prospect.coverage:.0%} of all directions (within 30 deg of a rest)"
        + (f"; {counted}" if counted else "")
    )
    out.line(f"run: {done.state} at step {done.step + 1} of {done.steps}")
    if not done.good:
        raise Exit(NO_RESULT)
    if any(event["code"] == "target_missed" for event in done.events):
        raise Exit(POOR_VERDICT)
