"""The command `imucal inspect`, which shows rests and faults of recordings and predicts the accuracy."""

from __future__ import annotations

from click.exceptions import Exit

from imucal.cli.options import MIN_REST_S, Gravity, JsonPath, MinRest, ReportPath, UnitsOption, UnitSystem
from imucal.cli.output import POOR_VERDICT, Output, prepare_report, require_apart
from imucal.cli.reading import Files, Reading, reading_options
from imucal.cli.working import working
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["inspect"]


@reading_options
def inspect(
    recordings: Files,
    reading: Reading,
    gravity: Gravity = STANDARD_GRAVITY_MPS2,
    min_rest_s: MinRest = MIN_REST_S,
    units: UnitsOption = UnitSystem.datasheet,
    report: ReportPath = None,
    json: JsonPath = None,
) -> None:
    """Show sampling rate, faults and rests of recordings, and the parameters that they determine.

    The standard deviation of every parameter is predicted from the rests, the moves and the noise at rest. A
    calibration has these standard deviations if, besides noise, the data contain only errors that biases,
    scales and misalignments describe.

    The exit code is 2 if a recording has a fault for which a calibration refuses it, or if it does not
    determine all parameters.

    Example: imucal inspect run.csv

    Example: imucal inspect run.csv --report run.html
    """
    import imucal
    from imucal.estimation.inspection import only_moves_determine

    require_apart(recordings, {"--report": report, "--json": json})
    prepare_report(report)
    with working("reading"):
        unit_data = reading.each(recordings)
    inspections = []
    with working("inspecting", len(unit_data)) as stage:
        for recording in unit_data:
            inspections.append(imucal.inspect(recording, gravity_mps2=gravity, min_rest_s=min_rest_s))
            stage.step()
    if report is not None:
        from imucal.report import write_inspection_page

        write_inspection_page(report, inspections, unit_data)
    out = Output(json, units)
    out.document({"recordings": [inspection.to_dict() for inspection in inspections]})
    for seen in inspections:
        out.line(
            f"{seen.name}: {seen.samples} samples, {seen.duration_s:.3f} s, {seen.rate_in_words}, "
            f"{seen.sensors_in_words}, {len(seen.rests)} rest{'' if len(seen.rests) == 1 else 's'}"
        )
        are_long = any(rest.epochs > 1 for rest in seen.rests)
        if seen.rests:
            out.table(
                ["rest", "from s", "to s", "duration s", *(["epochs"] if are_long else [])],
                (
                    [
                        str(index),
                        f"{rest.start_s:.3f}",
                        f"{rest.end_s:.3f}",
                        f"{rest.end_s - rest.start_s:.3f}",
                        *([str(rest.epochs)] if are_long else []),
                    ]
                    for index, rest in enumerate(seen.rests)
                ),
            )
        out.line(seen.explanation)
        if are_long:
            out.line(
                "rests longer than 2 minutes are divided into epochs with a common pose: epochs show how the "
                "biases change with time and temperature, and together count as one pose"
            )
        out.findings(seen.findings)
        if not seen.usable:
            out.line("a calibration would refuse this recording")
        elif seen.missing is not None:
            out.line(f"this recording alone does not determine all parameters: {seen.missing}")
        else:
            out.line("this recording determines all parameters")
            if seen.through_moves:
                out.line(only_moves_determine(seen.through_moves))
        if seen.usable and seen.predicted_sigma:
            out.predicted(seen.predicted_sigma)
    if not all(seen.usable and seen.missing is None for seen in inspections):
        raise Exit(POOR_VERDICT)
