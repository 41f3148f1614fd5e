"""The command `imucal gap`, which searches the residuals of a calibration for a missing effect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

import imucal.cli.completion as completion
from imucal.cli.decisions import show_ranking
from imucal.cli.options import (
    MIN_REST_S,
    Control,
    ExcludeSaturated,
    HoldOption,
    JsonPath,
    MinRest,
    ModelOption,
    ReportPath,
    Verbose,
    effect_option,
    writing_option,
)
from imucal.cli.output import NO_RESULT, POOR_VERDICT, Output, prepare_report, require_apart
from imucal.cli.parameters import option
from imucal.cli.reading import Files, Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.gap.result import Gap

__all__ = ["gap"]


@reading_options
def gap(
    recordings: Files,
    reading: Reading,
    control: Control = None,
    calibration: Annotated[
        Path | None,
        option("--calibration", metavar="CAL", help="Calibration to examine; made if not given."),
    ] = None,
    output: Annotated[Path | None, writing_option("Improved calibration to write.")] = None,
    gravity: Annotated[
        float | None, option("--gravity", metavar="MPS2", help="Local gravity, m/s^2.")
    ] = None,
    effect: Annotated[
        list[str] | None,
        effect_option(
            "Test only this effect, or a formula such as 'gyro: k * (supply_v - 3.3)'; may be repeated.",
            completion.effects,
        ),
    ] = None,
    min_rest_s: MinRest = MIN_REST_S,
    exclude_saturated: ExcludeSaturated = False,
    model: ModelOption = "full",
    hold: HoldOption = None,
    explain: Annotated[
        str | None,
        option(
            "--explain",
            metavar="NAME",
            help="Show the detection limit of this effect in these recordings.",
            completion=completion.effects,
        ),
    ] = None,
    next_program: Annotated[
        Path | None,
        option(
            "--next",
            metavar="PATH",
            help="If the verdict is ambiguous: file to which the program of a motion that resolves it is "
            "written.",
        ),
    ] = None,
    verbose: Verbose = False,
    report: ReportPath = None,
    json: JsonPath = None,
) -> None:
    """Find a missing effect from the residuals of a calibration, and add it to the model.

    The verdict is nothing_missing, named (effects were found), ambiguous (another effect explains the
    residuals equally well), stochastic (a bias or a scale varies randomly), unknown (no effect of the
    catalogue explains the residuals) or data_fault (the recordings are faulty).

    The exit code is 1 for data_fault. It is 2 for stochastic, for unknown if no formula (law) was found that
    describes the residuals, and if the residuals that remain with the effects limit the use of the
    calibration. Otherwise it is 0.

    Example: imucal gap run.csv --control control.csv -o improved.json

    Example: imucal gap run.csv --explain gyro_g_sensitivity

    Example: imucal gap run.csv --control control.csv --effect 'gyro: k * w * abs(f_z)'
    """
    import imucal
    from imucal.effects.table import find

    require_apart(
        [*recordings, *(control or ()), calibration],
        {"--output": output, "--next": next_program, "--report": report, "--json": json},
    )
    prepare_report(report)
    if explain is not None:
        find(explain)
    with working("reading"):
        unit_data = reading.each(recordings)
        judges = reading.each(control or []) or None
        judged = None if calibration is None else imucal.Calibration.load(calibration)
    with working("searching for effects") as stage:
        found = imucal.find_gap(
            unit_data,
            control=judges,
            calibration=judged,
            candidates=effect or None,
            gravity_mps2=gravity,
            min_rest_s=min_rest_s,
            exclude_saturated=exclude_saturated,
            model=model,
            hold=hold or [],
            stage=stage,
        )
    if output is not None and found.calibration is not None:
        found.calibration.save(output)
    if report is not None:
        from imucal.report import write_gap_page

        write_gap_page(report, found, recordings=unit_data, control=judges)
    out = Output(json)
    out.document(found.to_dict)
    if verbose:
        show_ranking(out, found.ranking)
    for line in found.summary().splitlines():
        out.line(line)
    if explain is not None:
        for line in found.explain(explain):
            out.line(line)
    if output is not None and found.calibration is not None:
        out.line(f"calibration written to {output}")
    if next_program is not None:
        out.line(_write_next(found, next_program))
    if found.verdict == "data_fault":
        raise Exit(NO_RESULT)
    remains = found.remainder is not None and found.remainder.matters
    is_unexplained = found.verdict == "unknown" and not found.laws
    if is_unexplained or remains:
        raise Exit(POOR_VERDICT)


def _write_next(found: Gap, path: Path) -> str:
    """Write the program of the motion that would resolve an ambiguous verdict. Returns a message."""
    from imucal.document.json_document import write_json

    if found.next_motion is None:
        return f"{path} is not written: the verdict is {found.verdict}, which no further motion would change"
    write_json(found.next_motion["program"], path)
    options = " ".join(["", *found.next_motion["simulate"]])
    command = f"imucal simulate {path}{options} -o next.csv"
    return f"program of the next motion written to {path}: run it on a stand, or simulate it with {command}"
