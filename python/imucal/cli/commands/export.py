"""The command `imucal export`, which writes a calibration in the format of another program."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import imucal.cli.completion as completion
from imucal.cli.as_typed import as_typed
from imucal.cli.options import MIN_REST_S, Control, JsonPath, MinRest
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.streams import printable
from imucal.cli.working import working
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["export"]


@reading_options
def export(
    reading: Reading,
    calibration: Annotated[Path | None, argument(metavar="CAL", help="Calibration file.")] = None,
    to: Annotated[
        str | None,
        option(
            "--to", metavar="FORMAT", help="Format; --list shows all formats.", completion=completion.exports
        ),
    ] = None,
    output: Annotated[
        Path | None, option("--output", "-o", metavar="FILE", help="File to write; default: print.")
    ] = None,
    control: Control = None,
    noise: Annotated[
        Path | None,
        option("--noise", metavar="REC", help="Raw recording at rest, for formats with noise figures."),
    ] = None,
    name: Annotated[
        str | None,
        option(
            "--name",
            metavar="PREFIX",
            help="c-header, fusion: prefix of all C names; two units in one program need two prefixes.",
        ),
    ] = None,
    board_orientation: Annotated[
        str | None,
        option(
            "--board-orientation",
            metavar="N|R,P,Y",
            help="ardupilot: AHRS_ORIENTATION of the log that was calibrated, or its angles in deg.",
        ),
    ] = None,
    accel_lsb_per_g: Annotated[
        float | None,
        option(
            "--accel-lsb-per-g",
            metavar="X",
            help="inav: acc_1G of the sensor's driver; default 2048. blob: counts per g, for raw counts.",
        ),
    ] = None,
    gyro_lsb_per_dps: Annotated[
        float | None,
        option(
            "--gyro-lsb-per-dps",
            metavar="X",
            help="inav: counts per deg/s of the sensor's driver; default 16.4. blob: counts per deg/s, for "
            "raw counts.",
        ),
    ] = None,
    body_axes: Annotated[
        str | None,
        option(
            "--body-axes",
            metavar="AXES",
            help="blob: axes of the corrected samples in terms of the body frame, such as x,-y,-z.",
        ),
    ] = None,
    min_rest_s: MinRest = MIN_REST_S,
    show_formats: Annotated[
        bool, option("--list", help="List the formats with what they include and omit.")
    ] = False,
    json: JsonPath = None,
) -> None:
    """Write a calibration for another program: firmware, autopilots, estimators, simulators.

    Prints the parts of the calibration that the format omits. With --control, evaluates the calibration with
    and without these parts on a recording, and prints the errors, the findings and the verdict of `imucal
    evaluate`. Warns if the verdict on the calibration is not good.

    Example: imucal export unit-0042.json --to c-header -o calibration.h
    """
    import imucal
    from imucal.exporting import FORMATS, find_format

    if show_formats:
        out = Output(json)
        fields = {name: name for name in ("name", "title", "suffix", "formula", "source", "units")}
        fields |= {"carries": "includes", "loses": "omits"}
        out.document(
            {
                "formats": [
                    {field: getattr(form, name) for field, name in fields.items()}
                    for form in FORMATS.values()
                ]
            }
        )
        for form in FORMATS.values():
            out.line(f"{form.name}: {form.title} ({form.suffix})")
            out.line(f"    includes {form.includes}")
            out.line(f"    omits {form.omits}")
        return
    if calibration is None or to is None:
        raise InputError("give a calibration file and --to FORMAT: `imucal export --list` shows the formats")
    if output is None and json == "-":
        raise InputError(
            "--json - and the export would both use standard output: give a file for one of them (-o FILE)"
        )
    require_apart([calibration, *(control or ()), noise], {"--output": output, "--json": json})
    form = find_format(to)
    if output is None and form.is_binary:
        raise InputError(f"{form.name} is not a text: give a file for it (-o FILE)")
    with working("reading"):
        unit = imucal.Calibration.load(calibration)
        verdict, reasons = unit.judged
        judges = reading.each(control or [])
        figures = None if noise is None else _noise(unit, reading, noise, min_rest_s)
    with working("exporting"):
        exported = imucal.export(
            unit,
            to,
            noise=figures,
            name=name,
            board_orientation=board_orientation,
            accel_lsb_per_g=accel_lsb_per_g,
            gyro_lsb_per_dps=gyro_lsb_per_dps,
            body_axes=body_axes,
        )
        residual = exported.residual(judges, min_rest_s=min_rest_s) if judges else None
    if output is None:
        print(exported.text, end="")
    else:
        exported.save(output)
    out = Output(json)
    out.document(
        {
            "format": form.name,
            "output": None if output is None else str(output),
            "formula": exported.form.formula,
            "units": form.units,
            "lost": exported.lost,
            "verdict": verdict,
            "reasons": list(reasons),
            "poor": list(reasons) if verdict == "poor" else [],
            "control_set": None if residual is None else residual.to_dict(),
        }
    )
    if output is not None:
        out.line(f"{output}: {form.title}")
    if form.is_binary:
        # A binary file cannot contain the header that explains its contents, so this header is printed.
        print(printable(exported.text.rstrip()), file=sys.stderr)
    for reason in reasons:
        print(printable(f"warning: this calibration is {verdict}: {reason}"), file=sys.stderr)
    for loss in exported.lost:
        print(printable(f"not exported to {form.name}: {loss}"), file=sys.stderr)
    if residual is not None:
        print(printable(as_typed(residual.summary())), file=sys.stderr)
    elif judges:
        print(
            f"{form.name} corrects nothing, so there is nothing to evaluate on the control recording",
            file=sys.stderr,
        )


def _noise(unit: Calibration, reading: Reading, path: Path, min_rest_s: float) -> NoiseResult:
    """Estimate the noise figures of a raw recording at rest, after correction by the calibration."""
    import imucal

    return imucal.noise(unit.apply_recording(reading.one([path])), min_rest_s=min_rest_s)
