"""HTML that notebooks show for a result: verdict and tables. Plots come from `imucal.plot`."""

from __future__ import annotations

from functools import singledispatch
from html import escape
from typing import Any

import numpy as np

import imucal.report.sentences as sentences
from imucal.calibration.calibration import Calibration
from imucal.estimation.evaluate import Evaluation
from imucal.estimation.inspection import Inspection
from imucal.estimation.result import CalibrationResult
from imucal.gap import Gap
from imucal.noise_analysis.noise import NoiseResult
from imucal.plot.style import shown_unit
from imucal.recording.recording import Recording
from imucal.report.blocks import finding_texts
from imucal.report.gap_tables import effects_table, gap_figures_table
from imucal.report.inspection_page import predicted_table, rests_table
from imucal.report.noise_page import noise_table
from imucal.report.page import MARKS, Verdict
from imucal.report.tables import checks_table, figures_table, item_list, paragraph, parameter_table, table


@singledispatch
def html_of(result: Any) -> str:
    """The HTML that a notebook shows for a result."""
    raise TypeError(f"a {type(result).__name__} has no page")


@html_of.register
def of_calibration(calibration: Calibration) -> str:
    """HTML for a calibration: its frame and the table of its parameters."""
    unit = f" of unit {calibration.serial_number}" if calibration.serial_number else ""
    return paragraph(f"Calibration{unit}, {calibration.frame} frame") + parameter_table(
        calibration.parameters
    )


@html_of.register
def of_calibration_result(result: CalibrationResult) -> str:
    """Verdict, figures of merit, checks against limits, parameters, and notes."""
    sets = {
        "control, uncalibrated": result.control_before,
        "control, calibrated": result.control_set,
        "calibration set": result.calibration_set,
    }
    checks = "" if result.judgement is None else checks_table(result.judgement)
    return (
        _lead(sentences.of_calibration(result))
        + figures_table(sets)
        + checks
        + parameter_table(result.parameters)
        + item_list(result.notes)
    )


@html_of.register
def of_evaluation(judged: Evaluation) -> str:
    """Verdict, figures of merit, and checks against limits."""
    checks = "" if judged.judgement is None else checks_table(judged.judgement)
    sets = {"uncalibrated": judged.before, "calibrated": judged.figures}
    return _lead(sentences.of_evaluation(judged)) + figures_table(sets) + checks


@html_of.register
def of_noise(noise: NoiseResult) -> str:
    """Verdict and noise figures."""
    return _lead(sentences.of_noise(noise)) + noise_table(noise)


@html_of.register
def of_inspection(seen: Inspection) -> str:
    """Verdict (whether the recording determines all parameters), findings, rests, and predicted accuracy."""
    return (
        _lead(sentences.of_inspection(seen))
        + item_list(finding_texts(seen.findings))
        + rests_table(seen)
        + predicted_table(seen)
    )


@html_of.register
def of_recording(recording: Recording) -> str:
    """Number of samples, duration, rate, and the smallest, mean and largest value of every column."""
    columns: list[tuple[str, str, Any]] = []
    for prefix, samples, unit in (
        ("accel", recording.specific_force, recording.accel_unit),
        ("gyro", recording.angular_rate, recording.gyro_unit),
    ):
        if samples is not None:
            columns += [(f"{prefix}_{axis}", unit, samples[:, k]) for k, axis in enumerate("xyz")]
    if recording.temperature_degc is not None:
        columns.append(("temperature", "°C", recording.temperature_degc))
    columns += [(name, "", values) for name, values in recording.auxiliary.items()]
    rows = [[name, *_range(values), shown_unit(unit) or "-"] for name, unit, values in columns]
    words = recording.said(len(recording), recording.duration_s)
    return paragraph(words) + table(["column", "smallest", "mean", "largest", "unit"], rows)


def _range(values: Any) -> list[str]:
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return ["-", "-", "-"]
    return [f"{value:.5g}" for value in (known.min(), known.mean(), known.max())]


@html_of.register
def of_gap(gap: Gap) -> str:
    """Verdict, effects added to the model, figures of merit without and with the effects, and notes."""
    return _lead(sentences.of_gap(gap)) + effects_table(gap) + gap_figures_table(gap) + item_list(gap.notes)


def _lead(verdict: Verdict) -> str:
    return f"<p>{MARKS[verdict.mood]} <strong>{escape(verdict.sentence)}</strong></p>" + paragraph(
        verdict.beside
    )
