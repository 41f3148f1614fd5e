"""The catalogue of effects, as defined in the compiled library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache

import imucal._core as _core
from imucal.effects.effect import Alias, Effect, EffectParameter
from imucal.errors import InputError

__all__ = ["catalogue", "catalogue_by_name", "find", "has_parameter", "not_known"]


def catalogue() -> tuple[Effect, ...]:
    """All effects of the catalogue. Effects with related causes, such as temperature, follow each other."""
    return tuple(catalogue_by_name().values())


@cache
def catalogue_by_name() -> Mapping[str, Effect]:
    """All effects of the catalogue by name."""
    return {
        row.name: Effect(
            row.name,
            row.sensor,
            tuple(EffectParameter(*parameter) for parameter in row.parameters),
            row.plain,
            None if row.shape is None else EffectParameter(*row.shape),
            tuple(row.needs),
            row.formula,
            row.observable,
            tuple(Alias(*alias) for alias in row.aliases),
        )
        for row in _core.effects()
    }


def find(name: str) -> Effect:
    """The effect with this name. If there is none, raises InputError, whose message lists similar names."""
    if name in catalogue_by_name():
        return catalogue_by_name()[name]
    from imucal.effects.disturbance import disturbances

    for row in disturbances():
        if name == row.name:
            what = "noise" if row.kind == "noise" else "a fault"
            raise InputError(
                f"{name} is {what}: it has no parameter, so it can be neither estimated nor removed"
            )
    raise not_known(name, catalogue_by_name())


def has_parameter(effect: str, name: str) -> bool:
    """Whether the parameter with the full name `name` belongs to the effect `effect`.

    For effects of the catalogue, it is not sufficient that the name of the parameter begins with the name of
    the effect, because the name of one effect may begin with the name of another.
    """
    row = catalogue_by_name().get(effect)
    if row is None:
        return name.startswith(f"{effect}_")
    shape = () if row.shape is None else (row.shape,)
    return any(name == f"{effect}_{parameter.name}" for parameter in (*row.parameters, *shape))


def not_known(name: str, known: Iterable[str]) -> InputError:
    """The InputError for an unknown name of an effect; its message lists similar names from `known`."""
    import difflib

    close = difflib.get_close_matches(name, list(known), cutoff=0.5)
    hint = f"is it {' or '.join(close)}? " if close else ""
    return InputError(f"there is no effect {name!r}: {hint}`imucal effects` lists them all")
