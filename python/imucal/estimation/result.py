"""The result of a calibration: the sensor model, the report on the estimation, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import Figures, figures_text
from imucal.calibration.parameter_text import parameter_row
from imucal.calibration.provenance import Provenance
from imucal.calibration.triad import Parameter
from imucal.calibration.verdict import RESIDUALS, ResidualFit, Verdict
from imucal.document.plain import plain, without_nan
from imucal.estimation.fit import Diagnosis, Fit, HeldOut, NoiseTest
from imucal.estimation.rests import FittedMove, FittedRest, used_of
from imucal.finding import Finding
from imucal.notebook import html_of
from imucal.units import significant

if TYPE_CHECKING:
    from imucal.estimation.evaluate import Evaluation
    from imucal.estimation.means import FromMeans
    from imucal.limits.judgement import Judgement
    from imucal.limits.limits import Limits

__all__ = ["CalibrationResult"]

SCHEMA: Final = "imucal.calibration-result/1"
ACCELEROMETER_ALONE: Final = (
    "the recordings have no gyroscope: the accelerometer is calibrated alone, and the tremor of a hand is "
    "not separated from its noise"
)
# A note on a hand-held unit says that the rotation by the tremor is compensated. If the verdict is poor, this
# text is appended to the note.
TRANSLATION: Final = (
    "the acceleration by the hand is not compensated: if residuals exceed their noise, hold the unit against "
    "something rigid at each rest"
)
# If the p-value of the residuals is below this threshold, a note says that noise alone does not explain the
# residuals.
UNLIKELY: Final = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """A calibration, how it was estimated, and its verdict.

    calibration      the sensor model with its uncertainty
    fit              report on the estimation: rest detection, convergence, and tests of the residuals
    calibration_set  figures of merit on the calibration recordings
    rests, moves     the rests and moves of the calibration recordings, in order of time
    findings         warnings about the recordings
    held_out         cross-validation: rests and moves predicted by fits that exclude them; None without folds
    control          the evaluation on the control recordings; None without control recordings
    verdict          `good`, `incomplete` or `poor`: the worst of the verdicts on the calibration recordings,
                     on the control recordings and against limits
    reasons          why the verdict is not good
    residuals        for each kind of residual of the calibration recordings, its rms and the rms expected
                     from noise alone
    diagnosis        parameters that the recordings determine only poorly
    judgement        the checks against limits; None without limits
    accelerometer_of   origin of the calibration of the accelerometer that was given as a prior, or None
    from_means       the noise and the gyroscope bias of a table of means; None for recordings
    """

    calibration: Calibration
    fit: Fit
    calibration_set: Figures
    rests: tuple[FittedRest, ...]
    moves: tuple[FittedMove, ...]
    findings: tuple[Finding, ...]
    held_out: HeldOut | None
    control: Evaluation | None
    verdict: Verdict
    reasons: tuple[str, ...]
    residuals: tuple[ResidualFit, ...] = ()
    diagnosis: tuple[Diagnosis, ...] = ()
    judgement: Judgement | None = None
    from_means: FromMeans | None = None
    accelerometer_of: Provenance | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 21 parameters and the parameters of the effects, with their standard deviations.

        An accelerometer alone has nine parameters.
        """
        return self.calibration.parameters

    @property
    def control_set(self) -> Figures | None:
        """Figures of merit on the control recordings; None without control recordings."""
        return None if self.control is None else self.control.figures

    @property
    def control_before(self) -> Figures | None:
        """Figures of merit of the uncalibrated unit on the control recordings; None without recordings."""
        return None if self.control is None else self.control.before

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on excluded data, widened uncertainties, effects, observability, and assumptions."""
        notes = [
            f"rest {index} ({rest.place}) of {rest.recording} excluded: {rest.excluded}"
            for index, rest in enumerate(self.rests)
            if rest.excluded is not None
        ]
        notes += [
            f"move from rest {move.from_rest} to {move.to_rest} of {move.recording} excluded: {move.excluded}"
            for move in self.moves
            if move.excluded is not None
        ]
        notes += [
            f"standard deviations of {what} are widened by the factor {factor:.1f}, by which its residuals "
            "exceed the noise"
            for what, factor in self._widened()
            if factor is not None and factor > 1
        ]
        noise_alone = self.fit.noise_alone
        if noise_alone is not None and noise_alone.p_value is not None and noise_alone.p_value < UNLIKELY:
            notes.append(
                f"noise alone does not explain these data: {self._chi2_text(noise_alone)}; `imucal gap` "
                "searches for the missing effect"
            )
        if self.fit.bias_instability_radps is not None:
            deg_per_h = math.degrees(max(self.fit.bias_instability_radps)) * 3600.0
            notes.append(
                f"the gyroscope has a bias instability of {significant(deg_per_h, 2)} deg/h, which the "
                "standard deviations include: the estimated bias and its standard deviation are those of the "
                "mean over the recording; the bias at any one time differs from this mean by about the "
                "instability, and by more if it drifts (docs/model.md (28))"
            )
        tremors = [tremor for tremor in self.fit.tremor_deg if tremor is not None]
        if tremors:
            notes.append(
                f"the unit is hand-held with a tremor of {max(tremors):.2g} deg: the rotation measured by "
                "the gyroscope is compensated in the mean gravity directions (docs/model.md (27))"
                + (f"; {TRANSLATION}" if self.verdict == "poor" else "")
            )
        notes += [
            f"{effect.name}: chi2 of its {effect.dof} parameters is {effect.statistic:.4g}; about "
            f"{effect.dof} would be expected without the effect"
            for effect in self.fit.effects
        ]
        notes += self.fit.priors.notes if self.fit.priors is not None else []
        notes += [f"{item.message}: {item.way_out}" for item in self.diagnosis]
        has_gyroscope = self.calibration.gyroscope is not None
        if self.accelerometer_of is not None:
            files = ", ".join(source.path for source in self.accelerometer_of.files)
            notes.append(
                "the given calibration of the accelerometer is a prior with its covariance"
                + (f" (from {files})" if files else "")
                + ", which the recordings update"
            )
        if self.from_means is not None:
            notes += self.from_means.notes
        elif not has_gyroscope:
            notes.append(ACCELEROMETER_ALONE)
        notes += self.calibration.references.notes(self.calibration.gravity_mps2, has_gyroscope=has_gyroscope)
        return tuple(notes)

    def _chi2_text(self, test: NoiseTest) -> str:
        """Text on the chi2 of all residuals.

        Unlike the figures of merit, this chi2 includes the mean rates at the rests.
        """
        rates = " with the mean rates at the rests" if self.calibration.gyroscope is not None else ""
        return f"chi2{rates} is {test.chi2:.4g} for {test.degrees_of_freedom} degrees of freedom"

    def _widened(self) -> list[tuple[str, float | None]]:
        """Factors that widen the uncertainties, per kind of residual, or per sensor without a joint fit."""
        if self.fit.joint is not None:
            scales = self.fit.joint.scales
            return [
                (what, getattr(scales, kind)) for kind, what in RESIDUALS.items() if hasattr(scales, kind)
            ]
        return [
            ("the accelerometer", self.fit.accelerometer.inflation),
            *([] if self.fit.gyroscope is None else [("the gyroscope", self.fit.gyroscope.inflation)]),
        ]

    def judged_by(self, limits: Limits) -> CalibrationResult:
        """The result with its checks against limits; a failed check makes the verdict poor."""
        judgement = limits.judge(self)
        verdict, reasons = judgement.applied(self.verdict, self.reasons)
        return replace(self, judgement=judgement, verdict=verdict, reasons=reasons)

    def summary(self) -> str:
        """The parameters, the figures and the verdict as plain text."""
        lines = ["parameter                        value        1 sigma  unit"]
        for row in map(parameter_row, self.parameters):
            lines.append(f"{row.name:<24} {row.value:>13} {row.sigma:>14}  {row.unit}")
        lines.append(self.used)
        for name, figures in (
            ("calibration set", self.calibration_set),
            ("held-out rests and moves", self.held_out),
            ("control set", self.control_set),
        ):
            if figures is not None:
                lines.append(f"{name}: {figures_text(figures)}")
        noise_alone = self.fit.noise_alone
        if noise_alone is not None and noise_alone.p_value is not None and noise_alone.p_value >= UNLIKELY:
            lines.append(
                f"{self._chi2_text(noise_alone)}; the probability of a larger chi2 from noise alone is "
                f"{noise_alone.p_value:.2g}"
            )
        lines += self.notes
        findings = [*self.findings, *(self.control.findings if self.control else ())]
        lines += [finding.line for finding in findings]
        if self.judgement is not None:
            lines += [*(f"warning: {warning}" for warning in self.judgement.warnings), self.judgement.count]
        lines.append("; ".join((f"verdict: {self.verdict}", *self.reasons)))
        return "\n".join(lines)

    def __repr__(self) -> str:
        name = "control set" if self.control_set is not None else "calibration set"
        figures = figures_text(self.control_set or self.calibration_set) or "no figures"
        return f"CalibrationResult({self.verdict}: {self.used}; {name}: {figures})"

    @property
    def used(self) -> str:
        """The numbers of used rests and moves, such as "12 of 14 rests and 11 of 13 moves used"."""
        if self.calibration.gyroscope is None:
            return f"{used_of(self.rests)} rests used"
        return f"{used_of(self.rests)} rests and {used_of(self.moves)} moves used"

    def _repr_html_(self) -> str | None:
        """The HTML that a notebook displays for this object."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal calibrate --json`."""
        document = self.calibration.to_dict()
        fields = ("parameters", "accelerometer", "gyroscope", "fit", "calibration_set", "control_set")
        return {
            "schema": SCHEMA,
            "serial_number": document["serial_number"],
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "residuals": without_nan(self.residuals),
            **{name: document[name] for name in fields},
            "control": None if self.control is None else self.control.to_dict(),
            "held_out": without_nan(self.held_out),
            "rests": without_nan(self.rests),
            "moves": without_nan(self.moves),
            "findings": [finding.to_dict() for finding in self.findings],
            "diagnosis": without_nan(self.diagnosis),
            "judgement": None if self.judgement is None else self.judgement.to_dict(),
            "from_means": without_nan(self.from_means),
            "accelerometer_of": plain(self.accelerometer_of),
            "provenance": document["provenance"],
        }
