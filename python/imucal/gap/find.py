"""Find the missing effects that explain the disagreement between recordings and model.

    gap = imucal.find_gap(run, control=control)
    gap.verdict, gap.effects, gap.calibration, gap.next_motion

First the recordings are calibrated with the 21 base parameters. Each effect of the catalogue and each
user-defined effect is then scored by its log Bayes factor (docs/model.md (23)). The best effect is added and
the model is refitted. This is repeated until no significant effect remains. An effect is rejected if it makes
the prediction of control recordings, or of held-out rests and moves, worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.frame import in_frame
from imucal.calibration.model import SensorModel
from imucal.calibration.references import References
from imucal.calibration.triad import Triad
from imucal.effects.definition import UserEffect, by_name
from imucal.effects.formula import is_formula
from imucal.effects.formula_effect import FormulaEffect, formula_effects
from imucal.effects.table import find
from imucal.errors import InputError, NotEnoughMotionError
from imucal.estimation.evaluate import require_judges
from imucal.estimation.holds import Hold, holds_of
from imucal.estimation.options import Options
from imucal.gap.columns import column_effects
from imucal.gap.laws.search import with_laws
from imucal.gap.question import Question
from imucal.gap.result import Gap
from imucal.gap.soak import is_soak
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
    model: str = "full",
    hold: Hold = (),
    stage: Callable[[str], None] = lambda _: None,
) -> Gap:
    """Find where recordings disagree with the model, identify missing effects, and add them to the model.

    recordings          recordings of one unit, for the fits
    control             recordings of the same unit that are used only for validation; without them, the rests
                        and moves are divided into three folds, and each fold is held out in turn
    calibration         existing calibration with which the result is compared; without it, the result is
                        compared with the fit without effects
    candidates          names of candidate effects from the catalogue. Names of user-defined effects, and
                        formulas such as "gyro: k * (supply_v - 3.3)", are also allowed; a list with only such
                        names and formulas excludes the catalogue. None selects all effects of the catalogue.
                        Without `user_effects`, None also selects biases that depend on an auxiliary column of
                        the recordings, such as a supply voltage
    user_effects        user-defined effects, which are always candidates
    gravity_mps2        local gravity, m/s^2; default: gravity of `calibration`, else standard gravity
    min_rest_s          minimum duration of a rest, s
    exclude_saturated   whether to exclude rests and moves with saturated samples
    model, hold         which parameters have a prior in all fits, see `calibrate`
    stage               function that is called with a description of each step before the step starts

    Raises the errors of `calibrate`. Faults of the data raise no error, but give the verdict `data_fault`.
    """
    if calibration is not None:
        require_calibration(calibration)
        # Effects are defined in the symmetric body frame, in which the sensitivity matrix of the
        # accelerometer is symmetric. The given calibration is therefore converted to this frame.
        calibration = in_frame(calibration, "symmetric")
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
    _require_list(candidates)
    unit_data = of_one_unit(unit_data)
    candidates, formulas = _without_formulas(candidates, [*unit_data, *judges])
    own = by_name(user_effects)
    if candidates is None and not own:
        formulas = column_effects([*unit_data, *judges])
    named = by_name([*own.values(), *formulas])
    wanted = _wanted(candidates, named)
    if judges:
        judges = with_own_names(judges)
        require_other_data(
            unit_data, judges, "leave --control away: held-out rests and moves then verify the result"
        )
        require_judges(_nominal(unit_data[0]), judges)
    references = References("standard" if gravity_mps2 is None else "given")
    if calibration is not None and gravity_mps2 is None:
        references = calibration.references
        if references.gravity_from == "unknown":
            # If the calibration was imported and its file does not state local gravity, standard gravity is
            # assumed.
            references = References("standard")
    options = Options(
        gravity_mps2=gravity,
        gravity_sigma_mps2=references.gravity_sigma_mps2,
        clock_ppm=references.clock_ppm,
        min_rest_s=min_rest_s,
        exclude_saturated=exclude_saturated,
        model=model,
        hold=holds_of(hold),
    )
    question = Question(unit_data, judges, options, wanted, named, calibration, references, stage)
    try:
        found = gap_of(question, question.answer())
    except NotEnoughMotionError as error:
        if not all(map(is_soak, unit_data)):
            raise
        raise NotEnoughMotionError(
            f"{error}; a temperature sweep in one pose determines only how the biases depend on the "
            "temperature: use imucal soak"
        ) from error
    # Laws (formulas for residuals that no effect of the catalogue describes) are searched only if no
    # candidates are given.
    return with_laws(question, found) if candidates is None else found


def _nominal(recording: Recording) -> SensorModel:
    """Sensor model without errors, in the raw units of a recording."""
    triad = Triad(np.eye(3), np.zeros(3))
    return SensorModel(
        triad, triad, accel_unit=recording.accel_unit, gyro_unit=recording.gyro_unit, axes=recording.axes
    )


def _require_list(candidates: Sequence[str] | None) -> None:
    if isinstance(candidates, str):
        raise InputError(f"candidates is the string {candidates!r}: give a list of names, [{candidates!r}]")
    if candidates is not None and not candidates:
        raise InputError("candidates is empty: give names of effects, or omit it to test all effects")


def _without_formulas(
    candidates: Sequence[str] | None, recordings: Sequence[Recording]
) -> tuple[Sequence[str] | None, tuple[FormulaEffect, ...]]:
    """Names of the candidates, and the effects that are defined by the formulas among the candidates."""
    if candidates is None:
        return None, ()
    effects = formula_effects([name for name in candidates if is_formula(name)], recordings)
    names = [name for name in candidates if not is_formula(name)]
    return [*names, *(effect.name for effect in effects)], effects


def _wanted(candidates: Sequence[str] | None, own: Mapping[str, UserEffect]) -> list[str] | None:
    """Names of candidate effects from the catalogue; None for all effects."""
    if candidates is None:
        return None
    return [find(name).name for name in candidates if name not in own]
