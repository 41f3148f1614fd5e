"""What a search for the missing effect gives."""

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
    """What the search has found.

    verdict            nothing_missing, named, ambiguous, stochastic, unknown or data_fault
    effects            what joined the model, or the faults: name, sensor, parameters (name, value, std,
                       unit), log_bayes_factor, statistic, dof, p_value
    ambiguous_with     rivals of the pick
    resembles          what an unknown effect looks a little like
    generic            block, kernel and description of what varies without a name, or None
    not_observable     name and needs of the effects that these recordings cannot show
    smallest_visible   by effect, the smallest rms size of a parameter that would have been seen, and its unit
    next_motion        the motion that would decide, or None: description, program, `simulate` (the options of
                       `imucal simulate` that go with it), `on_its_own` (whether it is to be searched without
                       the recordings that are there), and chi2 by which it separates the rivals
    gap                metric, before, after, floor, closed, on recordings that no fit has seen; where a
                       calibration was given and judged on control recordings `before` is its figure, and
                       `refitted` that of the fit without effects, else None
    where              where measurement and model disagree: channels, depends, rests, moves, turns_about
                       (docs/gap.md); None for refused recordings
    corrected_error    predicted error of the corrected signals, averaged over 1 s: angular_rate_rms_radps and
                       specific_force_rms_mps2, each with before, after, factor (before over after), and
                       factor_low and factor_high, its 95 % interval; None if nothing joined
    traces             by effect, `times_noise` by kind of residual at its typical size, and the share of it
                       that the 21 parameters take up
    calibration_set, control_set   figures before and after
    held_out           without a control record, figures before and after on rests and moves that were left
                       out
    fits               the plain calibration and that with what joined, `before` and `after`
    calibration        the improved calibration, or the plain one if nothing was found; None for a data fault
    ranking            all candidates against the plain model, best first
    notes              what a careful reader should know
    user_effects       effects of one's own that were looked for
    """

    def __repr__(self) -> str:
        names = ", ".join([self.verdict, *(effect["name"] for effect in self.effects)])
        if self.gap is None:
            return f"Gap({names})"
        figures = f"{self.gap['metric']} {self.gap['before']:.4g} -> {self.gap['after']:.4g}"
        return f"Gap({names}; {figures} on what no fit has seen)"

    def _repr_html_(self) -> str | None:
        """The HTML of notebooks."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal gap --json`."""
        names = (
            "verdict",
            "effects",
            "ambiguous_with",
            "resembles",
            "generic",
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
        document = {"schema": SCHEMA, **{name: without_nan(getattr(self, name)) for name in names}}
        document["findings"] = [finding.to_dict() for finding in self.findings]
        document["provenance"] = None if self.calibration is None else self.calibration.provenance
        return dict(plain(document))

    def explain(self, name: str) -> list[str]:
        """What an effect is, how it would look here, whether it could be seen, how large it may be unseen.

        Raises InputError for a name that is neither in the catalogue nor in `user_effects`.
        """
        return list(explanation(self, name))

    def summary(self) -> str:
        """The finding in sentences."""
        return "\n".join(sentences(self))
