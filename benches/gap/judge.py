"""Opens the answer after the tool has answered, and compares.

first        the first name is a hidden effect
exact        the names are the hidden effects, no more and no less
wrong        one name or more, in a verdict of certainty, and one of them is not hidden
false_alarm  a name on a clean run, or another verdict than the answer allows there
verdict_ok   the verdict is one of those that the answer allows, and the truth is in what it names
block_ok     an unknown effect was found in the right part of the model
truth        the names that are right
"""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

import imucal
from gap.case import Answer, Case, Sealed
from gap.said import Said
from gap.scene import BY_HAND
from gap.worth import Worth
from imucal.effects.definition import named_numbers

CERTAIN = ("named", "data_fault")
INTERVAL_95 = 1.959964


@dataclass(frozen=True)
class Mark:
    """One case, one tool."""

    tool: str
    group: str
    label: str
    level: str
    kind: str
    index: int
    said: dict[str, Any]
    first: bool | None = None
    exact: bool | None = None
    wrong: bool = False
    false_alarm: bool | None = None
    verdict_ok: bool = False
    block_ok: bool | None = None
    scores: tuple[float, ...] = ()
    closed: float | None = None
    figures: dict[str, float | None] = field(default_factory=dict)
    solved_by_advice: bool | None = None
    advised: dict[str, Any] | None = None
    worth: Worth = field(default_factory=dict)
    truth: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str, str, str, int]:
        """That of the case."""
        return self.group, self.label, self.level, self.kind, self.index


def judge(
    tool: str,
    case: Case,
    said: Said,
    sealed: Sealed,
    figures: dict[str, float | None] | None = None,
    advised: Said | None = None,
    claims: Worth | None = None,
) -> Mark:
    """Compare; the seal opens here."""
    answer = sealed.open(said)
    truth = set(answer.truth)
    names = set(said.names)
    hidden = bool(answer.effects)
    first = said.names[:1] and said.names[0] in truth if truth else None
    return Mark(
        tool,
        case.group,
        case.label,
        case.level,
        case.kind,
        case.index,
        asdict(said),
        first=None if first is None else bool(first),
        exact=names == truth if hidden else None,
        wrong=said.verdict in CERTAIN and bool(names - truth - {answer.fault}),
        false_alarm=_false_alarm(said, answer),
        verdict_ok=_verdict_ok(said, answer),
        block_ok=_block_ok(said, answer),
        scores=_scores(case, said, answer) if hidden and names == truth else (),
        closed=_closed(figures or {}),
        figures=figures or {},
        solved_by_advice=None if advised is None else bool(advised.names) and set(advised.names) == truth,
        advised=None if advised is None else asdict(advised),
        worth=claims or {},
        truth=answer.truth,
    )


def _false_alarm(said: Said, answer: Answer) -> bool | None:
    if answer.verdicts[0] != "nothing_missing":
        return None
    return said.verdict not in answer.verdicts


def _verdict_ok(said: Said, answer: Answer) -> bool:
    if said.verdict not in answer.verdicts:
        return False
    if said.verdict == "data_fault":
        return answer.fault in said.names
    if said.verdict in ("named", "ambiguous") and answer.truth:
        return bool(set(answer.truth) & {*said.names, *said.ambiguous_with})
    return True


def _block_ok(said: Said, answer: Answer) -> bool | None:
    """Whether the words for what is unknown name its sensor and its part; None if nothing was unknown."""
    if not answer.block or not said.generic:
        return None
    words = (
        said.generic.lower()
        .replace("_", " ")
        .replace("gyro ", "gyroscope ")
        .replace("accel ", "accelerometer ")
    )
    return all(word in words for word in answer.block.split())


def _scores(case: Case, said: Said, answer: Answer) -> tuple[float, ...]:
    """Errors of the estimates over their standard deviations."""
    scores = []
    for effect in answer.effects:
        if not any(row.name == effect.name for row in imucal.effects.catalogue()):
            continue
        known = [
            (value, *said.estimates[f"{effect.name}_{parameter.name}"])
            for parameter, value in named_numbers(imucal.effects.find(effect.name), effect)
            if f"{effect.name}_{parameter.name}" in said.estimates
        ]
        # Other methods give no estimates.
        if known and effect.name == "earth_rate" and case.kind in BY_HAND:
            x, y, z = known
            known = [_norm(x, y), z]
        scores += [(value - truth) / std for truth, value, std in known if np.isfinite(std) and std > 0]
    return tuple(scores)


def _norm(*horizontal: tuple[float, float, float]) -> tuple[float, float, float]:
    """Truth, estimate and standard deviation of the norm of the horizontal components.

    A unit that is turned by hand starts with an unknown heading, so the world frame of the estimate is turned
    about the vertical axis. The correlation of the components is ignored.
    """
    truth, values, stds = np.transpose(horizontal)
    norm = max(float(np.linalg.norm(values)), 1e-300)
    return float(np.linalg.norm(truth)), norm, float(np.linalg.norm(values * stds)) / norm


def control_figures(
    measured: imucal.Recording, control: imucal.Recording, improved: Any, truth: tuple[str, ...]
) -> dict[str, float | None]:
    """chi2 of the control recording: of the base model, of what the tool made, and with the true effects.

    By `imucal.evaluate`, which knows nothing of the search.
    """

    def chi2(calibration: imucal.Calibration | None) -> float | None:
        if calibration is None:
            return None
        return float(imucal.evaluate(calibration, control).figures.chi2_per_dof)

    def fitted(effects: tuple[str, ...]) -> imucal.Calibration | None:
        try:
            return imucal.calibrate(measured, effects=effects).calibration
        except imucal.ImucalError:
            return None

    return {"before": chi2(fitted(())), "after": chi2(improved), "floor": chi2(fitted(truth))}


def _closed(figures: dict[str, float | None]) -> float | None:
    """Share of the gap that is closed, of what the true effects close; None where there is hardly a gap."""
    before, after, floor = (figures.get(name) for name in ("before", "after", "floor"))
    if before is None or after is None or floor is None or before - floor < 0.5 * floor:
        return None
    return (before - after) / (before - floor)
