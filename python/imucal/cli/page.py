"""The page of a calibration result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration_result import CalibrationResult

__all__ = ["write_result_page"]


def write_result_page(
    path: Path,
    title: str,
    result: CalibrationResult,
    truth: Mapping[str, float] | None = None,
) -> None:
    """Write the page of a calibration; the first of its control recordings is drawn.

    Raises InputError without a control recording, ImucalError without plotly.
    """
    from imucal.report import write_calibration_page

    judged = result.control
    if judged is None:
        raise InputError("the page shows control recordings: give one with --control")
    carried = judged.carried[0]
    write_calibration_page(
        path,
        title=title,
        verdict="; ".join((f"Verdict: {result.verdict}", *result.reasons)),
        parameters=[asdict(parameter) for parameter in result.parameters],
        truth=truth,
        control_before=judged.before,
        control_after=judged.figures,
        rest_time_s=carried["time_s"],
        measured=carried["measured"],
        carried_uncalibrated=carried["uncalibrated"],
        carried_calibrated=carried["calibrated"],
    )
