"""The verdict on a calibration: good, incomplete or poor, and the residuals on which it is based.

good        noise explains the residuals
incomplete  usable with a reservation, which the reasons state. Usually the residuals of one kind exceed twice
            their noise, because the model lacks an effect of the unit or of its motion
poor        not reliable
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from imucal.calibration.figures import saved_reasons

__all__ = ["RESIDUALS", "VERDICTS", "ResidualFit", "Verdict", "saved_verdict", "verdict_of", "worst"]

Verdict: TypeAlias = Literal["good", "incomplete", "poor"]
# The verdicts, the best first.
VERDICTS: Final[tuple[Verdict, ...]] = ("good", "incomplete", "poor")

# Description of each kind of residual.
RESIDUALS: Final = {
    "norms": "the norm of gravity at the rests",
    "moves": "the gravity direction after the moves",
    "rates": "the mean rates at the rests",
    "inside": "the specific force within the moves",
    "stand": "the attitude relative to the stand",
}


@dataclass(frozen=True, slots=True)
class ResidualFit:
    """The residuals of one kind, compared with their noise.

    kind                "norms" (norm of gravity at the rests), "moves" (gravity direction after the moves),
                        "rates" (mean rates at the rests), "inside" (specific force within the moves) or
                        "stand" (attitude relative to the stand)
    rms, noise          rms of the residuals, and the rms expected from noise alone, in `unit`
    unit                mg, deg or deg/h
    ratio               root of chi2 per degree of freedom; 1 if noise explains the residuals
    degrees_of_freedom  number of residuals minus the number of parameters that they determine
    p_value             probability of a larger ratio from noise alone
    exceeds_noise       whether the ratio exceeds 2 and is significant, which gives the verdict `incomplete`
    """

    kind: str
    rms: float | None
    noise: float | None
    unit: str
    ratio: float | None
    degrees_of_freedom: float | None
    p_value: float | None
    exceeds_noise: bool

    @property
    def text(self) -> str:
        """A text that compares the residuals with their noise."""
        sizes = ["-" if size is None else f"{size:.3g} {self.unit}" for size in (self.rms, self.noise)]
        return f"{RESIDUALS[self.kind].removeprefix('the ')} {sizes[0]} rms (noise {sizes[1]})"


def verdict_of(word: str) -> Verdict:
    """The verdict with this name. An unknown name, which a newer version may have written, gives `poor`."""
    return next((verdict for verdict in VERDICTS if verdict == word), "poor")


def worst(*verdicts: Verdict) -> Verdict:
    """The worst of several verdicts; `good` if there are none."""
    return max(verdicts, key=VERDICTS.index, default="good")


def saved_verdict(
    verdict: Verdict | None,
    reasons: Sequence[str],
    calibration_set: Mapping[str, Any] | None,
    control_set: Mapping[str, Any] | None,
    *,
    has_gyroscope: bool = True,
) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict and reasons in a calibration file; `poor` if its figures of merit require this."""
    poor = tuple(saved_reasons(calibration_set, control_set, has_gyroscope=has_gyroscope))
    if not poor:
        return verdict or "good", tuple(reasons)
    # A file stores a reason as its text followed by its reason code. A reason in `poor` is therefore already
    # in the file if a stored reason starts with its text.
    new = (text for text in poor if not any(reason.startswith(text) for reason in reasons))
    return "poor", (*new, *reasons)
