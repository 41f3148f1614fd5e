"""What is looked for in a search: the recordings of a unit, the recordings that judge, and the options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.effects.definition import UserEffect
from imucal.estimation.options import Options
from imucal.estimation.user_effects import UserEffectSource
from imucal.recording.recording import Recording

__all__ = ["Question"]


@dataclass(frozen=True, eq=False)
class Question:
    """The recordings of a unit, and what is looked for in them. The compiled library reads fields by name.

    recordings    of one unit, each with a name of its own
    control       recordings that only judge; none to hold out rests and moves
    options       of every fit
    candidates    names of the catalogue to look for; None for all of them
    definitions   the user's effects by name
    calibration   the calibration to compare with, if there is one
    stage         is called with words before each step
    """

    recordings: Sequence[Recording]
    control: Sequence[Recording]
    options: Options
    candidates: Sequence[str] | None
    definitions: Mapping[str, UserEffect]
    calibration: Calibration | None
    stage: Callable[[str], None]

    @property
    def user_effects(self) -> UserEffectSource | None:
        """The user's effects for the compiled library, those of the given calibration included."""
        own, given = tuple(self.definitions.values()), self.calibration
        if not own and (given is None or not given.user_effects):
            return None
        return UserEffectSource(own, self.recordings, self.control, given)

    @property
    def given(self) -> tuple[Calibration, float, list[Recording] | None] | None:
        """The given calibration, its gravity, and the judging recordings it corrects if only Python can."""
        if self.calibration is None:
            return None
        corrected = None
        if self.calibration.user_effects:
            judges = self.control or self.recordings
            corrected = [self.calibration.apply_recording(recording) for recording in judges]
        return self.calibration.without_user_effects(), self.calibration.gravity_mps2, corrected

    def answer(self) -> _core.GapResult:
        """What the compiled library finds; raises as `find_gap`."""
        return _core.find_gap(self, self._progress)

    def _progress(self, effects: Sequence[str] | None, candidates: int | None) -> None:
        if candidates is not None:
            self.stage(f"scoring {candidates} effects")
        elif effects is None:
            self.stage("predicting the error of corrected signals")
        else:
            self.stage(f"fitting with {' and '.join(effects)}" if effects else "fitting without effects")
