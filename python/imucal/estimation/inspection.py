"""Inspection of a recording: its properties, its faults, and the parameters that it determines."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.document.plain import without_nan
from imucal.errors import ImucalError
from imucal.estimation.calibrate import calibrate
from imucal.estimation.fit import RestThreshold
from imucal.estimation.options import Options
from imucal.estimation.rests import FittedRest, of_library
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.notebook import html_of
from imucal.recording.recording import Recording, as_recording
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Inspection", "inspect", "only_moves_determine"]


@dataclass(frozen=True, slots=True)
class FoundRest:
    """One rest: times of its first and last sample, s, and the number of its epochs.

    A rest of more than two minutes has several epochs, each with a separate mean, time and temperature.
    `excluded` is the reason why a calibration from this recording alone does not use the rest. It is None if
    the calibration uses the rest or fails.
    """

    start_s: float
    end_s: float
    epochs: int
    excluded: str | None = None


@dataclass(frozen=True, slots=True)
class PredictedSigma:
    """Predicted standard deviation of a parameter; None if the recording does not determine the parameter."""

    name: str
    std: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Inspection:
    """The inspection of one recording.

    accel_unit, gyro_unit   units of the samples; None for a sensor that the recording does not have
    findings      all findings of the checks; findings of severity "error" prevent a calibration
    rests         the rests, in order of time
    threshold     how the rests were detected; None without samples
    explanation   why this threshold of rest detection was chosen, or why there is no rest
    missing       the parameters that this recording alone does not determine, and the motion to add; None if
                  nothing is missing
    predicted_sigma   standard deviations of the 21 parameters, predicted from the motion and the noise at the
                      rests for sensors without errors; for an accelerometer alone, the standard deviations of
                      its nine parameters in a calibration from this recording
    through_moves     names of the accelerometer parameters that the rests alone do not determine, but the
                      rests together with the moves do. An example is a unit that rests only on the six faces
                      of a box
    """

    name: str
    samples: int
    duration_s: float
    rate_hz: float
    accel_unit: str | None
    gyro_unit: str | None
    findings: tuple[Finding, ...]
    rests: tuple[FoundRest, ...]
    threshold: RestThreshold | None
    explanation: str
    missing: str | None
    predicted_sigma: tuple[PredictedSigma, ...]
    through_moves: tuple[str, ...]

    def _repr_html_(self) -> str | None:
        """HTML for display in a notebook."""
        return html_of(self)

    @property
    def usable(self) -> bool:
        """Whether the recording has no fault that prevents a calibration."""
        return all(finding.severity != "error" for finding in self.findings)

    @property
    def rate_in_words(self) -> str:
        """The sampling rate with its unit, or why it is not known."""
        is_known = math.isfinite(self.rate_hz)
        return f"{self.rate_hz:.6g} Hz" if is_known else "rate unknown (most time steps are 0)"

    @property
    def sensors_in_words(self) -> str:
        """The sensors with the units of their samples."""
        units = {"accelerometer": self.accel_unit, "gyroscope": self.gyro_unit}
        words = [f"{sensor} in {unit}" for sensor, unit in units.items() if unit is not None]
        return ", ".join(words) if len(words) > 1 else f"{words[0]} alone"

    def to_dict(self) -> dict[str, Any]:
        """The inspection as an item of the JSON document of `imucal inspect --json`."""
        document: dict[str, Any] = without_nan(self)
        return {**document, "usable": self.usable}


def inspect(
    recording: Recording,
    *,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
    min_rest_s: float = _core.MIN_REST_S,
) -> Inspection:
    """Check a recording, detect its rests, and report which parameters it determines.

    Faults of the recording are reported as findings and do not raise an exception.
    """
    recording = as_recording(recording).without_copies()
    seen = _core.inspect(recording, gravity_mps2, min_rest_s)
    calibrated = _calibrated(recording, gravity_mps2, min_rest_s)
    missing = calibrated if isinstance(calibrated, str) else None
    left_out = () if isinstance(calibrated, str) else calibrated.rests
    through_moves: tuple[str, ...] = ()
    if recording.angular_rate is None:
        predicted_sigma = _of_accelerometer(recording, calibrated)
    else:
        predicted_sigma, through_moves = _predicted(
            recording, gravity_mps2, min_rest_s, _not_determined(missing or "")
        )
    return Inspection(
        name=recording.name,
        samples=len(recording),
        duration_s=recording.duration_s,
        rate_hz=recording.rate_hz,
        accel_unit=None if recording.specific_force is None else recording.accel_unit,
        gyro_unit=None if recording.angular_rate is None else recording.gyro_unit,
        findings=(*recording.findings, *seen.findings),
        rests=tuple(_found(FoundRest(*rest), left_out) for rest in seen.rests),
        threshold=None if seen.threshold is None else of_library(RestThreshold, seen.threshold),
        explanation=seen.explanation,
        missing=missing,
        predicted_sigma=predicted_sigma,
        through_moves=through_moves if missing is None else (),
    )


def only_moves_determine(names: Sequence[str]) -> str:
    """A sentence on the parameters `names`, which the rests determine only together with the moves."""
    return (
        f"the directions of gravity at the rests do not determine {', '.join(names)}; together with the "
        "moves between the rests they do"
    )


def _found(rest: FoundRest, of_calibration: Sequence[FittedRest]) -> FoundRest:
    """The rest with the reason why the calibration excludes it; unchanged if the calibration uses it."""
    middle = 0.5 * (rest.start_s + rest.end_s)
    for own in of_calibration:
        if own.start_s is not None and own.end_s is not None and own.start_s <= middle <= own.end_s:
            return replace(rest, excluded=own.excluded)
    return rest


def _calibrated(recording: Recording, gravity_mps2: float, min_rest_s: float) -> CalibrationResult | str:
    """Calibrate from this recording. Returns the result, or the message of the error if it fails.

    Only a complete calibration shows reliably whether the recording determines all parameters.
    """
    try:
        # Moves and rests with saturated samples are excluded here and not refused, because saturation is
        # already reported as a finding.
        return calibrate(recording, gravity_mps2=gravity_mps2, min_rest_s=min_rest_s, exclude_saturated=True)
    except ImucalError as error:
        return str(error)


def _of_accelerometer(
    recording: Recording, calibrated: CalibrationResult | str
) -> tuple[PredictedSigma, ...]:
    """Predicted sigmas of the parameters of an accelerometer alone; all None if the calibration fails."""
    if isinstance(calibrated, CalibrationResult):
        return tuple(PredictedSigma(p.name, p.std, p.unit) for p in calibrated.parameters)
    nominal = Calibration(Triad(np.eye(3), np.zeros(3)), None, accel_unit=recording.accel_unit)
    return tuple(PredictedSigma(p.name, None, p.unit) for p in nominal.parameters)


def _not_determined(missing: str) -> set[str]:
    """Names of the parameters that the message `missing` lists in words like "accelerometer's bias x"."""
    names = set()
    for sensor, listed in re.findall(r"not determine the (accel|gyro)\w*'s ([^:]*)", missing):
        for kind, axes in re.findall(r"(bias|scale|misalignment) ([xyz]+)\b", listed):
            name = f"bias_{axes}" if kind == "bias" else f"sensitivity_{axes if len(axes) == 2 else 2 * axes}"
            names.add(f"{sensor}_{name}")
    return names


def _predicted(
    recording: Recording, gravity_mps2: float, min_rest_s: float, not_determined: set[str]
) -> tuple[tuple[PredictedSigma, ...], tuple[str, ...]]:
    """Predict the standard deviations, and find the parameters that only the moves determine.

    Both returned tuples are empty for a recording with faults.

    A parameter in `not_determined` has no standard deviation, even if the data determine it in theory,
    because the calibration may lack a start value for it.
    """
    options = Options(gravity_mps2=gravity_mps2, min_rest_s=min_rest_s, exclude_saturated=True)
    try:
        prospect = _core.prospect([recording], options)
    except ImucalError:
        return (), ()
    nominal = Calibration(
        Triad(np.eye(3), np.zeros(3)),
        Triad(np.eye(3), np.zeros(3)),
        accel_unit=recording.accel_unit,
        gyro_unit=recording.gyro_unit,
    )
    predicted = tuple(
        PredictedSigma(parameter.name, None if parameter.name in not_determined else std, parameter.unit)
        for parameter, std in zip(nominal.parameters, prospect.predicted_sigma, strict=True)
    )
    return predicted, tuple(prospect.through_moves)
