"""Parsing of the values of effects in arguments, on the command line and in files.

Forms of an argument:

{"gyro_g_sensitivity": 1e-4}                                   all parameters equal
{"gyro_bias_drift": [1e-6, 0, 0]}                              one value per parameter, in catalogue order
{"gyro_bias_warmup": {"values": [1e-3, 0, 0], "shape": 100.0}}
{"gyro_bias_warmup": "typical"}                                the typical size in MEMS sensors
{"gyro: k * w * abs(f_z)": [1e-4, 0, 0]}                       a formula, one value per parameter
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imucal.document.agreement import require_fields
from imucal.document.json_document import Node
from imucal.effects.definition import UserEffect, by_name, check_values
from imucal.effects.disturbance import Disturbance, disturbances
from imucal.effects.effect import Effect, EffectValues
from imucal.effects.formula import is_formula
from imucal.effects.table import catalogue, find, not_known
from imucal.errors import FormatError, InputError

__all__ = ["EffectInput", "effects_of", "effects_to_list", "give_effects", "parse_effects"]

# Largest accepted value of an effect in a file, as a multiple of its typical size.
LARGEST_SIZE = 1e6

EffectInput: TypeAlias = ArrayLike | Mapping[str, Any] | EffectValues
Definition: TypeAlias = Effect | UserEffect | Disturbance


def give_effects(
    effects: Mapping[str, EffectInput] | Iterable[EffectValues], user_effects: Sequence[UserEffect] = ()
) -> tuple[EffectValues, ...]:
    """Convert an argument with effects, noise and faults, in a form listed in this module, to their values.

    Raises InputError for an unknown name and for values that do not match the definition of the effect.
    """
    known = _definitions(user_effects)
    if isinstance(effects, Mapping):
        return tuple(_give(name, value, known) for name, value in effects.items())
    return tuple(_give(effect.name, effect, known) for effect in effects)


def parse_effects(texts: Iterable[str]) -> dict[str, EffectInput]:
    """Parse `--effect` options NAME=V[,V...][@SHAPE] or NAME=typical; NAME is an effect or a formula."""
    effects: dict[str, EffectInput] = {}
    for text in texts:
        name, given = _parse(text)
        if name in effects:
            raise InputError(f"--effect {name} is given twice: give it once, with all its numbers")
        effects[name] = given
    return effects


def _parse(text: str) -> tuple[str, EffectInput]:
    # A formula may contain equals signs, after its name and in comparisons. The values therefore follow the
    # last equals sign.
    name, equals, numbers = text.rpartition("=") if is_formula(text) else text.partition("=")
    way_out = "give NAME=VALUE, NAME=V,V,V, NAME=V,V,V@SHAPE or NAME=typical"
    if not equals or not name.strip() or not numbers.strip():
        raise InputError(f"--effect {text!r} has no name and numbers: {way_out}")
    if numbers.strip() == "typical":
        return name.strip(), "typical"
    values, at, shape = numbers.partition("@")
    try:
        given: dict[str, Any] = {"values": [float(value) for value in values.split(",")]}
        if at:
            given["shape"] = float(shape)
    except ValueError as error:
        raise InputError(f"--effect {text!r}: {error}: {way_out}") from None
    if len(given["values"]) == 1:
        given["values"] = given["values"][0]
    return name.strip(), given


def effects_to_list(effects: Iterable[EffectValues]) -> list[dict[str, Any]]:
    """Convert values of effects to JSON objects, one for each effect, as files store them."""
    return [{"name": effect.name, "values": effect.values, "shape": effect.shape} for effect in effects]


def effects_of(node: Node, user_effects: Sequence[UserEffect] = ()) -> tuple[EffectValues, ...]:
    """Read the effects, from the catalogue or user-defined, from the list `node` of a file.

    Raises FormatError with the name of an invalid effect.
    """
    own = by_name(user_effects)
    effects: list[EffectValues] = []
    for item in node.items():
        values, shape = item.get("values"), item.mapping().get("shape")
        numbers = values.array(len(values.items()))
        name = item.get("name").text()
        fields = ("name", "values", "shape", *(("formula", "columns") if name in own else ()))
        require_fields(item, fields, "an effect")
        if name in [other.name for other in effects]:
            raise FormatError(f"{item.file}: {item.path}.name is {name}, which occurs twice: give it once")
        try:
            effect = EffectValues(name, numbers, None if shape is None else item.get("shape").number())
            definition = own.get(name) or find(name)
            check_values(definition, effect)
        except InputError as error:
            raise FormatError(f"{item.file}: {item.path}: {error}") from None
        for k, (value, parameter) in enumerate(zip(numbers.tolist(), definition.parameters, strict=False)):
            if abs(value) > LARGEST_SIZE * parameter.typical:
                raise FormatError(
                    f"{item.file}: {item.path}.values[{k}] is {value} {parameter.unit}, but its typical size "
                    f"is {parameter.typical}: correct it"
                )
        effects.append(effect)
    return tuple(effects)


def _definitions(user_effects: Sequence[UserEffect]) -> dict[str, Definition]:
    """All definitions by name: effects of the catalogue, noise, faults, and user-defined effects."""
    known: dict[str, Definition] = {row.name: row for row in catalogue()}
    known.update((row.name, row) for row in disturbances())
    return known | by_name(user_effects)


def _give(name: str, given: EffectInput, known: Mapping[str, Definition]) -> EffectValues:
    if name not in known:
        raise not_known(name, known)
    definition = known[name]
    # A disturbance, unlike an effect, has only one form (number of parameters) and no shape parameter.
    plain = len(definition.parameters) if isinstance(definition, Disturbance) else definition.plain
    needed = None if isinstance(definition, Disturbance) else definition.shape
    shape: Any = None
    values: Any = given
    if isinstance(given, EffectValues):
        values, shape = given.values, given.shape
    elif isinstance(given, Mapping):
        unknown = sorted(given.keys() - {"values", "shape"})
        if unknown or "values" not in given:
            raise InputError(f"{name} is given as {dict(given)}: give values, and shape where it has one")
        values, shape = given["values"], given.get("shape")
    if isinstance(values, str):
        if values != "typical":
            raise InputError(f"{name} is given as {values!r}: give numbers, or typical")
        values = [parameter.typical for parameter in definition.parameters[:plain]]
    if np.ndim(values) == 0:
        values = np.full(plain, values)
    if shape is None and needed is not None:
        shape = needed.typical
    found = EffectValues(name, values, None if shape is None else float(shape))
    if isinstance(definition, Disturbance):
        if len(found.values) != plain or shape is not None:
            raise InputError(
                f"{name} has {plain} numbers and no shape: {len(found.values)} numbers"
                + (f" and the shape {shape}" if shape is not None else "")
                + f" were given: give {', '.join(p.name for p in definition.parameters)}"
            )
    else:
        check_values(definition, found)
    return found
