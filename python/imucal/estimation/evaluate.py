"""Evaluation of a calibration on recordings that were not used to estimate it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.figures import Figures, figures_text
from imucal.calibration.frame import in_frame
from imucal.calibration.model import SensorModel
from imucal.calibration.provenance import Provenance
from imucal.calibration.temperature import extrapolation, temperature_range
from imucal.calibration.triad import base_count
from imucal.calibration.verdict import ResidualFit, Verdict, verdict_of, worst
from imucal.document.date import now
from imucal.document.plain import plain, without_nan
from imucal.document.source import Source
from imucal.errors import InputError
from imucal.estimation.rests import Move, Rest, of_library, used_of
from imucal.finding import Finding
from imucal.notebook import html_of
from imucal.recording.one_unit import require_different
from imucal.recording.recording import Recording, as_recordings, require_sensors

if TYPE_CHECKING:
    from imucal.limits.judgement import Judgement
    from imucal.limits.limits import Limits

# Names of the parts (gyroscope, accel_bias, ...) without which corrected samples have errors. A calibration
# of another program may lack some of these parts.
ERRORS: Final = frozenset(
    {"gyroscope", *(f"{s}_{part}" for s in ("accel", "gyro") for part in ("bias", "scale", "misalignment"))}
)

__all__ = ["Evaluation", "evaluate", "evaluated", "evaluation_of", "require_judges"]

SCHEMA: Final = "imucal.evaluation/1"


@dataclass(frozen=True, eq=False, slots=True)
class PropagatedGravity:
    """Gravity at the rests of one recording, m/s^2 in the body frame.

    time_s        (K,) time of each rest, s
    measured      (K, 3) measured by the calibrated accelerometer
    uncalibrated  (K, 3) propagated from the first rest by the uncalibrated gyroscope
    calibrated    (K, 3) propagated from the first rest by the calibrated gyroscope
    """

    time_s: FloatArray
    measured: FloatArray
    uncalibrated: FloatArray
    calibrated: FloatArray


@dataclass(frozen=True, slots=True)
class JudgedRecording:
    """A recording on which a calibration was evaluated: its name, and the files from which it was read."""

    name: str
    files: tuple[Source, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """The evaluation of a calibration on recordings.

    figures       figures of merit of the calibration on these recordings
    before        figures of merit of the uncalibrated unit with its nominal sensitivity on these recordings
    rests, moves  the rests and moves of the recordings, in order of time
    carried       for each recording, gravity at its rests: measured by the accelerometer, and propagated from
                  the first rest by the gyroscope; empty for an accelerometer alone
    findings      warnings about the recordings
    verdict       `good`, `incomplete` or `poor`
    reasons       why the verdict is not good
    residuals     for each kind of residual, its rms and the rms expected from noise alone
    judgement     the checks of the calibration and these figures against limits; None without limits
    serial_number, provenance   serial number and provenance of the calibration
    recordings    name and files of each recording
    date          date of the evaluation, ISO 8601, UTC
    """

    figures: Figures
    before: Figures
    rests: tuple[Rest, ...]
    moves: tuple[Move, ...]
    carried: tuple[PropagatedGravity, ...]
    findings: tuple[Finding, ...]
    verdict: Verdict
    reasons: tuple[str, ...]
    residuals: tuple[ResidualFit, ...]
    judgement: Judgement | None = None
    serial_number: str | None = None
    provenance: Provenance = field(default_factory=Provenance)
    recordings: tuple[JudgedRecording, ...] = ()
    date: str = ""

    def judged_by(self, limits: Limits, calibration: Calibration) -> Evaluation:
        """The evaluation, with its figures and `calibration` checked against limits.

        Limits on the control set are compared with the figures of this evaluation.

        A failed check makes the verdict poor.
        """
        known, reasons = calibration.judged
        judged = (worst(known, self.verdict), (*reasons, *self.reasons))
        judgement = limits.judge(calibration, control_set=self.figures, verdict=judged)
        verdict, reasons = judgement.applied(self.verdict, self.reasons)
        return replace(self, judgement=judgement, verdict=verdict, reasons=reasons)

    def __repr__(self) -> str:
        moves = f" and {used_of(self.moves)} moves" if self.moves else ""
        used = f"{used_of(self.rests)} rests{moves} judged"
        return f"Evaluation({self.verdict}: {used}; {figures_text(self.figures) or 'no figures'})"

    def _repr_html_(self) -> str | None:
        """The HTML that a notebook displays for this object."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal evaluate --json`."""
        return {
            "schema": SCHEMA,
            "serial_number": self.serial_number,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "residuals": without_nan(self.residuals),
            "control_set": {"before": without_nan(self.before), "after": without_nan(self.figures)},
            "rests": without_nan(self.rests),
            "moves": without_nan(self.moves),
            "carried": without_nan(self.carried),
            "findings": [finding.to_dict() for finding in self.findings],
            "judgement": None if self.judgement is None else self.judgement.to_dict(),
            "recordings": plain(self.recordings),
            "imucal_version": str(_core.__version__),
            "date": self.date,
            "provenance": plain(self.provenance),
        }


def evaluate(
    calibration: Calibration,
    recordings: Recording | Sequence[Recording],
    *,
    min_rest_s: float = _core.MIN_REST_S,
) -> Evaluation:
    """Evaluate a calibration on recordings of the same unit that were not used to estimate it.

    Raises InputError for recordings with faults, for raw units other than those of the calibration, and for
    arguments of a wrong type. Raises NotEnoughMotionError for recordings without a rest.
    """
    require_calibration(calibration)
    judges = as_recordings(recordings)
    return evaluation_of(calibration, judges, evaluated(calibration, judges, min_rest_s))


