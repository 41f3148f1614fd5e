"""The command `imucal demo`, which simulates and calibrates a unit and writes a report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import click

import imucal.cli.demo_gap as demo_gap
from imucal.cli.demo_folder import prepare_folder
from imucal.cli.group import Commands
from imucal.cli.options import JsonPath, UnitsOption, UnitSystem
from imucal.cli.output import Output
from imucal.cli.parameters import option
from imucal.cli.working import working

__all__ = ["app"]


def demo(
    folder: Annotated[Path, option("--output", "-o", metavar="FOLDER", help="Folder for the files.")] = Path(
        "demo"
    ),
    seed: Annotated[int, option("--seed", help="Seed of the two simulated runs.")] = 1,
    show: Annotated[
        bool | None,
        option("--open/--no-open", help="Open the report in the browser; by default only in a terminal."),
    ] = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Simulate a run on a stand, calibrate it, evaluate it on a control run, and write a report.

    Example: imucal demo -o demo
    """
    from imucal.errors import InputError

    context = click.get_current_context()
    if (command := context.invoked_subcommand) is not None:
        sources = map(context.get_parameter_source, context.params)
        if any(source is not None and source.name == "COMMANDLINE" for source in sources):
            raise InputError(f"options of `imucal demo {command}` must follow {command}")
        return
    import imucal
    from imucal.report import require_plotly, write_calibration_page

    require_plotly()

    prepare_folder(folder, ("run.csv", "control.csv", "calibration.json", "report.html"))
    with working("simulating the stand"):
        run = imucal.simulate("random", seed=seed)
        control = imucal.simulate("random", seed=seed + 1)
    with working("calibrating and evaluating"):
        result = imucal.calibrate(run.recording, control=control.recording)
    truth = {parameter.name: parameter.value for parameter in run.truth.calibration.parameters}

    with working("writing the recordings"):
        imucal.write(run.recording, folder / "run.csv")
        imucal.write(control.recording, folder / "control.csv")
    result.calibration.save(folder / "calibration.json")
    page = folder / "report.html"
    write_calibration_page(page, result, title="Calibration of a simulated unit", truth=truth)

    out = Output(json, units)
    out.document({**result.to_dict(), "truth": run.truth.to_dict(), "page": str(page)})
    out.parameters(result.parameters, truth)
    out.figures({"control set, uncalibrated": result.control_before, "calibrated": result.control_set})
    out.line(f"recordings, calibration and report are in {folder}: open {page}")
    if sys.stdout.isatty() if show is None else show:
        click.launch(str(page))
    out.verdict(result.verdict, result.reasons)


app = Commands(
    "demo",
    help="Calibrate a simulated unit and show a report, or find a hidden effect in simulated data.",
    function=demo,
)
app.subcommand(demo_gap.gap)
