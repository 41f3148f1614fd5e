"""`imucal fleet report` and `certificate`: write a page about all units, or the certificate of one unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from imucal.cli.fleet_selection import Selection, StorePath, selection_options, store_of
from imucal.cli.options import JsonPath, writing_option
from imucal.cli.output import Output, prepare_report
from imucal.cli.parameters import argument, option
from imucal.errors import InputError

__all__ = ["certificate", "report"]


@selection_options
def report(
    store: StorePath,
    output: Annotated[Path, writing_option("HTML page to write; needs plotly.", metavar="PAGE")],
    limits: Annotated[
        Path | None, option("--limits", metavar="LIMITS", help="Limits to which the capability refers.")
    ] = None,
    title: Annotated[str, option("--title", help="Heading of the page.")] = "Fleet",
    reload_s: Annotated[
        float | None,
        option("--reload", metavar="S", help="The browser loads the page again after this time."),
    ] = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Write one self-contained page: yield, parameters over time, odd and drifting units, capability.

    Example: imucal fleet report units.sqlite --limits limits.json -o fleet.html
    """
    import imucal
    from imucal.report import write_fleet_page

    fleet = store_of(store, output=output, json=json)
    if reload_s is not None and not 1.0 <= reload_s < float("inf"):
        raise InputError(f"--reload is {reload_s:g}: give 1 s or more")
    prepare_report(output)
    wanted = None if limits is None else imucal.Limits.load(limits)
    write_fleet_page(output, fleet, limits=wanted, title=title, reload_s=reload_s, **selection.given)
    out = Output(json)
    size = output.stat().st_size
    out.document({"schema": "imucal.fleet-report/1", "page": str(output), "bytes": size})
    out.line(f"page written to {output}")


def certificate(
    store: StorePath,
    serial: Annotated[str, argument(metavar="SERIAL", help="Serial number of the unit.")],
    output: Annotated[Path, writing_option("Page to write, HTML or PDF.", metavar="PAGE")],
    limits: Annotated[
        Path | None, option("--limits", metavar="LIMITS", help="Limits against which the unit is judged.")
    ] = None,
    json: JsonPath = None,
) -> None:
    """Write the certificate of a unit: values, standard deviations, conditions, limits, verdict, file hashes.

    The page fills one sheet. If the name ends in .pdf, an installed browser (Chromium, Chrome or Edge) prints
    it without a window.

    Example: imucal fleet certificate units.sqlite 0042 --limits limits.json -o 0042.html
    """
    import imucal
    from imucal.report import calibration_hash, write_certificate

    fleet = store_of(store, output=output, json=json)
    calibration = fleet.calibration(serial)
    wanted = None if limits is None else imucal.Limits.load(limits)
    write_certificate(output, calibration, limits=wanted, conditions=fleet.conditions_of(serial))
    out = Output(json)
    digest = calibration_hash(calibration)
    out.document(
        {
            "schema": "imucal.fleet-certificate/1",
            "page": str(output),
            "serial_number": serial,
            "sha256": digest,
        }
    )
    out.line(f"{output}: unit {serial}, SHA-256 of the calibration {digest}")
