"""Finding the missing effect: where simulation and measurement disagree, what explains it, and what is left.

    gap = imucal.find_gap(run, control=control)
    gap.verdict, gap.effects, gap.calibration, gap.next_motion

The recordings are calibrated with the 21 parameters alone; every effect of the catalogue, and every effect of
one's own, is scored by its evidence (docs/model.md (23)); the best one joins, all is fitted again, until
nothing is left. Recordings that no fit has seen decide whether an effect may stay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.model import SensorModel
from imucal.calibration.triad import Triad
from imucal.effects.definition import UserEffect, by_name
from imucal.effects.table import find
from imucal.errors import InputError
from imucal.estimation.evaluate import require_judges
from imucal.estimation.options import Options
from imucal.gap.question import Question
from imucal.gap.result import Gap
from imucal.gap.translation import gap_of
from imucal.recording.one_unit import of_one_unit, require_other_data, with_own_names
from imucal.recording.recording import Recording, as_recordings
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["find_gap"]


def find_gap(
    recordings: Recording | Sequence[Recording],
    *,
    control: Recording | Sequence[Recording] | None = None,
    calibration: Calibration | None = None,
    candidates: Sequence[str] | None = None,
    user_effects: Sequence[UserEffect] = (),
    gravity_mps2: float | None = None,
    min_rest_s: float = _core.MIN_REST_S,
    exclude_saturated: bool = False,
    stage: Callable[[str], None] = lambda _: None,
) -> Gap:
    """Find where the recordings disagree with the model, name the effect that is missing, and add it.

    control       recordings that only judge; without them rests and moves are held out, in three folds
    calibration   the calibration that is judged; without it one is made of the recordings
    candidates    names of the catalogue to look for; all of them if not given. Names of one's own effects may
                  stand there, too: alone, nothing of the catalogue is looked for
    user_effects  effects of one's own, which are always looked for
    stage         is told what is being done

    Raises as `calibrate`, but for faults of the data: those are a verdict.
    """
    if calibration is not None:
        require_calibration(calibration)
        if calibration.frame != "symmetric":
            raise InputError(
                f"the calibration is in the {calibration.frame} body frame, and effects are defined by the "
                "axes of the symmetric one: make it with frame='symmetric', or leave it out"
            )
    gravity = (
        gravity_mps2
        if gravity_mps2 is not None
        else (STANDARD_GRAVITY_MPS2 if calibration is None else calibration.gravity_mps2)
    )
    unit_data = as_recordings(recordings)
    judges = as_recordings(control)
    if calibration is not None:
        for recording in (*unit_data, *judges):
            calibration.require_raw_units(recording)
    named = by_name(user_effects)
    wanted = _wanted(candidates, named)
    unit_data = of_one_unit(unit_data)
    if judges:
        judges = with_own_names(judges)
        require_other_data(unit_data, judges)
        require_judges(_nominal(unit_data[0]), judges)
    options = Options(gravity_mps2=gravity, min_rest_s=min_rest_s, exclude_saturated=exclude_saturated)
    question = Question(unit_data, judges, options, wanted, named, calibration, stage)
    return gap_of(question, question.answer())


def _nominal(recording: Recording) -> SensorModel:
    """Sensors without errors in the raw units of a recording."""
    triad = Triad(np.eye(3), np.zeros(3))
    return SensorModel(triad, triad, accel_unit=recording.accel_unit, gyro_unit=recording.gyro_unit)


def _wanted(candidates: Sequence[str] | None, own: Mapping[str, UserEffect]) -> list[str] | None:
    """The names of the catalogue to look for; None for all of them."""
    if candidates is None:
        return None
    if isinstance(candidates, str):
        raise InputError(f"candidates is the string {candidates!r}: give a list of names, [{candidates!r}]")
    if not candidates:
        raise InputError("candidates is empty, so there is nothing to look for: give names, or leave it out")
    return [find(name).name for name in candidates if name not in own]
