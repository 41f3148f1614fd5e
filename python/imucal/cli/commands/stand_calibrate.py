"""`imucal stand calibrate`: measures, calibrates and judges one unit of a production line."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from click.exceptions import Exit

import imucal.cli.completion as completion
from imucal.cli.equipment import Equipment, equipment_options
from imucal.cli.options import (
    Gravity,
    JsonPath,
    LimitsPath,
    Require,
    Required,
    UnitsOption,
    UnitSystem,
)
from imucal.cli.output import NO_RESULT, POOR_VERDICT, Output, require_apart
from imucal.cli.parameters import option
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.rig.motion import Program
    from imucal.stand.line import Outcome
    from imucal.stand.recorder import Moment

__all__ = ["calibrate", "end_unit", "view_for"]

EXIT = {"passed": 0, "failed": POOR_VERDICT, "no_result": NO_RESULT}
# The seed of a random control program is drawn from 0 to this number, exclusive.
SEEDS = 2**31
# Number of moves of a random control program.
CONTROL_MOVES = 20


@equipment_options
def calibrate(
    equipment: Equipment,
    folder: Annotated[
        Path,
        option("--output", "-o", metavar="FOLDER", help="Parent folder of the units' folders."),
    ],
    program: Annotated[
        str,
        option(
            "--program",
            metavar="PROGRAM",
            help="random or optimal, or a program file.",
            completion=completion.line_programs,
        ),
    ] = "random",
    seed: Annotated[int, option("--seed", help="Seed of the random program and of simulated noise.")] = 1,
    control_program: Annotated[
        Path | None,
        option(
            "--control-program",
            metavar="FILE",
            help="Program file of the control run. Default: a random program; if PROGRAM is a file, its "
            "poses in another order along the same path.",
        ),
    ] = None,
    control_seed: Annotated[
        int | None,
        option("--control-seed", help="Seed of the control program; drawn if not given."),
    ] = None,
    serial_number: Annotated[
        str | None, option("--serial-number", help="Serial number of the unit; names its folder.")
    ] = None,
    operator: Annotated[
        str, option("--operator", help="Name of the operator, stored in the calibration.")
    ] = "",
    limits: LimitsPath = None,
    require: Require = Required.incomplete,
    export: Annotated[
        list[str] | None,
        option("--export", metavar="FORMAT", help="Export if the unit passes; may be repeated."),
    ] = None,
    gravity: Gravity = STANDARD_GRAVITY_MPS2,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Run a program, calibrate one unit, run a control program, judge the unit, and export its calibration.

    A unit whose calibration is incomplete passes, unless --require good is given or the limits require the
    verdict good. The exit code is 0 if the unit passes, 2 if it fails, and 1 if there is no result or a file
    of a unit that passes cannot be written.

    Example: imucal stand calibrate --driver simulated --speed 1000 --serial-number 0042 -o units
    """
    from dataclasses import replace

    from imucal.calibration.verdict import verdict_of
    from imucal.document.plain import plain
    from imucal.limits.limits import Limits
    from imucal.rig.motion import Program
    from imucal.stand.line import Order, calibrate_unit
    from imucal.stand.programs import PROGRAMS, program_named

    # The output folder is passed as if it were an input, so that --json cannot have the same path.
    require_apart([program, control_program, limits, folder, *equipment.files], {"--json": json})
    drawn_seed = secrets.randbelow(SEEDS) if control_seed is None else control_seed
    control: dict[str, Any] = {}
    if control_program is not None:
        control = {"control": Program.read(control_program), "control_name": str(control_program)}
    elif program in PROGRAMS:
        control = {
            "control": Program.random(seed=drawn_seed, moves=CONTROL_MOVES),
            "control_name": "random",
        }
    order = Order(
        program_named(program, seed),
        program,
        seed,
        drawn_seed,
        serial_number,
        operator,
        Limits.load(limits) if limits else None,
        tuple(export or ()),
        gravity,
        driver=equipment.driver,
        require=verdict_of(require.value),
        **control,
    )
    order = replace(
        order,
        resume={
            "command": "calibrate",
            "equipment": equipment.to_dict(),
            "programs": {name: plain(steps.steps) for name, steps in order.programs.items()},
            "limits": None if limits is None else str(limits.absolute()),
            **{
                name: getattr(order, name)
                for name in (
                    *("program_name", "seed", "control_seed", "serial_number", "operator", "exports"),
                    *("gravity_mps2", "control_name", "driver", "require"),
                )
            },
        },
    )
    out = Output(json, units)
    if equipment.driver == "simulated":
        out.line("simulated: stand and unit are not real; for real ones give --driver grbl or manual")
    for name, steps in order.programs.items():
        out.line(f"{name}: {_turned(steps)}: mind the cables")

    end_unit(out, calibrate_unit(order, equipment.open, folder, view=view_for(equipment)))


def view_for(
    equipment: Equipment,
) -> Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]]:
    """A function that returns the live view of a run, given the output file of the run."""
    from imucal.stand.live import live_view, recoverable

    @contextmanager
    def view(recording: Path) -> Iterator[Callable[[Moment], None] | None]:
        says = equipment.driver == "manual"
        with recoverable(recording), live_view(recording.stem, prints_steps=says) as watch:
            yield watch

    return view


def end_unit(out: Output, outcome: Outcome) -> None:
    """Print the verdict on a unit, and end the command with the exit code of this verdict."""
    # The verdict is printed before the document of --json is written, because writing can fail on a full
    # disk.
    _show(out, outcome)
    out.document(outcome.to_dict())
    code = EXIT[outcome.verdict]
    if code or outcome.not_written:
        raise Exit(code or NO_RESULT)


def _turned(program: Program) -> str:
    """The range of the angle of each motor in a program, as text."""
    from imucal.stand.programs import ranges_deg

    return ", ".join(
        f"motor {motor} {low:.1f} to {high:.1f} deg"
        for motor, (low, high) in enumerate(ranges_deg(program), start=1)
    )


def _show(out: Output, outcome: Outcome) -> None:
    """Print accuracy, failed limits, exports, reasons and verdict of the unit."""
    result = outcome.assessment.result if outcome.assessment else None
    if result is not None:
        out.figures({"calibration set": result.calibration_set, "control set": result.control_set})
        out.judgement(result.judgement, verbose=False)
    for name, (path, written) in outcome.exports.items():
        out.line(f"{path}: {written.form.title}")
        for loss in written.lost:
            out.line(f"not exported to {name}: {loss}")
    for name, message in outcome.not_written.items():
        out.line(f"{name} is not written: {message}")
    if result is not None and result.verdict == "incomplete":
        for text in result.reasons:
            out.line(f"the calibration is incomplete: {text}")
    for reason in outcome.reasons:
        out.line(f"{reason.code}: {reason.message}")
    order, names = outcome.order, dict.fromkeys(reason.code for reason in outcome.reasons)
    out.line(
        f"{outcome.folder}: program {order.program_name}, seed {order.seed}; control program, seed "
        f"{order.control_seed}"
    )
    why = f" ({', '.join(names)})" if names else ""
    out.line(f"unit {order.serial_number or '-'}: {outcome.verdict}{why}")