def evaluated(calibration: Calibration, judges: Sequence[Recording], min_rest_s: float) -> _core.Evaluation:
    """Evaluate a calibration in the compiled library. Raises the same errors as `evaluate`."""
    require_judges(calibration, judges)
    if calibration.frame == "given" and calibration.covariance is not None and not calibration.effects:
        # The calibration is converted to the symmetric frame, because the library supports a covariance only
        # in the symmetric frame. The figures are the same in every body frame.
        calibration = in_frame(calibration, "symmetric")
    if calibration.gyroscope is None:
        nine = _covariance(calibration)
        return _core.evaluate_accelerometer(
            calibration.accelerometer,
            None if nine is None else (nine, calibration.frame),
            judges,
            calibration.gravity_mps2,
            min_rest_s,
        )
    for judge in judges:
        require_sensors(judge, "accelerometer", "gyroscope")
    corrected = [calibration.apply_recording(judge) for judge in judges] if calibration.effects else None
    covariance = _covariance(calibration)
    return _core.evaluate(
        calibration.without_user_effects(),
        None if covariance is None else (covariance, calibration.frame),
        judges,
        corrected,
        calibration.gravity_mps2,
        min_rest_s,
    )


def _covariance(calibration: Calibration) -> FloatArray | None:
    """The covariance of the biases and sensitivities; None if it is not known or the frame is "given"."""
    base = base_count(calibration.frame, has_gyroscope=calibration.gyroscope is not None)
    names = [parameter.name for parameter in calibration.parameters[:base]]
    if (
        calibration.frame == "given"
        or calibration.covariance is None
        or list(calibration.covariance_names[:base]) != names
    ):
        return None
    # Errors of the assumed gravity and of the clock affect the calibration and the control recordings
    # equally, so they cancel in the residuals. Therefore the covariance due to these errors is subtracted.
    values = np.array([parameter.value for parameter in calibration.parameters[:base]])
    common = calibration.references.covariance_of_base(calibration.gravity_mps2, values)
    return calibration.covariance[:base, :base] - common


def require_judges(model: SensorModel, judges: Sequence[Recording]) -> None:
    """Raise InputError unless `judges` are one or more different recordings in the raw units of `model`."""
    if not judges:
        raise InputError("there is no recording for the evaluation: give at least one")
    require_different(judges)
    for recording in judges:
        model.require_raw_units(recording)


def evaluation_of(
    calibration: Calibration, judges: Sequence[Recording], found: _core.Evaluation
) -> Evaluation:
    """Convert the output `found` of the compiled library to the Evaluation of a calibration."""
    return Evaluation(
        figures=Figures(**found.figures),
        before=Figures(**found.before),
        rests=tuple(of_library(Rest, fields) for fields in found.rests),
        moves=tuple(of_library(Move, fields) for fields in found.moves),
        carried=tuple(
            PropagatedGravity(c.time_s, c.measured, c.uncalibrated, c.calibrated) for c in found.carried
        ),
        findings=(
            *(f for r in judges for f in r.findings),
            *found.findings,
            *_seen_by_the_fit(calibration, judges),
            *_extrapolated(calibration, judges),
        ),
        verdict=verdict_of(found.verdict),
        reasons=(*found.reasons, *(_not_stated(calibration) if found.reasons else ())),
        residuals=tuple(of_library(ResidualFit, fields) for fields in found.residuals),
        serial_number=calibration.serial_number,
        provenance=calibration.provenance,
        recordings=tuple(JudgedRecording(judge.name, judge.sources) for judge in judges),
        date=now(),
    )


def _not_stated(calibration: Calibration) -> Iterator[str]:
    """Notes on parts that another program's calibration lacks, which may be the cause of large residuals."""
    imported = calibration.provenance.imported
    errors = [part for part in imported.missing if part in ERRORS] if imported is not None else []
    if imported is not None and errors:
        yield (
            f"the files of {imported.program} do not state {', '.join(errors).replace('_', ' ')}, so the "
            "corrected samples still contain these errors"
        )


def _seen_by_the_fit(calibration: Calibration, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Findings for recordings with a file that the fit has also used; files are recognised by their hash."""
    for recording in recordings:
        seen = len(calibration.provenance.seen_in(recording.sources))
        if seen:
            yield Finding(
                "seen_by_the_fit",
                "warning",
                recording.name,
                (),
                None,
                seen,
                float(seen),
                "files",
                "this calibration was estimated from the same file: unless the samples are from another "
                "part of the file, the figures say nothing about new data",
                "evaluate the calibration on another recording of the unit",
            )


def _extrapolated(calibration: Calibration, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Findings for recordings with temperatures outside the range of the calibration."""
    known_degc = calibration.temperature_range_degc
    # The temperatures of the recordings are compared only if an effect of the calibration depends on the
    # temperature.
    if known_degc is None or not calibration.temperature_effects:
        return
    low, high = known_degc
    for recording in recordings:
        seen_degc = temperature_range([recording])
        message = extrapolation(calibration, seen_degc)
        if seen_degc is not None and message is not None:
            lowest, highest = seen_degc
            yield Finding(
                code="temperature_extrapolated",
                severity="warning",
                recording=recording.name,
                columns=("temp_degc",),
                place=None,
                count=len(recording),
                value=lowest if low - lowest > highest - high else highest,
                unit="degC",
                message=message,
                way_out="evaluate within the range, or calibrate with recordings that cover it",
            )
