"""The recordings of a search, and how models of them are fitted and judged on what no fit has seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

import imucal._core as _core
from imucal.calibration.figures import Figures
from imucal.effects.definition import UserEffect
from imucal.effects.table import catalogue
from imucal.errors import FitError, InputError, NotEnoughMotionError
from imucal.estimation.calibrate import calibrated, fields_for_library
from imucal.estimation.options import Options, asked_for
from imucal.estimation.result import CalibrationResult
from imucal.recording.one_unit import of_one_unit, require_other_data, with_own_names
from imucal.recording.recording import Recording

if TYPE_CHECKING:
    from imucal.estimation.evaluate import Evaluation

__all__ = ["Trial", "require_figures"]

FOLDS: Final = 3
# Figures of two fits that differ by less than this share are the same, by less than this one perhaps.
SAME: Final = 0.005
ONLY_CHANCE: Final = 0.1
# Chance does not change a sum by more standard deviations.
SURE: Final = 3.0


class Trial:
    """The recordings, and how models of them are judged."""

    def __init__(
        self,
        unit_data: Sequence[Recording],
        judges: Sequence[Recording] | None,
        gravity_mps2: float,
        min_rest_s: float,
        exclude_saturated: bool,
        user_effects: Mapping[str, UserEffect],
        stage: Callable[[str], None],
    ) -> None:
        self.unit_data, self.user_effects = of_one_unit(unit_data), user_effects
        self.judges = None if judges is None else with_own_names(judges)
        require_other_data(self.unit_data, judges or ())
        self.gravity_mps2, self.min_rest_s = gravity_mps2, min_rest_s
        self.options = Options(
            gravity_mps2=gravity_mps2, min_rest_s=min_rest_s, exclude_saturated=exclude_saturated
        )
        self.stage = stage
        self._known: _core.Checked | None = None
        self._fits: dict[tuple[str, ...], CalibrationResult] = {}

    def fit(self, names: Sequence[str]) -> CalibrationResult:
        """The calibration with these effects, judged on control recordings, or on what is held out."""
        key = tuple(names)
        if key not in self._fits:
            self._fits[key] = self._fit(key)
        return self._fits[key]

    def _fit(self, names: tuple[str, ...]) -> CalibrationResult:
        self.stage(f"fitting with {' and '.join(names)}" if names else "fitting without effects")
        effects = [self.user_effects.get(name, f"{name}:seen") for name in names]
        wanted, partly, own = asked_for(effects)
        options = replace(
            self.options, effects=wanted, partly=partly, folds=FOLDS if self.judges is None else None
        )
        result = calibrated(self._checked(), self.unit_data, options, own, self.judges or ())
        if result.control is not None:
            try:
                require_figures(result.control)
            except InputError as error:
                columns = [judge.temperature_degc for judge in self.judges or ()]
                if not names or not all(degc is None or np.isfinite(degc).all() for degc in columns):
                    raise
                # The recordings are sound and judge the plain model: the effects cannot be undone there.
                raise FitError(str(error)) from None
        return result

    def _checked(self) -> _core.Checked:
        """The recordings change as little as the options: they are checked once."""
        if self._known is None:
            self._known = _core.Checked(self.unit_data, self.options)
        return self._known

    def search(self, before: CalibrationResult, wanted: Sequence[str] | None) -> _core.Search:
        """What explains the recordings, out of the effects that are wanted."""
        names = wanted if wanted is not None else [effect.name for effect in catalogue()]
        self.stage(f"scoring {len(names) + len(self.user_effects)} effects")
        fields = fields_for_library(before.calibration, self.unit_data, tuple(self.user_effects.values()))
        wide = [(name, False) for name in names]
        return _core.search_gap(self._checked(), self.unit_data, self.options, wide, fields)

    def metric(self, before: CalibrationResult, after: CalibrationResult) -> tuple[str, float, float, float]:
        """Name, value before and after, and floor of the figure on what no fit has seen that changes most."""
        if before.control_set is not None and after.control_set is not None:
            return "chi2_per_dof", chi2_of(before.control_set), chi2_of(after.control_set), 1.0
        figures = [
            (f"held_out_{name}", *(getattr(result.held_out, name) for result in (before, after)), floor)
            for name, (floor, _) in _floors(before).items()
        ]
        known = [(name, a, b, floor) for name, a, b, floor in figures if a is not None and b is not None]
        return max(known, key=lambda figure: figure[1] / max(figure[2], 1e-300))

    def unseen_chi2(self, result: CalibrationResult) -> float:
        """chi2 per degree of freedom of what no fit has seen."""
        if result.control_set is not None:
            return chi2_of(result.control_set)
        terms: list[tuple[int, float]] = [
            (count, count * (value / floor) ** 2)
            for name, (floor, count) in _floors(self.fit(())).items()
            if (value := getattr(result.held_out, name)) is not None and floor > 0
        ]
        return sum(chi2 for _, chi2 in terms) / max(sum(count for count, _ in terms), 1)

    def accepted(
        self, before: CalibrationResult, path: Sequence[str]
    ) -> tuple[list[str], CalibrationResult, list[str]]:
        """The effects that do not make what no fit has seen worse, their fit, and why others went."""
        notes: list[str] = []
        names: list[str] = []
        best = before
        for name in path:
            try:
                trial = self.fit([*names, name])
            except (FitError, NotEnoughMotionError) as error:
                notes.append(f"{name} was found and cannot be fitted: {error}")
                continue
            value, least = self.unseen_chi2(trial), self.unseen_chi2(best)
            if self._is_worse(trial, best):
                notes.append(
                    f"{name} was found and left out: chi2 per degree of freedom of what no fit has seen goes "
                    f"from {least:.4g} to {value:.4g}"
                )
                continue
            names.append(name)
            best = trial
        if len(names) < len(path):
            # What does not help alone may help together.
            try:
                whole = self.fit(path)
            except (FitError, NotEnoughMotionError):
                return names, best, notes
            if self.unseen_chi2(whole) < self.unseen_chi2(best):
                return list(path), whole, []
        return names, best, notes

    def _is_worse(self, trial: CalibrationResult, best: CalibrationResult) -> bool:
        """Whether what no fit has seen is predicted worse, by more than chance."""
        value, least = self.unseen_chi2(trial), self.unseen_chi2(best)
        if value <= least * (1 + SAME):
            return False
        ours, theirs = (
            {**_squares(result), **_squares_of_rates(result, self.judges)} for result in (trial, best)
        )
        change = np.array([ours[item] - theirs[item] for item in ours.keys() & theirs.keys()])
        # By chance all items go with the parameters: as many as those of the fit change by chi2 of as many
        # degrees of freedom as there are parameters. And each goes up or down by itself.
        shared = 2.0 * len(trial.calibration.parameters)
        together, alone = SURE * np.sqrt(shared), SURE * np.sqrt(shared + len(change) * np.var(change))
        much = max(ONLY_CHANCE * least, together / max(len(change), 1))
        return bool(value > least + much or np.sum(change) > alone)


def require_figures(control: Evaluation) -> None:
    """Refuse control recordings that judge nothing, with InputError."""
    if control.figures.chi2_per_dof is None:
        raise InputError("; ".join(control.reasons))


def chi2_of(figures: Figures) -> float:
    """chi2 per degree of freedom of figures that `require_figures` has accepted."""
    return math.nan if figures.chi2_per_dof is None else figures.chi2_per_dof


def _squares(result: CalibrationResult) -> dict[tuple[str, int], float]:
    """chi2 of each rest and of each move that no fit has seen."""
    if result.control is not None:
        rests, moves = result.control.rests, result.control.moves
        norms = [rest.norm_error_mps2 for rest in rests]
        turns = [move.direction_error_deg for move in moves]
    else:
        held_out = result.held_out
        rests, moves = result.rests, result.moves
        norms = [] if held_out is None else list(held_out.norm_error_mps2)
        turns = [] if held_out is None else list(held_out.direction_error_deg)
    known = [
        (("rest", k), error, rest.norm_sigma_mps2)
        for k, (error, rest) in enumerate(zip(norms, rests, strict=False))
    ]
    known += [
        (("move", k), error, move.direction_sigma_deg)
        for k, (error, move) in enumerate(zip(turns, moves, strict=False))
    ]
    return {item: (error / sigma) ** 2 for item, error, sigma in known if error is not None and sigma}


def _squares_of_rates(
    result: CalibrationResult, judges: Sequence[Recording] | None
) -> dict[tuple[str, int], float]:
    """chi2 of the mean rate of each rest of the control recordings about the mean of all of them.

    Some effects of the gyroscope, an isotropic g-sensitivity say, show there alone. The noise is that of the
    samples as they were recorded: to take a delay away makes them smoother, and their mean no better known.
    """
    if result.control is None or judges is None:
        return {}
    squares: dict[tuple[str, int], float] = {}
    for recording in judges:
        rate = result.calibration.apply_recording(recording).angular_rate
        to_rate = np.linalg.inv(result.calibration.gyroscope.sensitivity).T
        rests = [
            (k, slice(rest.first, rest.end))
            for k, rest in enumerate(result.control.rests)
            if rest.recording == recording.name and rest.excluded is None
        ]
        if not rests:
            continue
        means = np.array([rate[span].mean(axis=0) for _, span in rests])
        recorded = [recording.angular_rate[span] @ to_rate for _, span in rests]
        sigma = np.array([samples.std(axis=0) / np.sqrt(len(samples)) for samples in recorded])
        chi2 = np.sum(((means - means.mean(axis=0)) / sigma) ** 2, axis=1)
        squares |= {("rate", k): float(value) for (k, _), value in zip(rests, chi2, strict=True)}
    return squares


def _floors(result: CalibrationResult) -> dict[str, tuple[float, int]]:
    """What noise alone leaves of each figure that is held out, and of how many numbers it is."""
    moves = [m.direction_sigma_deg for m in result.moves if m.direction_sigma_deg is not None]
    rests = [r.norm_sigma_mps2 for r in result.rests if r.norm_sigma_mps2 is not None]
    # Both components of a direction have its standard deviation.
    direction = float(np.sqrt(2.0 * np.mean(np.square(moves)))) if moves else 0.0
    norm = float(np.sqrt(np.mean(np.square(rests)))) if rests else 0.0
    return {
        "gravity_direction_rms_deg": (direction, 2 * len(moves)),
        "gravity_norm_rms_mps2": (norm, len(rests)),
    }
