"""Calibrating one unit from its recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import poor_figures
from imucal.calibration.provenance import Provenance, require_serial_number
from imucal.calibration.triad import Frame, Triad, as_frame
from imucal.document.json_document import now
from imucal.document.plain import without_nan
from imucal.document.source import Source
from imucal.document.whole import is_whole
from imucal.effects.effect import EffectValues, State, UserEffect
from imucal.errors import FitError, InputError
from imucal.estimation.evaluate import evaluate
from imucal.estimation.options import Options, UserField, asked_for, wander_of
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.recording.one_unit import of_one_unit, require_other_data
from imucal.recording.recording import MIN_REST_S, Recording, as_recordings
from imucal.rig.unit import Unit
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["calibrate", "calibrated", "fields_for_library"]

MOST_FOLDS = 1000
# Share of the rests or of the moves that may contradict the others in a good calibration.
MOST_CONTRADICTING = 0.1
# Share of the rests that may be slow turns.
MOST_NOT_STILL = 0.2
# Chance makes residuals that much smaller than noise does less often than once in a million.
TOO_SURE = 1 - 1e-6
# A field that depends on the corrected state changes by less each time, by the size of the effects or so.
MOST_FIELD_ROUNDS = 20
# A change of a field by this share changes its parameters by as much.
SETTLED_FIELD = 1e-7


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
    effects: Sequence[str | UserEffect] = (),
    joint: bool = True,
    unit: Unit | str | os.PathLike[str] | None = None,
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
    effects            what to estimate together with the 21 parameters: names of the catalogue, with `:full`
                       for the full form of an effect that has two, with `:seen` for what these recordings
                       show of it, the rest having a prior as wide as that; and effects of one's own
    joint              estimate all parameters at once; if False, and without effects, the accelerometer first
                       and the gyroscope after it
    unit               profile of the unit, its name, or the path of its file: its bias instabilities and
                       random walks, which recordings of minutes hardly show, widen the standard deviations;
                       the biases are means over the recording then
    folds              also fit that many times without a part of the moves, and as often without a part of
                       the rests, and judge on what was left out

    Raises InputError (its `findings` list the faults) for recordings that would give a wrong result,
    NotEnoughMotionError for poses that are missing, FitError if a fit comes to no acceptable end.
    """
    unit_data = of_one_unit(recordings)
    if folds is not None and not (is_whole(folds) and 2 <= folds <= MOST_FOLDS):
        raise InputError(
            f"folds is {folds!r}: a whole number from 2 to {MOST_FOLDS} is needed to leave moves out"
        )
    body_frame = as_frame(frame)
    wanted, partly, own = asked_for(effects)
    if own and body_frame != "symmetric":
        raise InputError(
            "effects are defined by the axes of the symmetric body frame: leave frame at symmetric, or the "
            "effects out"
        )
    require_serial_number(serial_number)
    options = Options(
        float(gravity_mps2),
        body_frame,
        float(min_rest_s),
        exclude_saturated,
        accel_nominal,
        gyro_nominal,
        wanted,
        joint=joint,
        wander=wander_of(unit),
        folds=folds,
        partly=partly,
    )
    judges = as_recordings(control)
    require_other_data(unit_data, judges)
    return calibrated(_core.Checked(unit_data, options), unit_data, options, own, judges, serial_number)


