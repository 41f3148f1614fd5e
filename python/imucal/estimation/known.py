"""A calibrated accelerometer as a prior for the calibration of the gyroscope of the same unit.

A prior must be independent of the recordings. The fit updates the accelerometer with the rests of the
recordings, so a prior from one of these recordings would count its rests twice, and the standard deviations
would be too small. A fit of the gyroscope with a fixed accelerometer would count no data twice, but this
library does not have such a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.frame import in_frame
from imucal.calibration.triad import base_count
from imucal.calibration.verdict import worst
from imucal.errors import InputError
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.recording.recording import Recording

__all__ = ["KnownAccelerometer", "known_accelerometer", "require_other_files", "with_prior"]

# Type: the nine parameters of an accelerometer, and their covariance by rows.
KnownAccelerometer = tuple[list[float], list[list[float]]]


def known_accelerometer(calibration: Calibration, recordings: Sequence[Recording]) -> KnownAccelerometer:
    """The parameters of the accelerometer in the symmetric frame with their covariance.

    Raises InputError for a calibration without covariance, or with other units or axes than the recordings.
    """
    require_calibration(calibration)
    for recording in recordings:
        if recording.accel_unit != calibration.accel_unit:
            raise InputError(
                f"{recording.name}: the accelerometer is in {recording.accel_unit}, but the given "
                f"calibration expects {calibration.accel_unit}: give the recording in the same unit"
            )
        if recording.axes != calibration.axes:
            raise InputError(
                f"{recording.name} was read with the axes {recording.axes}, but the given calibration was "
                f"made from recordings with the axes {calibration.axes}: read the recording with the axes "
                f"{calibration.axes}"
            )
    if calibration.effects:
        raise InputError(
            f"the given calibration has the effect {calibration.effects[0].name}, but effects of a known "
            "accelerometer are not supported: calibrate without effects, or estimate both sensors together"
        )
    symmetric = in_frame(calibration, "symmetric")
    count = base_count("symmetric", has_gyroscope=False)
    names = [parameter.name for parameter in symmetric.parameters[:count]]
    known = dict(zip(symmetric.covariance_names, range(len(symmetric.covariance_names)), strict=True))
    if symmetric.covariance is None or not set(names) <= known.keys():
        raise InputError(
            "the given calibration has no covariance of its accelerometer: give a calibration file of "
            "imucal calibrate"
        )
    rows = [known[name] for name in names]
    covariance = symmetric.covariance[rows][:, rows]
    return [parameter.value for parameter in symmetric.parameters[:count]], covariance.tolist()


def require_other_files(
    calibration: Calibration, unit_data: Sequence[Recording], judges: Sequence[Recording]
) -> None:
    """Raise InputError if the given calibration was made from the file of one of the recordings.

    The calibration file contains the hashes of its recordings but not their samples, so a recording
    is recognised only if it was read from the same file. The file may have another name.
    """
    for recording in unit_data:
        _refuse_files(
            calibration,
            recording,
            "recordings_overlap",
            "the given calibration of the accelerometer was made from the same file, so these data would "
            "count twice and the standard deviations would be too small",
            "calibrate without the given calibration, or from another recording of the unit",
        )
    for judge in judges:
        _refuse_files(
            calibration,
            judge,
            "control_not_independent",
            "this control recording is from a file from which the given calibration of the accelerometer was "
            "made",
            "give another recording of the unit",
        )


def _refuse_files(
    calibration: Calibration,
    recording: Recording,
    code: Literal["recordings_overlap", "control_not_independent"],
    message: str,
    way_out: str,
) -> None:
    seen = len(calibration.provenance.seen_in(recording.sources))
    if seen:
        finding = Finding(
            code, "error", recording.name, (), None, seen, float(seen), "files", message, way_out
        )
        raise InputError(str(finding), [finding])


def with_prior(result: CalibrationResult, calibration: Calibration) -> CalibrationResult:
    """The result with the origin and the verdict of the calibration that was its prior.

    The verdict of the result is not better than that of the prior calibration. If the residuals of the prior
    calibration exceed their noise, its covariance is too small, and so are the standard deviations of the
    result.
    """
    found, prior = result.calibration, calibration.provenance
    known, why = calibration.judged
    verdict = worst(known, result.verdict)
    reasons = result.reasons
    if known != "good":
        reasons = (": ".join((f"the given calibration of the accelerometer is {known}", *why[:1])), *reasons)
    files = tuple(dict.fromkeys((*found.provenance.files, *prior.files)))
    return replace(
        result,
        calibration=replace(
            found, verdict=verdict, reasons=reasons, provenance=replace(found.provenance, files=files)
        ),
        verdict=verdict,
        reasons=reasons,
        accelerometer_of=prior,
    )
