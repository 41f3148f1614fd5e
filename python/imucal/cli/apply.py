"""`imucal apply`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucal.cli.output import JsonPath, Output
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.calibration import Calibration
    from imucal.recording import Recording

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

    CSV and Parquet are corrected piece by piece, so that memory does not grow with the file; but for a lever
    arm or a delay, which need the change of the rate.

    Example: imucal apply unit-0042.json run.csv -o corrected.csv
    """
    import imucal
    from imucal.io import write_pieces

    unit = imucal.Calibration.load(calibration)

    def written(pieces: Iterator[Recording]) -> _Corrected:
        corrected = _Corrected(unit, pieces)
        write_pieces(corrected.whole, output)
        return corrected

    with working("correcting"):
        if unit.takes_pieces:
            corrected = reading.by_pieces(recording, written)
        else:
            corrected = written(iter([reading.one(recording)]))
    removed = [effect.name for effect in unit.effects if effect.name not in unit.left_in_data]
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "calibration": str(calibration),
            "samples": corrected.whole.samples,
            "effects": removed,
            "left_in_data": unit.left_in_data,
            "samples_lost": corrected.lost,
        }
    )
    out.line(f"{output}: {corrected.whole!r}")
    if removed:
        out.line(f"effects taken away: {', '.join(removed)}")
    if unit.left_in_data:
        out.line(f"left in the data, as no error of the sensor: {', '.join(unit.left_in_data)}")
    if corrected.lost:
        out.line(
            f"warning: {corrected.lost} samples are empty, the first is sample {corrected.first_lost}: the "
            "effects are too large there to be undone"
        )


class _Corrected:
    """Pieces of a recording, corrected as they pass, and the samples that are lost by it."""

    def __init__(self, unit: Calibration, pieces: Iterator[Recording]) -> None:
        from imucal.io.pieces import Whole

        self.whole = Whole(self._each(unit, pieces))
        self.lost = 0
        self.first_lost: int | None = None

    def _each(self, unit: Calibration, pieces: Iterator[Recording]) -> Iterator[Recording]:
        import numpy as np

        start_s: float | None = None
        before = 0
        for raw in pieces:
            if start_s is None and len(raw):
                start_s = float(raw.time_s[0])
            # Without a start for effects that take the whole: then there is one piece.
            corrected = unit.apply_recording(raw, start_s=start_s if unit.takes_pieces else None)
            lost = np.isnan(corrected.angular_rate[:, 0]) & np.isfinite(raw.angular_rate).all(axis=1)
            lost &= np.isfinite(raw.specific_force).all(axis=1)
            if self.first_lost is None and lost.any():
                self.first_lost = before + int(lost.argmax())
            self.lost += int(lost.sum())
            before += len(raw)
            yield corrected
