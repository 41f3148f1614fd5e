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
    """Correct a recording: SI units, body frame, the same column names; effects are taken away.

    Example: imucal apply unit-0042.json run.csv -o corrected.csv
    """
    import numpy as np

    import imucal

    with working("correcting"):
        unit = imucal.Calibration.load(calibration)
        raw = reading.one(recording)
        corrected = unit.apply_recording(raw)
    with working("writing"):
        imucal.write(corrected, output)
    removed = [effect.name for effect in unit.effects if effect.name not in unit.left_in_data]
    lost = np.isnan(corrected.angular_rate[:, 0]) & np.isfinite(raw.angular_rate).all(axis=1)
    lost &= np.isfinite(raw.specific_force).all(axis=1)
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "calibration": str(calibration),
            "samples": len(corrected),
            "effects": removed,
            "left_in_data": unit.left_in_data,
            "samples_lost": int(lost.sum()),
        }
    )
    out.line(f"{output}: {corrected!r}")
    if removed:
        out.line(f"effects taken away: {', '.join(removed)}")
    if unit.left_in_data:
        out.line(f"left in the data, as no error of the sensor: {', '.join(unit.left_in_data)}")
    if lost.any():
        out.line(
            f"warning: {lost.sum()} samples are empty, the first is sample {lost.argmax()}: the effects are "
            "too large there to be undone"
        )