def calibrated(
    checked: _core.Checked,
    unit_data: Sequence[Recording],
    options: Options,
    own: tuple[UserEffect, ...] = (),
    judges: Sequence[Recording] = (),
    serial_number: str | None = None,
) -> CalibrationResult:
    """As `calibrate`, of recordings that are checked with the same options but for effects and folds."""
    raw_units = (unit_data[0].accel_unit, unit_data[0].gyro_unit)
    outcome = _core.calibrate(checked, unit_data, options)
    if own:
        options, outcome = _with_user_effects(checked, unit_data, options, own, outcome)
    carried = tuple(EffectValues(e.name, e.values, e.shape) for e in outcome.effects)

    def made(control_set: Mapping[str, Any] | None) -> Calibration:
        return Calibration(
            accelerometer=Triad(outcome.accel_sensitivity, outcome.accel_bias),
            gyroscope=Triad(outcome.gyro_sensitivity, outcome.gyro_bias),
            frame=options.frame,
            accel_unit=raw_units[0],
            gyro_unit=raw_units[1],
            gravity_mps2=options.gravity_mps2,
            effects=carried,
            user_effects=own,
            covariance=outcome.covariance,
            covariance_names=_names(outcome, own),
            noise=_noise(outcome.accel_noise_density, outcome.gyro_noise_density),
            temperature_range_degc=_temperature_range(unit_data),
            fit={
                "accelerometer": outcome.accelerometer_fit,
                "gyroscope": outcome.gyroscope_fit,
                **_joint(outcome),
                "rest_thresholds": outcome.thresholds,
            },
            calibration_set=outcome.figures,
            control_set=control_set,
            provenance=Provenance(
                _sources(unit_data),
                _sources(judges),
                str(_core.__version__),
                now(),
            ),
            serial_number=serial_number,
        )

    calibration = made(None)
    judged = evaluate(calibration, judges, min_rest_s=options.min_rest_s) if judges else None
    if judged is not None:
        calibration = made(judged.figures)
    reasons = [
        *poor_figures("calibration set", outcome.figures),
        *_too_many_contradict("rests", outcome.rests),
        *_too_many_contradict("moves", outcome.moves),
        *_too_many_not_still(outcome.rests),
        *(judged.reasons if judged else ()),
    ]
    return CalibrationResult(
        calibration=calibration,
        rests=tuple(outcome.rests),
        moves=tuple(outcome.moves),
        findings=(
            *(f for r in unit_data for f in r.findings),
            *outcome.findings,
            *_too_loud(outcome, unit_data),
        ),
        held_out=_held_out(outcome, options.folds),
        control=judged,
        reasons=tuple(reasons),
        diagnosis=tuple(outcome.diagnosis),
    )


def _held_out(outcome: _core.Outcome, folds: int | None) -> dict[str, Any] | None:
    """Rests and moves predicted by the others, if folds were asked for."""
    if outcome.held_out is None:
        return None
    norm_error_mps2 = outcome.held_out.norm_error_mps2
    known = norm_error_mps2[np.isfinite(norm_error_mps2)]
    return {
        "folds": folds,
        "gravity_direction_rms_deg": outcome.held_out.gravity_direction_rms_deg,
        "direction_error_deg": without_nan(outcome.held_out.direction_error_deg),
        "gravity_norm_rms_mps2": float(np.sqrt(np.mean(known**2))) if len(known) else None,
        "norm_error_mps2": without_nan(norm_error_mps2),
    }


def _with_user_effects(
    checked: _core.Checked,
    unit_data: Sequence[Recording],
    options: Options,
    own: tuple[UserEffect, ...],
    outcome: _core.Outcome,
) -> tuple[Options, _core.Outcome]:
    """Estimate with the fields of `own`, again until they settle: they may depend on the corrected state."""
    fields: tuple[UserField, ...] = ()
    for _ in range(MOST_FIELD_ROUNDS):
        current = Calibration(
            Triad(outcome.accel_sensitivity, outcome.accel_bias),
            Triad(outcome.gyro_sensitivity, outcome.gyro_bias),
            accel_unit=unit_data[0].accel_unit,
            gyro_unit=unit_data[0].gyro_unit,
            effects=tuple(EffectValues(e.name, e.values, e.shape) for e in outcome.effects),
            user_effects=own,
        )
        before, fields = fields, fields_for_library(current, unit_data, own)
        if before and all(
            np.abs(new - old).max(initial=0.0) <= SETTLED_FIELD * np.abs(new).max(initial=0.0)
            for olds, news in zip(before, fields, strict=True)
            for old, new in zip(olds.columns, news.columns, strict=True)
        ):
            break
        options = replace(options, user_fields=fields)
        outcome = _core.calibrate(checked, unit_data, options)
    else:
        names = " and ".join(effect.name for effect in own)
        raise FitError(
            f"the field of {names} still changes after {MOST_FIELD_ROUNDS} fits: it depends too much on what "
            "it corrects; make it depend less on rate and force"
        )
    return options, outcome


