"""The result of a search for the missing effect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from imucal.document.plain import plain, without_nan
from imucal.gap.fields import GapFields
from imucal.gap.text import explanation, sentences
from imucal.notebook import html_of

__all__ = ["Gap"]

SCHEMA: Final = "imucal.gap/1"


@dataclass(frozen=True, eq=False, repr=False)
class Gap(GapFields):
    """The result of a search for the missing effect.

    verdict            nothing_missing, named, ambiguous, stochastic, unknown or data_fault. With the verdict
                       named, residuals may still remain, which `remainder` describes
    effects            accepted effects, or faults of the data: name, sensor, parameters (name, value, std,
                       unit), log_bayes_factor (nats), statistic, dof, p_value, and closed. The field closed
                       is the share of the excess chi2 (chi2 beyond noise) that the effect removes, for each
                       kind of residual on control or held-out data
    ambiguous_with     names of effects that explain the residuals as well as the accepted effects do
    resembles          for the verdict unknown: up to three effects with the largest log Bayes factors
    generic            block (the bias or scale that varies), kernel (the pattern) and description of a
                       variation that no effect of the catalogue describes, or None
    remainder          residuals that the effects do not explain; None if faults of the data prevented a fit
    laws               formulas for residuals that no effect of the catalogue describes. Laws are part of
                       `calibration`, and `remainder` describes the residuals that they leave
    not_observable     name of each effect that is not observable, and the data in which the effect would be
                       observable
    smallest_visible   detection limit by effect: `value`, the rms size per parameter; its unit; and `chance`,
                       the probability that an effect of this size is named
    next_motion        motion that distinguishes between rivals, or None: description, program, `simulate`
                       (options for `imucal simulate`), `on_its_own` (whether the search must use the new
                       recording alone), and the expected chi2 that distinguishes the rivals with the present
                       recordings (`chi2_now`) and with the motion (`chi2_predicted`)
    gap                figure of merit on control or held-out data: metric (its name), before and after (its
                       values without and with the effects), floor (the value from noise alone) and closed,
                       (before - after) / (before - floor). If a given calibration was evaluated on control
                       recordings, `before` is the value for this calibration, and `refitted` the value for
                       the fit without effects; otherwise `refitted` is None
    where              residuals of the fit without effects, with the keys channels, depends, rests, moves and
                       turns_about (see docs/gap.md); None if faults of the data prevented a fit
    corrected_error    predicted rms error of the corrected signals after averaging over 1 s:
                       angular_rate_rms_radps and specific_force_rms_mps2, each with before, after, factor
                       (before / after), and factor_low and factor_high (95 % interval); None if no effect was
                       accepted
    traces             for each effect, the residuals that it would cause at its typical size: `times_noise`,
                       their size by kind of residual in multiples of the noise, and `taken_up`, the share of
                       their chi2 that the 21 base parameters absorb
    calibration_set    figures of merit on the calibration recordings without (before) and with the effects
                       (after)
    control_set        figures of merit on the control recordings, before and after; None without control
                       recordings
    held_out           figures of merit on held-out rests and moves, before and after; None with control
                       recordings
    fits               calibrations without effects (`before`) and with the accepted effects (`after`)
    calibration        calibration with the accepted effects, or without effects if none was accepted; None
                       if faults of the data prevented a fit
    ranking            scores of all candidates relative to the model without effects, in descending order
    notes              sentences on rejected effects, limitations and warnings
    user_effects       user-defined effects among the candidates, and the laws
    is_hand_moved      whether the specific force within the moves was not used, because the unit was moved by
                       hand or the accelerometer's noise is below a step of its converter
    """

    def __repr__(self) -> str:
        remains = self.has_effects and self.remainder is not None and self.remainder.kind != "nothing"
        beside = [f"remainder {self.remainder.kind}"] if remains and self.remainder is not None else []
        names = ", ".join(
            [self.verdict, *(e["name"] for e in self.effects), *(law.name for law in self.laws), *beside]
        )
        if self.gap is None:
            return f"Gap({names})"
        figures = f"{self.gap['metric']} {self.gap['before']:.4g} -> {self.gap['after']:.4g}"
        return f"Gap({names}; {figures} on unseen data)"

    def _repr_html_(self) -> str | None:
        """HTML for display in a notebook."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal gap --json`."""
        names = (
            "verdict",
            "effects",
            "ambiguous_with",
            "resembles",
            "generic",
            "remainder",
            "laws",
            "not_observable",
            "smallest_visible",
            "next_motion",
            "gap",
            "where",
            "corrected_error",
            "traces",
            "calibration_set",
            "control_set",
            "held_out",
            "ranking",
            "notes",
        )
        document = {
            "schema": SCHEMA,
            **{name: without_nan(getattr(self, name)) for name in names if name not in ("remainder", "laws")},
        }
        document["remainder"] = None if self.remainder is None else without_nan(self.remainder.to_dict())
        document["laws"] = [without_nan(law.to_dict()) for law in self.laws]
        document["law"] = None
        if self.laws:
            terms = [{**p, "name": f"{law.name}_{p['name']}"} for law in self.laws for p in law.parameters]
            document["law"] = {"formula": "; ".join(law.formula for law in self.laws), "terms": terms}
        document["findings"] = [finding.to_dict() for finding in self.findings]
        document["calibration_verdict"] = None
        if self.calibration is not None:
            verdict, reasons = self.calibration.judged
            document["calibration_verdict"] = {"verdict": verdict, "reasons": list(reasons)}
        document["provenance"] = None if self.calibration is None else self.calibration.provenance
        return dict(plain(document))

    def explain(self, name: str) -> list[str]:
        """Lines on an effect: formula, expected residuals, detection limit and result in these recordings.

        Raises InputError for a name that is neither in the catalogue nor in `user_effects`.
        """
        return list(explanation(self, name))

    def summary(self) -> str:
        """The result as text, one sentence per line."""
        return "\n".join(sentences(self))
