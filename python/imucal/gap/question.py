"""Input of a search for effects: recordings of a unit, control recordings, and options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.references import References
from imucal.effects.definition import UserEffect
from imucal.estimation.options import Options
from imucal.estimation.user_effects import UserEffectSource
from imucal.recording.recording import Recording

__all__ = ["Question"]


@dataclass(frozen=True, eq=False)
class Question:
    """Input of a search. The compiled library reads these fields by name.

    recordings    recordings of one unit, with distinct names
    control       recordings for validation only; empty to hold out rests and moves instead
    options       options of all fits
    candidates    names of candidate effects from the catalogue; None for all effects
    definitions   user-defined effects by name
    calibration   calibration with which the result is compared; None to compare the result with the fit
                  without effects
    references    sources and standard deviations of local gravity and the clock
    stage         function that is called with a description of each step before the step starts
    """

    recordings: Sequence[Recording]
    control: Sequence[Recording]
    options: Options
    candidates: Sequence[str] | None
    definitions: Mapping[str, UserEffect]
    calibration: Calibration | None
    references: References
    stage: Callable[[str], None]

    @property
    def user_effects(self) -> UserEffectSource | None:
        """User-defined effects for the compiled library, including the effects of the given calibration."""
        own, given = tuple(self.definitions.values()), self.calibration
        if not own and (given is None or not given.user_effects):
            return None
        return UserEffectSource(own, self.recordings, self.control, given)

    @property
    def given(self) -> tuple[Calibration, float, list[Recording] | None] | None:
        """The given calibration, its gravity, m/s^2, and the recordings that the calibration has corrected.

        The corrected recordings are the control recordings or, without control recordings, the calibration
        recordings. They are None if the given calibration has no user-defined effects, because the compiled
        library then corrects the recordings.
        """
        if self.calibration is None:
            return None
        corrected = None
        if self.calibration.user_effects:
            judges = self.control or self.recordings
            corrected = [self.calibration.apply_recording(recording) for recording in judges]
        return self.calibration.without_user_effects(), self.calibration.gravity_mps2, corrected

    def answer(self) -> _core.GapResult:
        """Run the search in the compiled library; raises the errors of `find_gap`."""
        return _core.find_gap(self, self._progress)

    def _progress(self, effects: Sequence[str] | None, candidates: int | None) -> None:
        if candidates is not None:
            self.stage(f"scoring {candidates} effects")
        elif effects is None:
            self.stage("predicting the error of corrected signals")
        else:
            self.stage(f"fitting with {' and '.join(effects)}" if effects else "fitting without effects")
