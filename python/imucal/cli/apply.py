"""`imucal apply`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imucal.cli.output import JsonPath, Output
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working

__all__ = ["apply"]


@reading_options
def apply(
    calibration: Annotated[Path, typer.Argument(metavar="CAL.JSON", help="Calibration file.")],
    recording: Annotated[
        list[Path], typer.Argument(metavar="REC", help="The file, or the two files, of one recording.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Recording to write, .csv or .parquet.")],
    reading: Reading,
    json: JsonPath = None,
) -> None:
    """Correct a recording: SI units, body frame, the same column names.

    Example: imucal apply unit-0042.json run.csv -o corrected.csv
    """
    import imucal

    with working("correcting"):
        corrected = imucal.Calibration.load(calibration).apply_recording(reading.one(recording))
    with working("writing"):
        imucal.write(corrected, output)
    out = Output(json)
    out.document({"output": str(output), "calibration": str(calibration), "samples": len(corrected)})
    out.line(f"{output}: {corrected!r}")
