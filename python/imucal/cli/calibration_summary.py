"""Text output of a calibration result for `imucal calibrate` and `imucal capture`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucal.cli.decisions import show_fit, show_rests_and_moves

if TYPE_CHECKING:
    from pathlib import Path

    from imucal.cli.output import Output
    from imucal.estimation.result import CalibrationResult

__all__ = ["show_calibration"]


def show_calibration(
    out: Output, result: CalibrationResult, saved: Path | None, require: str, *, verbose: bool = False
) -> None:
    """Print parameters, figures of merit, findings and verdict.

    A verdict worse than `require` ends the command with exit code 2.

    saved  path of the calibration file, if one was written
    """
    if verbose:
        show_fit(out, result.fit)
        show_rests_and_moves(out, result.rests, result.moves)
    out.parameters(result.parameters)
    out.line(result.used + (f"; calibration written to {saved}" if saved else ""))
    out.figures(
        {
            "calibration set": result.calibration_set,
            "held-out rests and moves": result.held_out,
            "control set": result.control_set,
        }
    )
    for note in result.notes:
        out.line(note)
    out.findings([*result.findings, *(result.control.findings if result.control else ())])
    out.judgement(result.judgement, verbose)
    out.verdict(result.verdict, result.reasons, require)
