"""Finding the missing effect: where simulation and measurement disagree, what explains it, and what is left.

    gap = imucal.find_gap(run, control=control)
    gap.verdict, gap.effects, gap.calibration, gap.next_motion

The recordings are calibrated with the 21 parameters alone; every effect of the catalogue, and every effect of
one's own, is scored by its evidence (docs/model.md (23)); the best one joins, all is fitted again, until
nothing is left. Recordings that no fit has seen decide whether an effect may stay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration, require_calibration
from imucal.effects.definition import UserEffect, by_name
from imucal.effects.table import catalogue, find
from imucal.errors import FitError, InputError, NotEnoughMotionError
from imucal.gap.outcome import data_fault, outcome
from imucal.gap.result import Gap
from imucal.gap.trial import Trial
from imucal.recording.recording import MIN_REST_S, Recording, as_recordings
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
    min_rest_s: float = MIN_REST_S,
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
    judges = None if control is None else as_recordings(control)
    if calibration is not None:
        for recording in (*unit_data, *(judges or ())):
            calibration.require_raw_units(recording)
    named = by_name(user_effects)
    wanted = _wanted(candidates, named)
    trial = Trial(unit_data, judges, gravity, min_rest_s, exclude_saturated, named, stage)
    try:
        before = trial.fit(())
    except InputError as error:
        if not error.findings:
            raise
        return replace(data_fault(error.findings), user_effects=tuple(named.values()))
    found = trial.search(before, wanted)
    refused = _not_the_earth(trial, found)
    if refused is not None and "earth_rate" in [score.name for score in found.path]:
        others = wanted if wanted is not None else [effect.name for effect in catalogue()]
        found = trial.search(before, [name for name in others if name != "earth_rate"])
    path, after, notes = trial.accepted(before, [score.name for score in found.path])
    notes += [] if refused is None else [refused]
    notes += [
        f"{name} fits these recordings (log Bayes factor {evidence:.1f}) and does not predict rests and "
        f"moves that are held out: {gain:.1f} +- {std:.1f} nats"
        for name, evidence, gain, std in found.not_predictive
    ]
    notes += [
        f"{name} was asked for and these recordings cannot show it: it needs {needs}"
        for name, needs in found.not_observable
        if wanted is not None or name in named
    ]
    return outcome(trial, found, path, before, after, calibration, notes)


def _wanted(candidates: Sequence[str] | None, own: Mapping[str, UserEffect]) -> list[str] | None:
    """The names of the catalogue to look for; None for all of them."""
    if candidates is None:
        return None
    if isinstance(candidates, str):
        raise InputError(f"candidates is the string {candidates!r}: give a list of names, [{candidates!r}]")
    if not candidates:
        raise InputError("candidates is empty, so there is nothing to look for: give names, or leave it out")
    return [find(name).name for name in candidates if name not in own]


def _not_the_earth(trial: Trial, found: _core.Search) -> str | None:
    """Why what was named earth_rate is not it: the rate of the Earth is known; None if it may be.

    Its direction is free, for the heading is not known and every latitude is possible. Where that is clear
    the search has looked for something else already.
    """
    if found.not_the_earth is not None:
        return _not_as_fast(*found.not_the_earth)
    path = [score.name for score in found.path]
    if "earth_rate" not in path:
        return None
    try:
        calibration = trial.fit(path).calibration
    except (FitError, NotEnoughMotionError) as error:
        return f"earth_rate was found and cannot be fitted: {error}"
    own = [k for k, name in enumerate(calibration.covariance_names) if name.startswith("earth_rate_")]
    values = next(values for values in calibration.effects if values.name == "earth_rate").values
    size = float(np.linalg.norm(values))
    direction = np.asarray(values) / size
    sigma = float(np.sqrt(direction @ np.asarray(calibration.covariance)[np.ix_(own, own)] @ direction))
    return None if _core.is_earth_rate(size, sigma) else _not_as_fast(size, sigma)


def _not_as_fast(size_radps: float, sigma_radps: float) -> str:
    known = find("earth_rate").parameters[0].typical
    return (
        f"earth_rate fits these recordings with {size_radps:.3g} +- {sigma_radps:.1g} rad/s, and the Earth "
        f"turns with {known:.4g}: something else is there, or they do not determine it"
    )
