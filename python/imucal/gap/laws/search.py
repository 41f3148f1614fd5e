"""Searches for laws, in a second pass over the residuals that effects of the catalogue do not explain.

The recordings are corrected by the calibration with the named effects, which are the effects of the catalogue
that the first search has accepted. The residuals of the corrected recordings, and their derivatives with
respect to the coefficients of all formulas of `library`, are computed once. The laws that `select` chooses
are fitted together with the named effects. They are kept if control or held-out data confirm them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.effects.definition import UserEffect
from imucal.effects.formula_effect import FormulaEffect, formula_effects, sizes_of
from imucal.effects.state import State
from imucal.effects.table import catalogue_by_name
from imucal.errors import ImucalError, InputError
from imucal.estimation.options import UserField
from imucal.gap.laws.law import Curve, Law
from imucal.gap.laws.library import Form, further_forms, library, refined
from imucal.gap.laws.selection import Columns, Selected, select, settled
from imucal.gap.question import Question
from imucal.gap.result import Gap
from imucal.gap.translation import gap_of
from imucal.recording.recording import Recording, samples_of_both

__all__ = ["columns_of", "with_laws"]

# If the p-value of the residuals on control or held-out data is below this threshold, the named effects do
# not explain these data.
CONTRADICTED: Final = 1e-3
# The excess of a model is its figure of merit on control or held-out data minus the value from noise alone. A
# law replaces the named effects only if the excess with the law is less than this share of the excess with
# the named effects.
LEAST_BETTER: Final = 0.5
# A law is kept if it removes more than this share of the excess chi2 (chi2 beyond noise) of at least one kind
# of residual on control or held-out data.
LEAST_CLOSED: Final = 0.3
# No law is searched if the unexplained residuals have one of these patterns, because a missing law does not
# cause them. "between_sessions" means that the biases changed between sessions. "contradiction" means that
# the stand contradicts the sensors, or that the recordings contradict the model. The other two patterns are
# faults of the data.
NO_LAW: Final = ("between_sessions", "contradiction", "clock_irregular", "noise_grows_in_motion")
# Maximum number of values in one linearisation. Each formula counts as 18 values for each sample: 3 axes
# times 6 parameters (two for each axis). The maximum number of values takes 400 MB of memory.
MOST_VALUES: Final = 5e7
# Number of points of the curve of a law, large enough for corners of the curve to be visible.
POINTS: Final = 201


def with_laws(question: Question, first: Gap) -> Gap:
    """Search for laws in the residuals that effects do not explain. Returns `first` if no law is found."""
    remainder = first.remainder
    if (
        remainder is None
        or remainder.pattern in NO_LAW
        or first.verdict not in ("unknown", "named", "ambiguous", "stochastic")
        or first.calibration is None
        or question.options.exclude_saturated
    ):
        return first
    names = [str(effect["name"]) for effect in first.effects if effect["parameters"]]
    is_contradicted = remainder.p_value < CONTRADICTED
    # The named effects may only approximate the true law. Laws are therefore also searched without the named
    # effects.
    trials = [names, []] if names and is_contradicted else [names]
    if remainder.kind == "nothing" and not (names and is_contradicted):
        return first
    question.stage("searching for laws")
    best = first
    for kept in trials:
        try:
            found = _found(question, first, kept)
        except ImucalError:
            # If the linearisation or the fit with a law fails, this trial has no result.
            continue
        if found is not None and (kept or not names or _excess(found) < LEAST_BETTER * _excess(best)):
            best = found
    return best


def _found(question: Question, first: Gap, names: Sequence[str]) -> Gap | None:
    """The result with laws in addition to the named effects; None if no law is confirmed."""
    calibration = first.fits["after"].calibration if names else first.fits["before"].calibration
    recordings = [calibration.apply_recording(recording) for recording in question.recordings]
    # A smooth function of any slow variable resembles a random walk. Therefore, if the unexplained residuals
    # are a random walk, only auxiliary columns and stand angles are tried as variables.
    is_random = first.remainder is not None and first.remainder.kind == "stochastic"
    forms = further_forms(recordings) if is_random else library(recordings)
    selected = _selected(question, recordings, names, forms, first)
    fitted = _fitted(question, selected, recordings, names) if selected else None
    return None if fitted is None else _merged(first, *fitted, recordings)


def _excess(gap: Gap) -> float:
    """Excess over noise of the figure of merit on unseen data (control recordings or held-out data)."""
    return 0.0 if gap.gap is None else float(gap.gap["after"] - gap.gap["floor"])


def _selected(
    question: Question,
    recordings: Sequence[Recording],
    names: Sequence[str],
    forms: Sequence[Form],
    first: Gap,
) -> list[Selected]:
    if not forms:
        return []
    named = {str(effect["name"]): _count(effect) for effect in first.effects if effect["name"] in names}
    selected = select(columns_of(question, recordings, named, forms, is_hand_moved=first.is_hand_moved))
    if all(own.form.constant is None for own in selected):
        return selected
    variants = [refined(own.form) or [own.form] for own in selected]
    flat = [form for own in variants for form in own]
    given = columns_of(question, recordings, named, flat, is_hand_moved=first.is_hand_moved)
    known = {form: place for place, (form, _) in enumerate(given.candidates)}
    places = [[known[form] for form in own if form in known] for own in variants]
    if not all(places):
        return selected
    picks = settled(given, places)
    return [replace(own, form=given.candidates[pick][0]) for own, pick in zip(selected, picks, strict=True)]


def _count(effect: Mapping[str, Any]) -> int:
    """Number of parameters of an effect, not counting its time constant."""
    row = catalogue_by_name().get(effect["name"])
    return len(effect["parameters"]) - (row is not None and row.shape is not None)


def columns_of(
    question: Question,
    recordings: Sequence[Recording],
    named: Mapping[str, int],
    forms: Sequence[Form],
    *,
    is_hand_moved: bool,
) -> Columns:
    """Residuals of corrected recordings, divided by their noise, and the derivatives of these residuals.

    The derivatives are those with respect to the coefficients of the named effects and of the forms.

    named  number of parameters of each named effect, not counting its time constant
    """
    states = [_state(recording) for recording in recordings]
    own = [effect for effect in question.definitions.values() if effect.name in named]
    catalogue = [(name, count) for name, count in named.items() if name not in question.definitions]
    columns_of_all = set.intersection(*(set(recording.auxiliary) for recording in recordings))
    size = sum(len(recording) for recording in recordings) * 18
    step = max(1, int(MOST_VALUES / size))
    residual = model = groups = items = None
    candidates: list[tuple[Form, FloatArray]] = []
    for start in range(0, len(forms), step):
        part, fields = [], []
        for place, form in enumerate(forms[start : start + step]):
            field = _field(form, f"law_{start + place}", columns_of_all, states)
            if field is not None:
                part.append(form)
                fields.append(field)
        fields += [_of_effect(effect, states) for effect in own]
        options = replace(question.options, hold=(), model="full", folds=None, user_fields=tuple(fields))
        design = _core.gap_design(recordings, options, catalogue, is_hand_moved)
        columns = dict(design.effects)
        of_named = [values for name, values in design.effects if not name.startswith("law_")]
        if residual is None:
            residual, groups, items = design.residual, design.groups, design.items
            model = np.hstack([design.base, *of_named])
        for form, field in zip(part, fields, strict=False):
            if field.name in columns:
                candidates.append((form, columns[field.name]))
    if residual is None or model is None or groups is None or items is None:
        raise InputError("the search has no candidate formulas of a law")
    return Columns(residual, model, groups, items, candidates)


def _state(recording: Recording) -> State:
    force, rate = samples_of_both(recording)
    return State.of(recording, np.asarray(rate, float), np.asarray(force, float))


def _field(form: Form, name: str, columns: Collection[str], states: Sequence[State]) -> UserField | None:
    """The form evaluated at each sample of the recordings; None if it is constant or not finite."""
    try:
        effect = FormulaEffect.of(form.text(name), columns=columns)
        fields = tuple(effect.columns(state) for state in states)
        return UserField(name, effect.sensor, tuple(sizes_of(effect, fields)), fields)
    except InputError:
        return None


def _of_effect(effect: UserEffect, states: Sequence[State]) -> UserField:
    typical = tuple(parameter.typical for parameter in effect.parameters)
    columns = tuple(np.ascontiguousarray(effect.columns(state)) for state in states)
    return UserField(effect.name, effect.sensor, typical, columns)


def _fitted(
    question: Question, selected: Sequence[Selected], recordings: Sequence[Recording], names: Sequence[str]
) -> tuple[Gap, Mapping[str, Selected], dict[str, FormulaEffect]] | None:
    """The result with the named effects and the confirmed laws; None if unseen data confirm no law."""
    by_name = {_name(own.form, place, selected): own for place, own in enumerate(selected)}
    while by_name:
        laws = formula_effects([own.form.text(name) for name, own in by_name.items()], recordings)
        definitions = {name: own for name, own in question.definitions.items() if name in names}
        definitions.update({law.name: law for law in laws})
        catalogue = [name for name in names if name not in question.definitions]
        again = replace(question, candidates=catalogue, definitions=definitions)
        found = again.answer()
        second = gap_of(again, found)
        accepted = {str(effect["name"]): effect for effect in second.effects if effect["parameters"]}
        if second.verdict not in ("named", "ambiguous") or not set(names) <= set(accepted):
            return None
        kept = {n: own for n, own in by_name.items() if n in accepted and _closes(accepted[n]["closed"])}
        if kept == by_name:
            return second, by_name, {law.name: law for law in laws}
        by_name = kept
    return None


def _name(form: Form, place: int, selected: Sequence[Selected]) -> str:
    name = f"{form.sensor}_law_{'_'.join(variable.strip('_') for variable in form.variables)}"
    before = [other for other in selected[:place] if other.form.group == form.group]
    return f"{name}_{len(before) + 1}" if before else name


def _closes(closed: Mapping[str, float | None]) -> bool:
    return max((share for share in closed.values() if share is not None), default=0.0) > LEAST_CLOSED


def _merged(
    first: Gap,
    second: Gap,
    by_name: Mapping[str, Selected],
    laws: Mapping[str, FormulaEffect],
    recordings: Sequence[Recording],
) -> Gap:
    """The result `first` of the search for effects, with the laws and with the fit that includes the laws."""
    nearest = tuple(str(score["name"]) for score in first.ranking[:3] if score["log_bayes_factor"] > 0)
    found = [
        Law(
            str(effect["name"]),
            laws[effect["name"]].text,
            str(effect["sensor"]),
            by_name[effect["name"]].form.variables,
            tuple(effect["parameters"]),
            by_name[effect["name"]].nats,
            by_name[effect["name"]].stable,
            effect["closed"],
            nearest,
            _curve(by_name[effect["name"]].form, laws[effect["name"]], effect["parameters"], recordings),
        )
        for effect in second.effects
        if effect["name"] in laws
    ]
    left = second.remainder
    effects = tuple(effect for effect in second.effects if effect["name"] not in laws)
    return replace(
        second,
        verdict=first.verdict if first.verdict in ("named", "ambiguous") and effects else "unknown",
        effects=effects,
        laws=tuple(found),
        ambiguous_with=first.ambiguous_with if effects else (),
        next_motion=first.next_motion if effects else None,
        generic=first.generic if left is not None and left.kind != "nothing" else None,
        not_observable=first.not_observable,
        smallest_visible=first.smallest_visible,
        traces=first.traces,
        ranking=first.ranking,
        user_effects=(*first.user_effects, *laws.values()),
    )


def _curve(
    form: Form, law: FormulaEffect, parameters: Sequence[Mapping[str, float]], recordings: Sequence[Recording]
) -> Curve | None:
    """The curve of a law over the recorded range of its variable; None for a law of several variables."""
    variable = form.driver
    if len(form.variables) > 1:
        return None
    seen = np.concatenate([_values_of(variable, _state(recording)) for recording in recordings])
    low, high = (float(value) for value in np.quantile(seen, [0.001, 0.999]))
    at = np.linspace(low, high, POINTS)
    columns = law.columns(_sweep(variable, at))
    columns = columns - columns.mean(axis=0)
    values = columns @ np.array([p["value"] for p in parameters])
    spread = np.sqrt(columns**2 @ np.array([(p["std"] or 0.0) ** 2 for p in parameters]))
    axes = {axis: k for k, axis in enumerate("xyz")}
    return Curve(
        variable,
        tuple(at.tolist()),
        {axis: tuple(values[:, k].tolist()) for axis, k in axes.items()},
        {axis: tuple(spread[:, k].tolist()) for axis, k in axes.items()},
    )


def _values_of(variable: str, state: State) -> FloatArray:
    """The values of a variable in a recording, for all axes."""
    of_axis = FormulaEffect.of(f"gyro: k*{variable}", columns=state.auxiliary.keys())
    columns = of_axis.columns(state)
    values: FloatArray = np.concatenate([columns[:, axis, axis] for axis in range(3)])
    return values


def _sweep(variable: str, at: FloatArray) -> State:
    """Input of a formula, with one sample per element of `at`. `variable` has the values of `at`.

    All other quantities are zero, unknown or arbitrary.
    """
    count = len(at)
    alike = np.repeat(at[:, None], 3, axis=1)
    still = np.zeros((count, 3))
    rate = alike if variable == "w" else still
    if variable == "w_norm":
        rate = np.column_stack([at, still[:, :2]])
    time_s = np.arange(count, dtype=float)
    if variable == "time_s":
        time_s = at
    return State(
        rate,
        alike if variable == "f" else still,
        time_s,
        temperature_degc=at if variable == "temp_degc" else None,
        auxiliary={} if variable in ("w", "f", "w_norm", "time_s", "rest_s", "temp_degc") else {variable: at},
        stand_rad=alike if variable.startswith("stand_") else None,
        rest_s=at if variable == "rest_s" else None,
    )
