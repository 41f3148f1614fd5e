"""The page of a calibration: verdict, figures of the control record, parameters, and the paper's plots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from imucal.report.figures import carried_gravity_figure
from imucal.report.page import Section, write_page
from imucal.report.tables import judgement_table, parameter_table

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


def write_calibration_page(
    path: str | Path,
    *,
    title: str,
    verdict: str,
    parameters: Iterable[Mapping[str, Any]],
    truth: Mapping[str, float] | None = None,
    control_before: Mapping[str, float | None],
    control_after: Mapping[str, float | None],
    rest_time_s: ArrayLike,
    measured: ArrayLike,
    carried_uncalibrated: ArrayLike,
    carried_calibrated: ArrayLike,
) -> None:
    """Write the page of one calibration, judged on a control record that the fit never saw.

    Args:
        path: The HTML file.
        title: Heading of the page.
        verdict: One sentence.
        parameters: See `parameter_table`.
        truth: True values by parameter name, for simulated recordings.
        control_before: Figures of the control record, uncalibrated; see `judgement_table`.
        control_after: The same, calibrated.
        rest_time_s: (K,) times of the control rests, s.
        measured: (K, 3) gravity measured at them, m/s^2, as in `carried_gravity_figure`.
        carried_uncalibrated: (K, 3) gravity carried by the raw gyroscope, m/s^2.
        carried_calibrated: (K, 3) gravity carried by the calibrated gyroscope, m/s^2.

    Raises:
        ImucalError: plotly is not installed, or the file cannot be written.
    """
    plots = tuple(
        (
            carried_gravity_figure(axis, rest_time_s, measured, carried_uncalibrated, carried_calibrated),
            f"Gravity along body {axis} at the rests of the control record.",
        )
        for axis in AXES
    )
    sections = [
        Section("Control record", tables=(judgement_table(control_before, control_after),)),
        Section(
            "Parameters",
            text="measured = T true + bias, with T the sensitivity matrix of each sensor.",
            tables=(parameter_table(parameters, truth),),
        ),
        Section(
            "Gravity carried by the gyroscope",
            text="The gyroscope carries gravity from the first rest of the control record to every later "
            "one, and its errors add up, as they do for a user. The upper plot compares that with what the "
            "accelerometer measures at each rest; the lower one shows what is left after calibration.",
            figures=plots,
        ),
    ]
    write_page(path, title, sections, verdict=verdict, beside=_headline(control_before, control_after))


def _headline(before: Mapping[str, float | None], after: Mapping[str, float | None]) -> str:
    """The one figure that tells most, if it is known."""
    key = "gravity_direction_rms_deg"
    uncalibrated, calibrated = before.get(key), after.get(key)
    if uncalibrated is None or calibrated is None:
        return ""
    return (
        "On the control record the direction of gravity carried over a move is off by "
        f"{calibrated:.2g} deg rms, without calibration by {uncalibrated:.2g} deg."
    )
