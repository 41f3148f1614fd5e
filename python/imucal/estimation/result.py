"""What a calibration run gives: the calibration, what it was made of, and how well it does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import figures_text, used_of
from imucal.calibration.triad import Parameter
from imucal.document.plain import without_nan
from imucal.estimation.evaluate import Evaluation
from imucal.finding import Finding
from imucal.limits.judgement import Judgement
from imucal.notebook import html_of

if TYPE_CHECKING:
    from imucal.limits.limits import Limits

__all__ = ["CalibrationResult"]

SCHEMA: Final = "imucal.calibration-result/1"
# Noise alone makes chi2 so large less often than this.
UNLIKELY = 1e-6
# Kinds of residuals of the joint fit that may be widened (docs/model.md (19)).
RESIDUALS = {
    "norms": "gravity's norm at the rests",
    "moves": "gravity's direction after the moves",
    "inside": "the force inside the moves",
    "stand": "the attitude against the stand",
}


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """A calibration and all that is known about it.

    rests, moves   one mapping for each, in order of time; `excluded` says why one takes no part, `chi2` and
                   `p_value` how well noise alone explains one that does, as a fit without it would see it
    findings       warnings about the recordings
    held_out       direction of gravity after moves, and its length at rests, that the fit had not seen, if
                   folds were asked for
    control        the calibration judged on the control recordings, if there are any
    reasons        why the verdict is poor; empty for a good one
    diagnosis      what the data tell badly, one mapping for each: `code` (traded_off, flat or at_bound), the
                   `parameters`, the `value` that decided, `message`, and `way_out`: the motion that helps
    judgement      the checks against limits, if it was judged by any
    """

    calibration: Calibration
    rests: tuple[Mapping[str, Any], ...]
    moves: tuple[Mapping[str, Any], ...]
    findings: tuple[Finding, ...]
    held_out: Mapping[str, Any] | None
    control: Evaluation | None
    reasons: tuple[str, ...]
    diagnosis: tuple[Mapping[str, Any], ...] = ()
    judgement: Judgement | None = None

    @property
    def verdict(self) -> str:
        """`good` or `poor`."""
        return "poor" if self.reasons else "good"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 21 parameters and those of the effects, with their standard deviations."""
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
        """What a careful reader should know: what was left out, is widened or hardly known; effects."""
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
        if "joint" in self.fit:
            scales = self.fit["joint"]["scales"]
            widened = [(what, scales[kind]) for kind, what in RESIDUALS.items()]
        else:
            widened = [(f"the {s}", self.fit[s]["inflation"]) for s in ("accelerometer", "gyroscope")]
        notes += [
            f"standard deviations of {what} are widened {times:.1f} times: by so much residuals exceed "
            "what noise explains"
            for what, times in widened
            if times > 1
        ]
        alone = self.fit.get("noise_alone", {})
        if alone.get("p_value") is not None and alone["p_value"] < UNLIKELY:
            notes.append(
                f"noise alone does not explain these data: chi2 is {alone['chi2']:.4g} with "
                f"{alone['degrees_of_freedom']} degrees of freedom; `imucal gap` looks for what is missing"
            )
        instability = self.fit.get("bias_instability_radps")
        if instability is not None:
            notes.append(
                f"the gyroscope's bias wanders by {math.degrees(max(instability)) * 3600.0:.2g} deg/h (bias "
                "instability): it is in the standard deviations, and the estimate is the mean "
                "(docs/model.md (28))"
            )
        tremors = [tremor for tremor in self.fit.get("tremor_deg", ()) if tremor is not None]
        if tremors:
            notes.append(
                f"a hand holds the unit and trembles by {max(tremors):.2g} deg: directions of gravity are "
                "averaged along the gyroscope (docs/model.md (27))"
            )
        notes += [
            f"{effect['name']}: chi2 of its {effect['dof']} parameters is {effect['statistic']:.4g}, "
            f"{effect['dof']} or so if it were not there"
            for effect in self.fit.get("effects", ())
        ]
        notes += [f"{item['message']}: {item['way_out']}" for item in self.diagnosis]
        return tuple(notes)

    def judged_by(self, limits: Limits) -> CalibrationResult:
        """The same with its checks against limits; a limit that is not kept makes the verdict poor."""
        judgement = limits.judge(self)
        return replace(self, judgement=judgement, reasons=(*self.reasons, *judgement.reasons))

    def summary(self) -> str:
        """The parameters, the figures and the verdict as plain text."""
        lines = ["parameter                        value        1 sigma  unit"]
        for parameter in self.parameters:
            std = "not known" if parameter.std is None else f"{parameter.std:.2e}"
            lines.append(f"{parameter.name:<24} {parameter.value:>13.7g} {std:>14}  {parameter.unit}")
        lines.append(self._used())
        for name, figures in (
            ("calibration set", self.calibration_set),
            ("held-out rests and moves", self.held_out),
            ("control set", self.control_set),
        ):
            if figures is not None:
                lines.append(f"{name}: {figures_text(figures)}")
        alone = self.fit.get("noise_alone", {})
        if alone.get("p_value") is not None:
            lines.append(
                f"chi2 is {alone['chi2']:.4g} with {alone['degrees_of_freedom']} degrees of freedom; noise "
                f"alone makes it larger with the probability {alone['p_value']:.2g}"
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
        figures = figures_text(self.control_set or self.calibration_set or {}) or "no figures"
        return f"CalibrationResult({self.verdict}: {self._used()}; {name}: {figures})"

    def _used(self) -> str:
        return f"{used_of(self.rests)} rests and {used_of(self.moves)} moves used"

    def _repr_html_(self) -> str | None:
        """The HTML of notebooks."""
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
            **{name: document[name] for name in fields},
            "control": None if self.control is None else self.control.to_dict(),
            "held_out": without_nan(self.held_out),
            "rests": without_nan(self.rests),
            "moves": without_nan(self.moves),
            "findings": [finding.to_dict() for finding in self.findings],
            "diagnosis": without_nan(self.diagnosis),
            "judgement": None if self.judgement is None else self.judgement.to_dict(),
            "provenance": document["provenance"],
        }