def fields_for_library(
    calibration: Calibration, recordings: Sequence[Recording], own: tuple[UserEffect, ...]
) -> tuple[UserField, ...]:
    """The fields of a user's effects at the state that `calibration` makes of the recordings."""
    if not own:
        return ()
    corrected = [calibration.apply_recording(recording) for recording in recordings]
    states = [State.of(c, c.angular_rate, c.specific_force) for c in corrected]
    return tuple(
        UserField(
            effect.name,
            effect.sensor,
            tuple(parameter.typical for parameter in effect.parameters),
            tuple(np.ascontiguousarray(effect.columns(state)) for state in states),
        )
        for effect in own
    )


def _names(outcome: _core.Outcome, own: tuple[UserEffect, ...]) -> tuple[str, ...]:
    """Names of all parameters; the library numbers those of a user's effect."""
    count = sum(len(effect.parameters) for effect in own)
    names = outcome.names[: len(outcome.names) - count]
    return (*names, *(f"{effect.name}_{p.name}" for effect in own for p in effect.parameters))


def _joint(outcome: _core.Outcome) -> dict[str, Any]:
    """How the joint fit went, what it widens by how much, and how far each effect stands out."""
    if outcome.joint_fit is None:
        return {}
    effects = [{"name": e.name, "statistic": e.statistic, "dof": len(e.values)} for e in outcome.effects]
    return {
        "joint": {**outcome.joint_fit, "scales": outcome.joint_scales},
        "noise_alone": outcome.misfit,
        # Of the gyroscope, as the rates at the rests show it or as it was given; null where neither.
        "bias_instability_radps": outcome.bias_instability_radps,
        # Of a hand, about each axis; null where the unit lies on something firm.
        "tremor_deg": [None if t is None else float(np.degrees(t)) for t in outcome.tremor_rad],
        "effects": effects,
    }


def _too_many_contradict(what: str, items: Sequence[Mapping[str, Any]]) -> list[str]:
    """A few bad rests or moves are an accident; where many contradict the others the model is wrong."""
    count = sum((item["excluded"] or "").startswith("contradicts") for item in items)
    if count <= MOST_CONTRADICTING * len(items):
        return []
    return [
        f"calibration set: {count} of {len(items)} {what} contradict the others: the linear model does not "
        "describe this unit or this motion"
    ]


def _too_many_not_still(rests: Sequence[Mapping[str, Any]]) -> list[str]:
    """A few slow turns look like rests; many mean rates that differ are another bias."""
    count = sum(rest["excluded"] == "rest_not_still" for rest in rests)
    if count <= MOST_NOT_STILL * len(rests):
        return []
    return [
        f"calibration set: {count} of {len(rests)} rests are left out, their mean rates being far from those "
        "of the others: the unit was not still, its bias has jumped, as it may when power is lost, or these "
        "are of another unit"
    ]


def _too_loud(outcome: _core.Outcome, unit_data: Sequence[Recording]) -> Iterator[Finding]:
    """Noise that explains far more than is left: what was taken for noise is a motion."""
    misfit = outcome.misfit
    if misfit["p_value"] is None or misfit["p_value"] < TOO_SURE:
        return
    ratio = (misfit["chi2"] / misfit["degrees_of_freedom"]) ** 0.5
    yield Finding(
        "noise_overestimated",
        "warning",
        " and ".join(recording.name for recording in unit_data),
        (),
        None,
        misfit["degrees_of_freedom"],
        ratio,
        "1",
        f"residuals are {ratio:.2g} times what the noise at the rests explains: standard deviations are too "
        "large by as much, and small effects are not seen",
        "a hand that trembles is told from noise at 100 Hz or more; on a table see that nothing shakes it",
    )


def _noise(accel_density: FloatArray, gyro_density: FloatArray) -> dict[str, float]:
    """White-noise densities by name, continuous, two-sided: a sample has this times the root of the rate."""
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
