"""Calibrating one unit from its recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration import Calibration, Frame, Parameter, Provenance, Triad, as_frame
from imucal.document import without_nan
from imucal.errors import InputError
from imucal.evaluate import (
    FIGURES,
    MIN_REST_S,
    MOVE,
    REST,
    THRESHOLD,
    Evaluation,
    evaluate,
    fields_of,
    figures_text,
    poor_figures,
    reported,
)
from imucal.finding import Finding
from imucal.recording import STANDARD_GRAVITY_MPS2, Recording, Source

__all__ = ["CalibrationResult", "calibrate"]

FIT = ("chi2", "degrees_of_freedom", "inflation", "iterations", "termination")
MOST_FOLDS = 1000


@dataclass(frozen=True)
class Options:
    """What the library is told; it reads the fields by name."""

    gravity_mps2: float
    frame: Frame
    min_rest_s: float
    exclude_saturated: bool
    accel_nominal: float | None
    gyro_nominal: float | None


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A calibration and all that is known about it.

    rests, moves   one mapping for each, in order of time; `excluded` says why one takes no part
    findings       warnings about the recordings
    held_out       gravity direction on moves that the fit had not seen, if folds were asked for
    control        the calibration judged on the control recordings, if there are any
    reasons        why the verdict is poor; empty for a good one
    """

    calibration: Calibration
    rests: tuple[Mapping[str, Any], ...]
    moves: tuple[Mapping[str, Any], ...]
    findings: tuple[Finding, ...]
    held_out: Mapping[str, Any] | None
    control: Evaluation | None
    reasons: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """`good` or `poor`."""
        return "poor" if self.reasons else "good"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 21 parameters with their standard deviations."""
        return self.calibration.parameters

    @property
    def fit(self) -> Mapping[str, Any]:
        """How the estimation went."""
        return self.calibration.fit

    @property
    def calibration_set(self) -> Mapping[str, Any] | None:
        """Figures on the recordings that the calibration was made of."""
        return self.calibration.calibration_set

    @property
    def control_set(self) -> Mapping[str, Any] | None:
        """Figures on the control recordings, None without any."""
        return self.calibration.control_set

    @property
    def control_before(self) -> Mapping[str, Any] | None:
        """Figures on the control recordings of the unit as it comes, None without any."""
        return None if self.control is None else self.control.before

    @property
    def notes(self) -> tuple[str, ...]:
        """What a careful reader should know: rests and moves left out, and standard deviations widened."""
        notes = [
            f"rest {index} ({rest['start_s']:.2f} s to {rest['end_s']:.2f} s) of {rest['recording']} "
            f"left out: {rest['excluded']}"
            for index, rest in enumerate(self.rests)
            if rest["excluded"] is not None
        ]
        notes += [
            f"move from rest {move['from_rest']} to {move['to_rest']} of {move['recording']} left out: "
            f"{move['excluded']}"
            for move in self.moves
            if move["excluded"] is not None
        ]
        notes += [
            f"standard deviations of the {sensor} are widened {self.fit[sensor]['inflation']:.1f} times: "
            "by so much its residuals exceed what noise explains"
            for sensor in ("accelerometer", "gyroscope")
            if self.fit[sensor]["inflation"] > 1
        ]
        return tuple(notes)

    def summary(self) -> str:
        """The parameters, the figures and the verdict as plain text."""
        lines = ["parameter                        value        1 sigma  unit"]
        for parameter in self.parameters:
            std = "not known" if parameter.std is None else f"{parameter.std:.2e}"
            lines.append(f"{parameter.name:<24} {parameter.value:>13.7g} {std:>14}  {parameter.unit}")
        used = [sum(item["excluded"] is None for item in items) for items in (self.rests, self.moves)]
        lines.append(f"{used[0]} of {len(self.rests)} rests and {used[1]} of {len(self.moves)} moves used")
        for name, figures in (
            ("calibration set", self.calibration_set),
            ("held-out moves", self.held_out),
            ("control set", self.control_set),
        ):
            if figures is not None:
                lines.append(f"{name}: {figures_text(figures)}")
        lines += self.notes
        lines += [f"{finding.severity}: {finding}" for finding in self.findings]
        lines.append("; ".join((f"verdict: {self.verdict}", *self.reasons)))
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal calibrate --json`."""
        document = self.calibration.to_dict()
        fields = ("parameters", "accelerometer", "gyroscope", "fit", "calibration_set", "control_set")
        return {
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            **{name: document[name] for name in fields},
            "held_out": without_nan(self.held_out),
            "rests": without_nan(self.rests),
            "moves": without_nan(self.moves),
            "findings": without_nan([finding.to_dict() for finding in self.findings]),
        }


