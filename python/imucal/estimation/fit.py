"""Report on an estimation: how rests were detected, how each fit ended, and tests of the residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.document.plain import plain, without_nan
from imucal.errors import InputError
from imucal.estimation.rests import of_library

if TYPE_CHECKING:
    import imucal._core as _core
    from imucal.estimation.priors import Priors

__all__ = [
    "Diagnosis",
    "EffectSignificance",
    "Fit",
    "FitReport",
    "HeldOut",
    "JointFit",
    "NoiseTest",
    "ResidualScales",
    "RestThreshold",
]


@dataclass(frozen=True, slots=True)
class FitReport:
    """How one fit ended.

    chi2, degrees_of_freedom   chi2 and degrees of freedom of the weighted residuals
    inflation                  factor by which the standard deviations of the parameters are widened; 1 if
                               noise explains the residuals
    iterations                 number of iterations
    termination                why the fit stopped: "converged", or a reason that makes the verdict poor:
                               "stalled" (no change of the parameters decreases chi2 although the gradient is
                               not zero),
                               "iteration_limit", "not_finite", "weights_not_settled" (the weights of the
                               residuals still changed), or "fields_not_settled" (the errors per unit of the
                               parameters of a user-defined effect still changed)
    """

    chi2: float | None
    degrees_of_freedom: int
    inflation: float | None
    iterations: int
    termination: str


@dataclass(frozen=True, slots=True)
class ResidualScales:
    """Factors by which the joint fit widens the noise of each kind of residual (docs/model.md (19)).

    norms   norm of gravity at the rests
    moves   gravity direction after the moves
    inside  specific force within the moves
    stand   attitude relative to the stand
    """

    norms: float | None
    moves: float | None
    inside: float | None
    stand: float | None


@dataclass(frozen=True, slots=True)
class JointFit(FitReport):
    """How the joint fit ended.

    scales   factors by which the noise of each kind of residual is widened
    """

    scales: ResidualScales


@dataclass(frozen=True, slots=True)
class NoiseTest:
    """Test of the hypothesis that noise alone explains the residuals of the joint fit.

    p_value   probability of a larger chi2 under this hypothesis
    """

    chi2: float | None
    degrees_of_freedom: int | None
    p_value: float | None


@dataclass(frozen=True, slots=True)
class EffectSignificance:
    """Wald test of the parameters of one effect.

    statistic   chi2 of the parameters with their covariance; under the null hypothesis that all are zero it
                has `dof` degrees of freedom
    """

    name: str
    statistic: float
    dof: int


@dataclass(frozen=True, slots=True)
class RestThreshold:
    """How the rests of one recording were detected.

    factor                 threshold of rest detection. A window is at rest if (variance of its samples /
                           noise variance), averaged over the axes, is below this threshold. The value is
                           approximate if hand-held rests follow a rest on a table; see (11) in docs/model.md
    stable_from, stable_to range of thresholds that give the same number of rests
    window_s               length of a window, s
    noise_floor            (6,) standard deviation of a sample at rest, gyroscope x, y, z, accelerometer x, y,
                           z, in raw units; None for a missing sensor
    """

    factor: float | None
    stable_from: float | None
    stable_to: float | None
    window_s: float | None
    noise_floor: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class Fit:
    """Report on an estimation: how rests were detected, how each fit ended, and tests of the residuals.

    accelerometer, gyroscope  the fit of the accelerometer, and the following fit of the gyroscope. Their
                              results are the start values of the joint fit; gyroscope is None for an
                              accelerometer alone
    joint                     the joint fit of all parameters. Without a joint fit it is None, and
                              `noise_alone`, `bias_instability_radps`, `tremor_deg` and `effects` are empty
    noise_alone               test whether noise alone explains the residuals
    bias_instability_radps    (3,) bias instability of the gyroscope, rad/s, from the profile of the unit or
                              estimated from the rates at the rests; None if it is negligible
    tremor_deg                for each recording, the standard deviation of the hand tremor about each axis,
                              deg; None if the unit was not hand-held
    effects                   significance of each estimated effect
    rest_thresholds           how the rests of each recording were detected
    priors                    the parameters with a prior (held parameters); None if there are none
    """

    accelerometer: FitReport
    gyroscope: FitReport | None
    joint: JointFit | None
    noise_alone: NoiseTest | None
    bias_instability_radps: tuple[float, ...] | None
    tremor_deg: tuple[float | None, ...]
    effects: tuple[EffectSignificance, ...]
    rest_thresholds: tuple[RestThreshold, ...]
    priors: Priors | None = None

    @staticmethod
    def of_outcome(outcome: _core.Outcome, priors: Priors | None = None) -> Fit:
        """The report on the estimation whose outcome the compiled library has returned."""
        joint = noise_alone = instability = None
        if outcome.joint_fit is not None and outcome.joint_scales is not None:
            scales = of_library(ResidualScales, outcome.joint_scales)
            joint = of_library(JointFit, {**outcome.joint_fit, "scales": scales})
            noise_alone = of_library(NoiseTest, outcome.misfit)
            if outcome.bias_instability_radps is not None:
                instability = tuple(outcome.bias_instability_radps)
        tremors = tuple(None if rad is None else math.degrees(rad) for rad in outcome.tremor_rad)
        tests = tuple(EffectSignificance(e.name, e.statistic, len(e.values)) for e in outcome.effects)
        return Fit(
            of_library(FitReport, outcome.accelerometer_fit),
            None if outcome.gyroscope_fit is None else of_library(FitReport, outcome.gyroscope_fit),
            joint,
            noise_alone,
            instability,
            tremors if joint else (),
            tests if joint else (),
            tuple(of_library(RestThreshold, fields) for fields in outcome.thresholds),
            priors,
        )

    def to_dict(self) -> dict[str, Any]:
        """The section `fit` of documents.

        Fields about the joint fit are absent without a joint fit, and fields about held parameters are absent
        if no parameter is held.
        """
        document: dict[str, Any] = plain(self)
        if self.priors is None:
            del document["priors"]
        if self.joint is None:
            for name in ("joint", "noise_alone", "bias_instability_radps", "tremor_deg", "effects"):
                del document[name]
        return document


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Cross-validation: rests and moves predicted by fits that exclude them.

    folds                      number of fits, each without one part of the rests and of the moves
    gravity_direction_rms_deg  rms angle between predicted and measured gravity after a move, deg
    direction_error_deg        angle between predicted and measured gravity after each move, deg; None for a
                               move that is not used
    gravity_norm_rms_mps2      rms error of the norm of gravity at a rest, m/s^2
    norm_error_mps2            error of the norm of gravity at each rest, m/s^2; None for a rest that is not
                               used
    """

    folds: int
    gravity_direction_rms_deg: float | None
    direction_error_deg: tuple[float | None, ...]
    gravity_norm_rms_mps2: float | None
    norm_error_mps2: tuple[float | None, ...]

    @staticmethod
    def of_outcome(outcome: _core.Outcome, folds: int | None) -> HeldOut | None:
        """The held-out predictions that the compiled library returns; None if no folds were requested."""
        if outcome.held_out is None or folds is None:
            return None
        norm_error_mps2 = outcome.held_out.norm_error_mps2
        known = norm_error_mps2[np.isfinite(norm_error_mps2)]
        return HeldOut(
            folds,
            without_nan(outcome.held_out.gravity_direction_rms_deg),
            tuple(without_nan(outcome.held_out.direction_error_deg)),
            float(np.sqrt(np.mean(known**2))) if len(known) else None,
            tuple(without_nan(norm_error_mps2)),
        )


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Parameters that the recordings determine only poorly.

    code        "traded_off" (strongly correlated parameters), "flat" (standard deviation above the usual
                size of the parameter) or "at_bound" (time constant too long or too short for the recordings)
    parameters  names of these parameters
    value       the number on which the diagnosis is based, for example a correlation
    message     description of the problem
    way_out     the motion to add
    """

    code: str
    parameters: tuple[str, ...]
    value: float | None
    message: str
    way_out: str

    @staticmethod
    def of_library(fields: Mapping[str, Any]) -> Diagnosis:
        """Make a Diagnosis of the fields that the compiled library returns."""
        return of_library(Diagnosis, fields)


def triad_of_fit(
    sensor: Literal["accel", "gyro"], sensitivity: FloatArray, bias: FloatArray, nominal: float | None
) -> Triad:
    """The triad that a fit has estimated.

    nominal  the given nominal sensitivity in lsb per SI unit; None if it was not given

    Raises InputError with the likely cause if no sensor has this sensitivity.
    """
    try:
        return Triad(sensitivity, bias)
    except InputError:
        name, unit, other = {
            "accel": ("accelerometer", "m/s^2", "g"),
            "gyro": ("gyroscope", "rad/s", "deg/s"),
        }[sensor]
        cause = (
            "check the units of its columns and the values of held parameters"
            if nominal is None
            else f"check that {sensor}_nominal = {nominal:g} is in lsb per {unit}, not per {other}"
        )
        raise InputError(
            f"the fit has found a sensitivity of the {name} that no sensor has: two of its axes are "
            f"nearly parallel, or one has almost no sensitivity; {cause}"
        ) from None
