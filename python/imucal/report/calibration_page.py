"""The report of a calibration, and the report of an evaluation on further recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import imucal.plot as plot
import imucal.report.sentences as sentences
from imucal.calibration.verdict import RESIDUALS
from imucal.errors import InputError
from imucal.report.blocks import coverage_tab, finding_texts, limits_tabs, propagated_tab, residuals
from imucal.report.meaning import meanings
from imucal.report.page import Shown, Tab, write_page
from imucal.report.parameter_matrix import parameter_matrix
from imucal.report.tables import figures_table, heading, item_list, paragraph, parameter_table, table

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.calibration.verdict import ResidualFit
    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.result import CalibrationResult

__all__ = ["write_calibration_page", "write_evaluation_page"]


def write_calibration_page(
    path: str | Path,
    result: CalibrationResult,
    *,
    title: str | None = None,
    truth: Mapping[str, float] | None = None,
) -> None:
    """Write the report of a calibration.

    path    the HTML file
    title   heading of the page; by default the serial number, or the name of the first recording
    truth   true parameter values by name, which are known for simulated recordings

    Raises ImucalError if plotly is not installed, and InputError if the file cannot be written.
    """
    calibration = result.calibration
    tabs = [
        Tab("Summary", (parameter_matrix(calibration), *_summary(result), *_provenance(calibration))),
        Tab("Parameters", tuple(_parameters(result, truth))),
        *limits_tabs(result.judgement),
        _sphere_tab(result),
    ]
    # Without a gyroscope, gravity cannot be propagated, so there is no tab of propagated gravity.
    if result.control is not None and result.control.carried:
        tabs.append(propagated_tab(result.control))
    left: list[Shown | str] = [
        *_histogram(result),
        heading("Recordings of the calibration"),
        *residuals(result, "calibration"),
    ]
    if result.control is not None:
        left += [heading("Control recordings"), *residuals(result.control, "control")]
    tabs.append(Tab("Residuals", tuple(left)))
    footer = f"{title or _title(calibration)}, {str(calibration.provenance.date)[:10]}"
    write_page(path, title or _title(calibration), tabs, sentences.of_calibration(result), footer=footer)


def write_evaluation_page(
    path: str | Path, judged: Evaluation, *, title: str = "Calibration evaluated on further recordings"
) -> None:
    """Write the report of an evaluation on recordings that were not used for the calibration.

    Raises ImucalError if plotly is not installed, and InputError if the file cannot be written.
    """
    tabs = [
        Tab(
            "Summary",
            (
                figures_table({"uncalibrated": judged.before, "calibrated": judged.figures}),
                *_reasons(judged.verdict, judged.reasons),
                *_beside_noise(judged.residuals),
                *_remarks(finding_texts(judged.findings)),
            ),
        ),
        *limits_tabs(judged.judgement),
        *([propagated_tab(judged)] if judged.carried else []),
        Tab("Residuals", tuple(residuals(judged, "control"))),
        coverage_tab(judged),
    ]
    write_page(path, title, tabs, sentences.of_evaluation(judged))


def _parameters(result: CalibrationResult, truth: Mapping[str, float] | None) -> Iterator[Shown | str]:
    calibration = result.calibration
    yield paragraph("measured = T true + bias, with T the sensitivity matrix of each sensor.")
    yield parameter_table(result.parameters, truth)
    yield from meanings([effect.name for effect in calibration.effects])
    yield Shown(
        "parameters",
        plot.parameters(result),
        "Every parameter with an error bar of ±1 σ.",
        printed=False,
    )
    yield Shown("sigmas", plot.sigmas(result), "Standard deviation of every parameter.", printed=False)
    if calibration.covariance is not None:
        yield Shown(
            "correlations",
            plot.correlations(calibration),
            "Correlation of the parameters: 1 (blue) means that the recordings determine only the difference "
            "of two parameters, and −1 (orange) only their sum.",
        )
        pairs = plot.largest_correlations(calibration)
        if pairs:
            yield table(["largest correlations", ""], [[f"{a}, {b}", f"{rho:.2f}"] for a, b, rho in pairs])


def _sphere_tab(result: CalibrationResult) -> Tab:
    """Tab with the sphere of poses, and the norm of gravity at the rests before and after calibration."""
    covered = coverage_tab(result)
    if not any(rest.excluded is None and rest.norm_error_mps2 is not None for rest in result.rests):
        return covered
    figure, factor = plot.sphere_before_and_after(result)
    zero = (
        " Before the calibration, the counts of all axes are converted with one scale and one bias."
        if result.calibration.accel_unit == "lsb"
        else ""
    )
    caption = (
        "Gravity at each rest before and after the calibration. The sphere has the radius g, and the "
        f"distance of a point from it is |f| − g, magnified {factor:.3g} times.{zero}"
    )
    sphere = Shown("sphere", figure, caption, printed=False)
    return Tab(covered.heading, (sphere, *covered.content))


def _histogram(result: CalibrationResult) -> list[Shown]:
    try:
        figure = plot.histogram(result)
    except InputError:
        # A calibration from a table of mean readings has no histogram if the noise of the means is not known.
        return []
    caption = (
        "Residuals in standard deviations of their noise. If noise alone explains the residuals, the bars "
        "follow the curve. The outermost bars also contain all residuals beyond them."
    )
    return [Shown("histogram", figure, caption)]


def _summary(result: CalibrationResult) -> list[str]:
    sets = {
        "control, uncalibrated": result.control_before,
        "control, calibrated": result.control_set,
        "held out": result.held_out,
        "calibration set": result.calibration_set,
    }
    remarks = [*result.notes, *finding_texts(result.findings)]
    if result.control is not None:
        remarks += finding_texts(result.control.findings)
    beside_noise = _beside_noise(result.residuals)
    return [figures_table(sets), *_reasons(result.verdict, result.reasons), *beside_noise, *_remarks(remarks)]


def _reasons(verdict: str, reasons: Sequence[str]) -> list[str]:
    """The list of reasons; empty for a single reason, which is in the verdict at the top of the page."""
    return [heading(f"Why it is {verdict}"), item_list(reasons)] if len(reasons) > 1 else []


def _beside_noise(residuals: Sequence[ResidualFit]) -> list[str]:
    """For each kind of residual, the measured rms and the rms that noise explains, as a table."""
    rows = [
        [RESIDUALS[own.kind], f"{own.rms:.3g} {own.unit}", f"{own.noise:.3g} {own.unit}", f"{own.ratio:.2g}"]
        for own in residuals
        if own.rms is not None and own.noise is not None and own.ratio is not None
    ]
    headings = ["rms of the residuals of", "measured", "explained by noise", "ratio"]
    return [heading("Residuals beside their noise"), table(headings, rows)] if rows else []


def _remarks(remarks: Sequence[str]) -> list[str]:
    return [heading("Notes"), item_list(remarks)] if remarks else []


def _provenance(calibration: Calibration) -> list[str]:
    origin = calibration.provenance
    temperature = calibration.temperature_range_degc
    rows = [
        ["serial number", calibration.serial_number or ""],
        ["recordings", ", ".join(source.path for source in origin.files)],
        ["control recordings", ", ".join(source.path for source in origin.control_files)],
        ["body frame", calibration.frame],
        ["local gravity", f"{calibration.gravity_mps2:.6g} m/s²"],
        ["temperature", "" if temperature is None else f"{temperature[0]:.1f} to {temperature[1]:.1f} °C"],
        ["made", f"{origin.date}, imucal {origin.imucal_version}"],
    ]
    return [heading("Provenance"), table(["", ""], [row for row in rows if row[1]], words=(1,))]


def _title(calibration: Calibration) -> str:
    if calibration.serial_number:
        return f"Calibration of unit {calibration.serial_number}"
    files = calibration.provenance.files
    return f"Calibration from {Path(files[0].path).name}" if files else "Calibration"
