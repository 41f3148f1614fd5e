"""The outcome of one job, in the form that processes send and the store contains."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.estimation.result import CalibrationResult
from imucal.fleet.job import KeyedJob

__all__ = [
    "TRANSIENT",
    "Measured",
    "Outcome",
    "document_of",
    "full_covariance",
    "measured_of",
]

# Codes of failures that can disappear in a later run, because their cause was a file that was missing or was
# changed during the run. A later run computes jobs with these failures again.
TRANSIENT: Final = ("file_missing", "file_changed")
# Compression level of zlib for the stored documents. Level 1 takes a fifth of the time of level 6, and its
# output is larger by a tenth.
LEVEL: Final = 1


@dataclass(frozen=True)
class Measured:
    """The part of a calibration result that the store contains.

    names      names of the parameters, each with its unit
    values, sigmas   values and standard deviations, float64, in the order of `names`; NaN if a sigma is not
                     known
    covariance   upper triangle by rows, float64; None if it is not known
    figures      figures of merit on the calibration recordings, and with the prefix `control_` those on the
                 control recordings
    document     compressed JSON with the calibration file, its checks against limits, and the result of the
                 search for an effect that the calibration does not include
    """

    reasons: tuple[str, ...]
    findings: tuple[str, ...]
    accel_unit: str
    gyro_unit: str
    temperature_degc: tuple[float, float] | None
    figures: Mapping[str, float | None]
    names: tuple[tuple[str, str], ...]
    values: bytes
    sigmas: bytes
    covariance: bytes | None
    document: bytes
    gap_verdict: str | None = None
    gap_effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The outcome of a job.

    verdict   good, incomplete or poor; failed, if there is no result; poisoned, if every process that
              computed the job ended without an answer
    code      code of a failure: the code of the finding, or the kind of error
    message   message of a failure, or None
    seconds   duration of the computation, s
    measured  data of the calibration; None for a failure
    """

    keyed: KeyedJob
    verdict: str
    code: str | None = None
    message: str | None = None
    seconds: float | None = None
    measured: Measured | None = None

    @property
    def has_result(self) -> bool:
        """Whether the job has a calibration."""
        return self.measured is not None


def measured_of(result: CalibrationResult, gap: Any = None) -> Measured:
    """The part of a calibration result, and of a search for a missing effect, that the store contains."""
    calibration = result.calibration
    parameters = result.parameters
    names = tuple(parameter.name for parameter in parameters)
    document = calibration.to_dict()
    covariance = None
    if calibration.covariance is not None:
        matrix = _in_order(calibration.covariance, calibration.covariance_names, names)
        covariance = matrix[np.triu_indices(len(names))].tobytes()
        # The covariance is stored as the upper triangle of a matrix in the order of `names`. If the matrix in
        # the document has the same order of parameters, it is removed from the document, so that it is stored
        # only once.
        if calibration.covariance_names == names and np.array_equal(matrix, matrix.T):
            document["covariance"]["matrix"] = None
    temperature = calibration.temperature_range_degc
    if gap is not None:
        gap = gap.to_dict()
    text = json.dumps(
        {
            "calibration": document,
            "judgement": None if result.judgement is None else result.judgement.to_dict(),
            "gap": gap,
        },
        separators=(",", ":"),
    )
    findings = (*result.findings, *(result.control.findings if result.control else ()))
    return Measured(
        reasons=result.reasons,
        findings=tuple(dict.fromkeys(finding.code for finding in findings)),
        accel_unit=calibration.accel_unit,
        gyro_unit=calibration.gyro_unit,
        temperature_degc=temperature,
        figures=_figures(result),
        names=tuple((parameter.name, parameter.unit) for parameter in parameters),
        values=np.array([parameter.value for parameter in parameters], dtype="<f8").tobytes(),
        sigmas=np.array(
            [np.nan if parameter.std is None else parameter.std for parameter in parameters], dtype="<f8"
        ).tobytes(),
        covariance=covariance,
        document=zlib.compress(text.encode(), LEVEL),
        gap_verdict=None if gap is None else gap["verdict"],
        gap_effects=() if gap is None else tuple(effect["name"] for effect in gap["effects"]),
    )


def document_of(document: bytes, covariance: bytes | None) -> dict[str, Any]:
    """The decompressed JSON document of a stored result; keys: `calibration`, `judgement` and `gap`."""
    content: dict[str, Any] = json.loads(zlib.decompress(document))
    stored = content["calibration"]["covariance"]
    if stored is not None and stored["matrix"] is None and covariance is not None:
        stored["matrix"] = full_covariance(covariance, len(stored["names"]))[0].tolist()
    return content


def full_covariance(upper: bytes, size: int) -> FloatArray:
    """Symmetric matrices, (n, size, size), from their upper triangles, which are stored by rows."""
    rows, columns = np.triu_indices(size)
    numbers = np.frombuffer(upper, dtype="<f8").reshape(-1, len(rows))
    matrices = np.empty((len(numbers), size, size))
    matrices[:, rows, columns] = numbers
    matrices[:, columns, rows] = numbers
    return matrices


def _in_order(covariance: FloatArray, own: tuple[str, ...], names: tuple[str, ...]) -> FloatArray:
    """Reorder a covariance from the parameter order `own` to `names`; NaN for a parameter not in `own`."""
    if own == names:
        return covariance
    place = {name: index for index, name in enumerate(own)}
    matrix = np.full((len(names), len(names)), np.nan)
    rows = [index for index, name in enumerate(names) if name in place]
    found = [place[names[index]] for index in rows]
    matrix[np.ix_(rows, rows)] = covariance[np.ix_(found, found)]
    return matrix


def _figures(result: CalibrationResult) -> dict[str, float | None]:
    figures: dict[str, float | None] = {}
    for prefix, given in (("", result.calibration_set), ("control_", result.control_set)):
        fields = without_nan(given) or {}
        figures |= {f"{prefix}{name}": value for name, value in fields.items()}
    for residual in result.residuals:
        figures[f"residual_{residual.kind}_ratio"] = without_nan(residual.ratio)
    return figures
