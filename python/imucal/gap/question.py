"""What a search is asked: the recordings of a unit, what judges them, and the options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.effects.definition import UserEffect
from imucal.estimation.options import Options
from imucal.estimation.user_effects import UserEffectSource
from imucal.recording.recording import Recording

__all__ = ["Question"]

AND: Final = " and "


@dataclass(frozen=True, eq=False)
class Question:
    """The recordings of a unit, and what is looked for in them.

    recordings    of one unit, each with a name of its own
    control       recordings that only judge; None to hold out rests and moves
    options       of every fit
    candidates    names of the catalogue to look for; None for all of them
    user_effects  definitions of the user's effects by name
    calibration   the calibration to compare with, if there is one
    stage         is called with words before each step
    """

    recordings: Sequence[Recording]
    control: Sequence[Recording] | None
    options: Options
    candidates: Sequence[str] | None
    user_effects: Mapping[str, UserEffect]
    calibration: Calibration | None
    stage: Callable[[str], None]

    @property
    def judges(self) -> Sequence[Recording]:
        """The control recordings, or the recordings themselves if there are none."""
        return self.recordings if self.control is None else self.control

    def answer(self) -> _core.GapResult:
        """What the compiled library finds; raises as `find_gap`."""
        own = tuple(self.user_effects.values())
        given = self.calibration
        has_own = own or (given is not None and given.user_effects)
        source = UserEffectSource(own, self.recordings, self.control or (), given) if has_own else None
        return _core.find_gap(
            self.recordings,
            self.control or (),
            self.options,
            self.candidates,
            source,
            self._given(),
            self._progress,
        )

    def _given(self) -> tuple[Calibration, float, list[Recording] | None] | None:
        if self.calibration is None:
            return None
        corrected = None
        if self.calibration.user_effects:
            corrected = [self.calibration.apply_recording(recording) for recording in self.judges]
        return self.calibration.without_user_effects(), self.calibration.gravity_mps2, corrected

    def _progress(self, effects: Sequence[str] | None, candidates: int | None) -> None:
        if candidates is not None:
            self.stage(f"scoring {candidates} effects")
        elif effects is None:
            self.stage("predicting the error of corrected signals")
        else:
            self.stage(f"fitting with {AND.join(effects)}" if effects else "fitting without effects")
