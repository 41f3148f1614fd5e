"""Calibration of one unit from its recordings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import Figures
from imucal.calibration.provenance import Provenance, require_serial_number
from imucal.calibration.references import References, references_of
from imucal.calibration.temperature import temperature_range
from imucal.calibration.triad import Frame, as_estimated_frame
from imucal.calibration.verdict import ResidualFit, verdict_of, worst
from imucal.document.date import now
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.document.whole import is_whole
from imucal.errors import InputError
from imucal.estimation.fit import Diagnosis, Fit, HeldOut, triad_of_fit
from imucal.estimation.holds import Hold, holds_of, profile_of
from imucal.estimation.nominal import nominals_named, require_nominals
from imucal.estimation.options import Options, asked_for, wander_of
from imucal.estimation.rests import FittedMove, FittedRest, of_library
from imucal.estimation.result import CalibrationResult
from imucal.recording.means import Means
from imucal.recording.one_unit import of_one_unit, require_other_data
from imucal.recording.recording import Recording, as_recordings

if TYPE_CHECKING:
    from imucal.effects.definition import UserEffect
    from imucal.effects.effect import EffectValues
    from imucal.estimation.means import FromMeans
    from imucal.rig.unit import Unit

__all__ = ["calibrate", "result_of"]

# Largest accepted number of folds of the cross-validation. More folds are useless, because each fold excludes
# at least one move, and recordings have fewer than 1000 moves.
MOST_FOLDS: Final = 1000
# Largest accepted value of `max_iterations`. If a fit has not converged after this number of iterations, more
# iterations do not help.
MOST_ITERATIONS: Final = 100_000


def calibrate(
    recordings: Recording | Means | Sequence[Recording],
    *,
    control: Recording | Sequence[Recording] | None = None,
    gravity_mps2: float | None = None,
    gravity_sigma_mps2: float | None = None,
    latitude_deg: float | None = None,
    height_m: float | None = None,
    clock_ppm: float | None = None,
    frame: Frame | str = "symmetric",
    min_rest_s: float = _core.MIN_REST_S,
    exclude_saturated: bool = False,
    accel_nominal: float | None = None,
    gyro_nominal: float | None = None,
    effects: Sequence[str | UserEffect] = (),
    model: str = "full",
    hold: Hold = (),
    joint: bool = True,
    unit: Unit | str | os.PathLike[str] | None = None,
    folds: int | None = None,
    noise_mps2: float | None = None,
    calibration: Calibration | None = None,
    max_iterations: int = _core.MAX_ITERATIONS,
    serial_number: str | None = None,
) -> CalibrationResult:
    """Calibrate one unit from one or more of its recordings.

    Recordings of an accelerometer alone determine its nine parameters. A table of mean readings (`Means`)
    also determines these nine parameters, and the bias of the gyroscope. In both cases, the arguments
    `effects` and `folds` are refused. Rows of the table that are exact copies of earlier rows are left out
    with a warning.

    control            recordings that are not fitted and only used to evaluate the result
    gravity_mps2       local gravity, m/s^2. The estimated accelerometer sensitivities are inversely
                       proportional to it. None: normal gravity at `latitude_deg` and `height_m`, or standard
                       gravity 9.80665 if no latitude is given
    gravity_sigma_mps2 standard deviation of local gravity, m/s^2, to include in the standard deviations of
                       the accelerometer scales. None: with `latitude_deg` the standard deviation of normal
                       gravity, otherwise zero
    latitude_deg, height_m   geodetic latitude, deg, and height, m, of the place of the recordings
    clock_ppm          standard deviation of the rate error, ppm, of the clock that gives the time stamps, to
                       include in the standard deviations of the gyroscope scales
    frame              body frame of the result: "symmetric" or "triangular", see `imucal.calibration.triad`
    min_rest_s         minimum duration of a rest, s
    exclude_saturated  exclude rests and moves with saturated samples instead of refusing the recording
    accel_nominal, gyro_nominal   nominal sensitivity in lsb per m/s^2 and lsb per rad/s for recordings in
                                  counts; None: start values are estimated from the data. A value for a
                                  sensor in SI units is refused
    effects            effects to estimate together with the 21 parameters: user-defined effects, formulas
                       such as "gyro: k * (supply_v - 3.3)", and names of the catalogue. NAME:full selects the
                       form with all parameters of an effect, and NAME:6 a form with six. NAME:seen gives each
                       parameter of the effect a prior, whose standard deviation is the estimated size of the
                       effect. The recordings then need not determine all parameters of the effect
    model              parameters that are estimated without a prior: "full" for all; "orthogonal" for biases
                       and scales, while the misalignments are held (see `hold`); "bias" for the biases, while
                       misalignments and scales are held
    hold               further parameters to hold. A held parameter has a normal prior, whose uncertainty is
                       included in the standard deviations of the result. The argument consists of texts NAME,
                       NAME=VALUE or NAME=VALUE+-SIGMA, or is a mapping from names to None, the value, or
                       (value, sigma). NAME is accel_ or gyro_, then bias, scale or misalignment, and then the
                       axes, such as _xy, or nothing for all axes. The default of VALUE is that of a perfect
                       sensor. The default of SIGMA is the spread between units that `unit` states, or else
                       the spread of MEMS sensors (docs/model.md (40)). Biases are in the raw unit, scales
                       relative to the nominal scale, misalignments in rad
    joint              estimate all parameters in one fit. If False, and if there are no effects and no held
                       parameters, first fit the accelerometer and then the gyroscope
    unit               profile of the unit, its name, or the path of its file. Bias instabilities and random
                       walks in the profile are included in the standard deviations, because recordings of
                       some minutes hardly reveal them; the estimated biases are then means over the
                       recording. The spread between units in the profile gives the priors of held parameters
    noise_mps2         standard deviation of the means of the accelerometer, m/s^2, for a table of means that
                       does not contain it. Default: computed from the noise density of `unit` and the
                       `duration_s` of the means, or else from the residuals
    calibration        calibration of the accelerometer, such as that of an accelerometer alone. Its nine
                       parameters with their covariance are a prior, so that the recordings need only the
                       moves for the gyroscope. A gyroscope in this calibration is not used. The recordings
                       update the accelerometer, so a prior calibration that was made from the file of one of
                       these recordings is refused. The verdict of the result is not better than the verdict
                       of the prior calibration
    folds              number of additional fits for cross-validation. Each of these fits excludes one part of
                       the rests and moves, and predicts the excluded part
    max_iterations     maximum number of iterations of the joint fit. The fit is repeated with new weights,
                       and the iterations of all repetitions count together. If the fit reaches this number
                       before its optimum, the verdict is poor

    Another thread must not change the arrays of the recordings during the calculation, because the result
    would then be a mixture of the old and the new values. The signal handlers of Python run during the
    calculation, and an exception of a handler, such as KeyboardInterrupt, ends it.

    Raises InputError (its `findings` list the faults) for recordings that would give a wrong result,
    NotEnoughMotionError if poses are missing, and FitError if a fit does not converge to an acceptable
    result.
    """
    means: Means | None = None
    if not isinstance(recordings, Means):
        if noise_mps2 is not None:
            raise InputError(
                "noise_mps2 is only for a table of means, because recordings show their own noise: leave it "
                "out"
            )
        unit_data = of_one_unit(recordings)
    else:
        from imucal.estimation.means import rows_of_means, without_repeated_rows

        means = without_repeated_rows(recordings)
        unit_data = [rows_of_means(means)]
    if folds is not None and not (is_whole(folds) and 2 <= folds <= MOST_FOLDS):
        raise InputError(
            f"folds is {folds!r}: a whole number from 2 to {MOST_FOLDS} is needed for cross-validation"
        )
    if not (is_whole(max_iterations) and 1 <= max_iterations <= MOST_ITERATIONS):
        raise InputError(
            f"max_iterations is {max_iterations!r}: a whole number from 1 to {MOST_ITERATIONS} is needed"
        )
    body_frame = as_estimated_frame(frame)
    wanted, partly, own = asked_for(effects, unit_data)
    if own and body_frame != "symmetric":
        raise InputError(
            "effects are defined in the symmetric body frame: leave frame at symmetric, or estimate no "
            "effects"
        )
    require_serial_number(serial_number)
    gravity, references = references_of(gravity_mps2, gravity_sigma_mps2, clock_ppm, latitude_deg, height_m)
    require_nominals(unit_data[0], accel_nominal, gyro_nominal)
    known = None
    if calibration is not None:
        from imucal.estimation.known import known_accelerometer, require_other_files

        known = known_accelerometer(calibration, unit_data)
        require_other_files(calibration, unit_data, as_recordings(control))
    options = Options(
        gravity_mps2=gravity,
        gravity_sigma_mps2=references.gravity_sigma_mps2,
        clock_ppm=references.clock_ppm,
        frame=body_frame,
        min_rest_s=float(min_rest_s),
        exclude_saturated=exclude_saturated,
        accel_nominal=accel_nominal,
        gyro_nominal=gyro_nominal,
        effects=wanted,
        joint=joint,
        model=model,
        hold=holds_of(hold),
        profile=profile_of(unit),
        wander=None if means is not None else wander_of(unit),
        folds=folds,
        partly=partly,
        accelerometer=known,
        max_iterations=max_iterations,
    )
    judges = as_recordings(control)
    require_other_data(unit_data, judges, "use --folds instead of --control")
    source = None
    if own:
        from imucal.estimation.user_effects import UserEffectSource

        source = UserEffectSource(own, unit_data, judges)
    of_means: FromMeans | None = None
    with nominals_named(unit_data, accel_nominal, gyro_nominal):
        if means is not None:
            from imucal.estimation.means import calibrated_means

            of_means, outcome = calibrated_means(means, noise_mps2, unit, options)
        elif all(recording.angular_rate is None for recording in unit_data):
            outcome = _core.calibrate_accelerometer(unit_data, options)
        else:
            outcome = _core.calibrate(unit_data, options, source)

    def finished(found: _core.Evaluation | None = None) -> CalibrationResult:
        result = result_of(outcome, unit_data, options, own, judges, found, serial_number, references)
        if calibration is not None:
            from imucal.estimation.known import with_prior

            result = with_prior(result, calibration)
        return result if of_means is None else replace(result, from_means=of_means)

    result = finished()
    if not judges:
        return result
    from imucal.estimation.evaluate import evaluated

    found = evaluated(result.calibration, judges, options.min_rest_s)
    if of_means is None:
        _core.require_independent(unit_data, outcome.rest_ranges, judges, found.rest_ranges)
    return finished(found)


def result_of(
    outcome: _core.Outcome,
    unit_data: Sequence[Recording],
    options: Options,
    own: tuple[UserEffect, ...] = (),
    judges: Sequence[Recording] = (),
    found: _core.Evaluation | None = None,
    serial_number: str | None = None,
    references: References | None = None,
) -> CalibrationResult:
    """Convert the outcome of the compiled library to a CalibrationResult.

    own    the user-defined effects that were estimated
    found  the evaluation on the control recordings `judges`; None without control recordings
    """
    names = _names(outcome, own)
    raw_units = (unit_data[0].accel_unit, unit_data[0].gyro_unit)
    priors = None
    if outcome.prior_cost is not None:
        from imucal.estimation.priors import Priors

        priors = Priors.of_outcome(outcome, options.model, names, raw_units)
    fit, figures = Fit.of_outcome(outcome, priors), Figures(**outcome.figures)
    rests = tuple(of_library(FittedRest, fields) for fields in outcome.rests)
    moves = tuple(of_library(FittedMove, fields) for fields in outcome.moves)
    verdict = worst(verdict_of(outcome.verdict), "good" if found is None else verdict_of(found.verdict))
    reasons = (*outcome.reasons, *(() if found is None else found.reasons))
    calibration = Calibration(
        accelerometer=triad_of_fit(
            "accel", outcome.accel_sensitivity, outcome.accel_bias, options.accel_nominal
        ),
        gyroscope=None
        if outcome.gyro_sensitivity is None or outcome.gyro_bias is None
        else triad_of_fit("gyro", outcome.gyro_sensitivity, outcome.gyro_bias, options.gyro_nominal),
        frame=options.frame,
        accel_unit=unit_data[0].accel_unit,
        gyro_unit=unit_data[0].gyro_unit,
        axes=unit_data[0].axes,
        gravity_mps2=options.gravity_mps2,
        references=references or References(),
        effects=_effects(outcome),
        user_effects=own,
        covariance=outcome.covariance,
        covariance_names=names,
        noise=_noise(outcome.accel_noise_density, outcome.gyro_noise_density),
        temperature_range_degc=temperature_range(unit_data),
        fit=fit.to_dict(),
        calibration_set=plain(figures),
        control_set=None if found is None else plain(Figures(**found.figures)),
        verdict=verdict,
        reasons=reasons,
        provenance=Provenance(
            _sources(unit_data),
            _sources(judges),
            str(_core.__version__),
            now(),
        ),
        serial_number=serial_number,
    )
    judged = None
    if found is not None:
        from imucal.estimation.evaluate import evaluation_of

        judged = evaluation_of(calibration, judges, found)
    return CalibrationResult(
        calibration=calibration,
        fit=fit,
        calibration_set=figures,
        rests=rests,
        moves=moves,
        findings=(
            *(f for r in unit_data for f in r.findings),
            *outcome.findings,
        ),
        held_out=HeldOut.of_outcome(outcome, options.folds),
        control=judged,
        verdict=verdict,
        reasons=reasons,
        residuals=tuple(of_library(ResidualFit, fields) for fields in outcome.residuals),
        diagnosis=tuple(map(Diagnosis.of_library, outcome.diagnosis)),
    )


def _effects(outcome: _core.Outcome) -> tuple[EffectValues, ...]:
    """The estimated effects."""
    if not outcome.effects:
        return ()
    from imucal.effects.effect import EffectValues

    return tuple(EffectValues(e.name, e.values, e.shape) for e in outcome.effects)


def _names(outcome: _core.Outcome, own: tuple[UserEffect, ...]) -> tuple[str, ...]:
    """Names of all parameters.

    The last names, those of user-defined effects, are from `own`; the compiled library does not know them.
    """
    count = sum(len(effect.parameters) for effect in own)
    names = outcome.names[: len(outcome.names) - count]
    return (*names, *(f"{effect.name}_{p.name}" for effect in own for p in effect.parameters))


def _noise(accel_density: FloatArray, gyro_density: FloatArray | None) -> dict[str, float]:
    """White-noise densities by name, two-sided.

    The standard deviation of a sample is its density times the square root of the sampling rate.
    """
    return {
        f"{name}_{axis}_{unit}_per_sqrt_hz": float(density)
        for name, unit, densities in (
            ("accel_noise_density", "mps2", accel_density),
            ("gyro_noise_density", "radps", gyro_density),
        )
        # The noise density of a table of means is not known.
        if densities is not None and np.isfinite(densities).all()
        for axis, density in zip("xyz", densities, strict=True)
    }


def _sources(recordings: Sequence[Recording]) -> tuple[Source, ...]:
    return tuple(source for recording in recordings for source in recording.sources)
