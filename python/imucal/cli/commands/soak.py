"""The command `imucal soak`, which finds how biases depend on temperature, from a recording at rest."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imucal.cli.options import JsonPath, ReportPath, UnitsOption, UnitSystem
from imucal.cli.output import Output, prepare_report, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.gap.soak_result import Soak

__all__ = ["soak"]


@reading_options
def soak(
    recording: Annotated[
        list[Path], argument(metavar="REC", help="Recording at rest in one pose, with temperatures.")
    ],
    reading: Reading,
    calibration: Annotated[
        Path | None,
        option("--calibration", metavar="CAL", help="Calibration of the unit, to correct the readings with."),
    ] = None,
    report: ReportPath = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Find how the biases of a unit at rest in one pose depend on temperature: polynomial, lag, hysteresis.

    The recording is divided into intervals (epochs). Models are compared by how well they predict epochs to
    which they were not fitted. If the time stamps of a file are wrong, leave the time column out and give
    --rate-hz.

    Example: imucal soak sweep.csv --calibration unit-0042.json --report soak.html
    """
    import imucal

    require_apart([*recording, calibration], {"--report": report, "--json": json})
    prepare_report(report)
    known = None if calibration is None else imucal.Calibration.load(calibration)
    with working("reading"):
        loaded = reading.one(recording)
    with working("comparing models of the temperature"):
        found = imucal.soak(loaded, calibration=known)
    out = Output(json, units)
    out.document(found.to_dict())
    _print(out, found)
    if report is not None:
        from imucal.report import write_soak_page

        write_soak_page(report, found)
        out.line(f"written to {report}")


def _print(out: Output, found: Soak) -> None:
    low, high = found.temperature_degc.min(), found.temperature_degc.max()
    out.line(f"{found.name}: {len(found.time_s)} epochs, {low:.1f} to {high:.1f} degC")
    for sensor in found.sensors:
        out.line(f"{sensor.sensor}: {sensor.described or 'no dependence on temperature'}")
        left = ", ".join(
            f"{axis} {100 * share:.0f} %" for axis, share in zip("xyz", sensor.left, strict=True)
        )
        out.line(f"  residual on held-out epochs, relative to that of one cubic in the temperature: {left}")
    parameters = [parameter for sensor in found.sensors for parameter in sensor.parameters]
    if parameters:
        out.parameters(parameters)
