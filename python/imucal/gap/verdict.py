"""What is said of what a search has found: one word, and what decided.

data_fault        faults of the data explain the disagreement, may, or are too many to be passed over
stochastic        a bias wanders at random
unknown           something that no effect of the catalogue describes, or the control recordings deny it
named, ambiguous  effects joined; ambiguous if others explain as much
nothing_missing   noise explains the recordings
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import imucal._core as _core
from imucal.calibration.figures import poor_figures
from imucal.effects.disturbance import disturbances
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.gap.rules import faults_without_effect, mount_slips
from imucal.gap.trial import Trial

__all__ = ["Verdict", "judge", "misfits"]

# Evidence that no chance explains, nats.
SURELY: Final = 8.0
# Lost or doubled samples, percent of all: fewer are no verdict by themselves where nothing disagrees.
A_FEW: Final = {"samples_missing": 0.2, "samples_duplicated": 0.2}
# An effect that leaves more of a control recording's chi2 has not explained it.
CLEARLY_LESS: Final = 0.9


@dataclass(frozen=True)
class Verdict:
    """The word, and what it rests on.

    faults         of the data; empty unless they are the verdict
    rivals         of each effect that joined, the names that explain as much
    not_confirmed  what fits the recordings too well for chance, and not what no fit has seen
    notes          why effects that had joined went again
    """

    word: str
    faults: tuple[Finding, ...]
    rivals: Mapping[str, Sequence[str]]
    not_confirmed: tuple[_core.EffectScore, ...]
    notes: tuple[str, ...]

    @property
    def has_names(self) -> bool:
        """Whether effects have joined."""
        return self.word in ("named", "ambiguous")


def judge(
    trial: Trial,
    found: _core.Search,
    path: Sequence[str],
    before: CalibrationResult,
    after: CalibrationResult,
) -> Verdict:
    """The verdict on what was found; `before` and `after` are fits without and with `path`."""
    slips = list(mount_slips(before, trial.unit_data))
    faults, disturbing = _faults(trial, found, path, before, slips)
    of = {score.name: score.rivals for score in found.path}
    rivals = {name: [rival for rival in of[name] if rival not in path] for name in path}
    # What fits so well is no chance, and not what the unseen recordings have either.
    not_confirmed = [score for score in found.path if score.log_bayes_factor > SURELY and not path]
    disagrees = found.scattering_rests is not None or bool(not_confirmed) or bool(misfits(before))
    notes: tuple[str, ...] = ()
    if slips or (found.generic is not None and disturbing):
        # What no effect explains where samples are spoilt, they may.
        word = "data_fault"
    elif found.generic is not None:
        word = "stochastic" if found.generic.kernel == "random_walk" else "unknown"
    elif path and found.scattering_rests is None:
        word = "ambiguous" if any(rivals.values()) else "named"
        contradicted = _contradicted(trial, path, before, after)
        if contradicted is not None:
            word, notes = "unknown", (contradicted,)
    elif faults and not path and (disagrees or not all(map(_are_few, faults))):
        word = "data_fault"
    else:
        word = "unknown" if disagrees else "nothing_missing"
    said = (*slips, *faults) if word == "data_fault" else ()
    return Verdict(word, said, rivals, tuple(not_confirmed), notes)


def misfits(result: CalibrationResult) -> list[str]:
    """Why this calibration does not describe its recordings, or the control recordings; empty if it does."""
    sets = {"calibration set": result.calibration_set, "control set": result.control_set}
    return [
        reason
        for name, figures in sets.items()
        if figures is not None
        for reason in poor_figures(name, figures)
    ]


def _faults(
    trial: Trial,
    found: _core.Search,
    path: Sequence[str],
    before: CalibrationResult,
    slips: Sequence[Finding],
) -> tuple[list[Finding], bool]:
    """Faults of the data, which come before any effect, and whether they disturb noise and moves."""
    rules = {row.name for row in disturbances() if row.kind == "fault"}
    faults = [finding for finding in before.findings if finding.code in rules]
    # Samples at a rail or twice disturb noise and moves by themselves.
    is_disturbed = bool({fault.code for fault in faults} - {"clock_irregular", "samples_missing"})
    if not slips and not path and found.generic is None and not is_disturbed:
        faults += faults_without_effect(before, trial.unit_data)
    if any(fault.code == "clock_irregular" for fault in faults):
        # With such a clock long steps say nothing of lost samples.
        faults = [fault for fault in faults if fault.code != "samples_missing"]
    return faults, is_disturbed


def _are_few(fault: Finding) -> bool:
    """Whether so few samples are concerned that no fit is disturbed."""
    return fault.severity == "warning" and fault.value < A_FEW.get(fault.code, 0.0)


def _contradicted(
    trial: Trial, path: Sequence[str], before: CalibrationResult, after: CalibrationResult
) -> str | None:
    """Why control recordings that fit no better with the effects do not confirm them; None if they do."""
    if after.control_set is None or not poor_figures("control set", after.control_set):
        return None
    least, left = (trial.unseen_chi2(result) for result in (before, after))
    if left <= CLEARLY_LESS * least:
        return None
    return (
        f"{' and '.join(path)} was found and left out: chi2 per degree of freedom of the control recordings "
        f"goes from {least:.4g} to {left:.4g}"
    )