def calibrate(
    recordings: Recording | Sequence[Recording],
    *,
    control: Recording | Sequence[Recording] | None = None,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
    frame: Frame | str = "symmetric",
    min_rest_s: float = MIN_REST_S,
    exclude_saturated: bool = False,
    accel_nominal: float | None = None,
    gyro_nominal: float | None = None,
    folds: int | None = None,
    serial_number: str | None = None,
) -> CalibrationResult:
    """Calibrate one unit from one or more of its recordings.

    control            recordings that only judge the result
    gravity_mps2       local gravity, m/s^2; every accelerometer scale is in proportion to it
    frame              body frame of the result: "symmetric" or "triangular"
    min_rest_s         shortest rest, s
    exclude_saturated  leave out rests and moves with saturated samples instead of refusing the recording
    accel_nominal, gyro_nominal   nominal sensitivity in lsb per m/s^2 and lsb per rad/s, for recordings in
                       counts; without it start values come from the data
    folds              also fit that many times, each time without a part of the moves, and judge on that part

    Raises InputError (its `findings` list the faults) for recordings that would give a wrong result,
    NotEnoughMotionError for poses that are missing, FitError if a fit comes to no acceptable end.
    """
    from imucal import _core

    unit_data = _of_one_unit(recordings)
    if folds is not None and not 2 <= folds <= MOST_FOLDS:
        raise InputError(
            f"folds is {folds}: a whole number from 2 to {MOST_FOLDS} is needed to leave moves out"
        )
    body_frame = as_frame(frame)
    options = Options(
        float(gravity_mps2), body_frame, float(min_rest_s), exclude_saturated, accel_nominal, gyro_nominal
    )
    outcome = _core.calibrate(unit_data, options)
    figures = fields_of(outcome.figures, FIGURES)
    held_out = None
    if folds is not None:
        rms_deg, error_deg = _core.cross_validate(unit_data, options, folds)
        held_out = {
            "folds": folds,
            "gravity_direction_rms_deg": rms_deg,
            "direction_error_deg": without_nan(error_deg),
        }
    judges = _as_list(control)
    _require_other_data(unit_data, judges)

    def made(control_set: Mapping[str, Any] | None) -> Calibration:
        return Calibration(
            accelerometer=Triad(outcome.accel_sensitivity, outcome.accel_bias),
            gyroscope=Triad(outcome.gyro_sensitivity, outcome.gyro_bias),
            frame=body_frame,
            accel_unit=unit_data[0].accel_unit,
            gyro_unit=unit_data[0].gyro_unit,
            gravity_mps2=gravity_mps2,
            covariance=outcome.covariance,
            covariance_names=tuple(outcome.names),
            noise=_noise(outcome.accel_noise_density, outcome.gyro_noise_density),
            temperature_range_degc=_temperature_range(unit_data),
            fit={
                "accelerometer": fields_of(outcome.accelerometer_fit, FIT),
                "gyroscope": fields_of(outcome.gyroscope_fit, FIT),
                "rest_thresholds": [fields_of(threshold, THRESHOLD) for threshold in outcome.thresholds],
            },
            calibration_set=figures,
            control_set=control_set,
            provenance=Provenance(
                _sources(unit_data),
                _sources(judges),
                str(_core.__version__),
                datetime.now(timezone.utc).isoformat(timespec="seconds"),
            ),
            serial_number=serial_number,
        )

    calibration = made(None)
    judged = evaluate(calibration, judges, min_rest_s=min_rest_s) if judges else None
    if judged is not None:
        calibration = made(judged.figures)
    reasons = [*poor_figures("calibration set", figures), *(judged.reasons if judged else ())]
    return CalibrationResult(
        calibration=calibration,
        rests=reported(outcome.rests, REST, unit_data),
        moves=reported(outcome.moves, MOVE, unit_data),
        findings=tuple(outcome.findings),
        held_out=held_out,
        control=judged,
        reasons=tuple(reasons),
    )


def _as_list(recordings: Recording | Sequence[Recording] | None) -> list[Recording]:
    if recordings is None:
        return []
    return [recordings] if isinstance(recordings, Recording) else list(recordings)


def _of_one_unit(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """The recordings as a list; they must agree on what the numbers are."""
    unit_data = _as_list(recordings)
    if not unit_data:
        raise InputError("there is no recording: give at least one")
    first = unit_data[0]
    for other in unit_data[1:]:
        if (other.accel_unit, other.gyro_unit) != (first.accel_unit, first.gyro_unit):
            raise InputError(
                f"{other.name} is in {other.accel_unit} and {other.gyro_unit} but {first.name} in "
                f"{first.accel_unit} and {first.gyro_unit}: recordings of one unit need the same raw units"
            )
    return unit_data


def _require_other_data(unit_data: Sequence[Recording], judges: Sequence[Recording]) -> None:
    """A control recording must not be one that the calibration is made of."""
    for judge in judges:
        for recording in unit_data:
            if np.array_equal(judge.specific_force, recording.specific_force) and np.array_equal(
                judge.angular_rate, recording.angular_rate
            ):
                raise InputError(
                    f"the control recording {judge.name} has all {len(judge)} samples of {recording.name}, "
                    "which the calibration is made of: give another recording of the unit, or use folds"
                )


def _noise(accel_density: FloatArray, gyro_density: FloatArray) -> dict[str, float]:
    """White-noise densities by name, continuous, one-sided."""
    return {
        f"{name}_{axis}_{unit}_per_sqrt_hz": float(density)
        for name, unit, densities in (
            ("accel_noise_density", "mps2", accel_density),
            ("gyro_noise_density", "radps", gyro_density),
        )
        for axis, density in zip("xyz", densities, strict=True)
    }


def _temperature_range(recordings: Sequence[Recording]) -> tuple[float, float] | None:
    columns = [r.temperature_degc for r in recordings if r.temperature_degc is not None]
    seen = np.concatenate(columns) if columns else np.array([])
    seen = seen[np.isfinite(seen)]
    return (float(seen.min()), float(seen.max())) if len(seen) else None


def _sources(recordings: Sequence[Recording]) -> tuple[Source, ...]:
    return tuple(source for recording in recordings for source in recording.sources)
