"""Calibrating one unit from its recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import Figures, poor_figures
from imucal.calibration.provenance import Provenance, require_serial_number
from imucal.calibration.triad import Frame, Triad, as_frame
from imucal.document.json_document import now
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.document.whole import is_whole
from imucal.effects.definition import UserEffect
from imucal.effects.effect import EffectValues
from imucal.effects.state import State
from imucal.errors import FitError, InputError
from imucal.estimation.evaluate import evaluate
from imucal.estimation.fit import Diagnosis, Fit, HeldOut
from imucal.estimation.options import Options, UserField, asked_for, wander_of
from imucal.estimation.rests import FittedMove, FittedRest, Move, Rest, of_library
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
        gravity_mps2=float(gravity_mps2),
        frame=body_frame,
        min_rest_s=float(min_rest_s),
        exclude_saturated=exclude_saturated,
        accel_nominal=accel_nominal,
        gyro_nominal=gyro_nominal,
        effects=wanted,
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

    fit, figures = Fit.of_outcome(outcome), Figures(**outcome.figures)
    rests = tuple(of_library(FittedRest, fields) for fields in outcome.rests)
    moves = tuple(of_library(FittedMove, fields) for fields in outcome.moves)

    def made(control_set: Figures | None) -> Calibration:
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
            fit=fit.to_dict(),
            calibration_set=plain(figures),
            control_set=None if control_set is None else plain(control_set),
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
        *outcome.fit_reasons,
        *poor_figures("calibration set", figures),
        *_too_many_contradict("rests", rests),
        *_too_many_contradict("moves", moves),
        *_too_many_not_still(rests),
        *(judged.reasons if judged else ()),
    ]
    return CalibrationResult(
        calibration=calibration,
        fit=fit,
        calibration_set=figures,
        rests=rests,
        moves=moves,
        findings=(
            *(f for r in unit_data for f in r.findings),
            *outcome.findings,
            *_too_loud(fit, unit_data),
        ),
        held_out=HeldOut.of_outcome(outcome, options.folds),
        control=judged,
        reasons=tuple(reasons),
        diagnosis=tuple(map(Diagnosis.of_library, outcome.diagnosis)),
    )


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


def _too_many_contradict(what: str, items: Sequence[Rest] | Sequence[Move]) -> list[str]:
    """A few bad rests or moves are an accident; where many contradict the others the model is wrong."""
    count = sum((item.excluded or "").startswith("contradicts") for item in items)
    if count <= MOST_CONTRADICTING * len(items):
        return []
    return [
        f"calibration set: {count} of {len(items)} {what} contradict the others: the linear model does not "
        "describe this unit or this motion"
    ]


def _too_many_not_still(rests: Sequence[Rest]) -> list[str]:
    """A few slow turns look like rests; many mean rates that differ are another bias."""
    count = sum(rest.excluded == "rest_not_still" for rest in rests)
    if count <= MOST_NOT_STILL * len(rests):
        return []
    return [
        f"calibration set: {count} of {len(rests)} rests are left out, their mean rates being far from those "
        "of the others: the unit was not still, its bias has jumped, as it may when power is lost, or these "
        "are of another unit"
    ]


def _too_loud(fit: Fit, unit_data: Sequence[Recording]) -> Iterator[Finding]:
    """Noise that explains far more than is left: what was taken for noise is a motion."""
    test = fit.noise_alone
    if test is None or test.p_value is None or test.p_value < TOO_SURE:
        return
    if test.chi2 is None or test.degrees_of_freedom is None:
        return
    ratio = (test.chi2 / test.degrees_of_freedom) ** 0.5
    yield Finding(
        "noise_overestimated",
        "warning",
        " and ".join(recording.name for recording in unit_data),
        (),
        None,
        test.degrees_of_freedom,
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
