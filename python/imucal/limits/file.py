"""The limits file, schema imucal.limits/1. Unknown names are refused: such a limit would test nothing."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES
from imucal.document.json_document import Node
from imucal.effects.definition import UserEffect, definitions
from imucal.errors import FormatError, InputError
from imucal.limits.limit import COUNTS, FIGURES, FigureLimit, ParameterLimit

__all__ = ["NO_LIMIT", "document_of", "fields_of"]

SCHEMA: Final = "imucal.limits/1"
FIELDS: Final = ("schema", "description", "parameters", *FIGURES, "effects")
NO_LIMIT: Final = "there is no limit, so every unit would pass: give at least one"
PARAMETER_FIELDS: Final = ("unit", "min", "max", "max_std")


def document_of(
    parameters: Sequence[ParameterLimit],
    figures: Sequence[FigureLimit],
    effects: Sequence[str] | None,
    description: str,
) -> dict[str, Any]:
    """The fields of the file; a quantity without a limit has no field."""
    document: dict[str, Any] = {"schema": SCHEMA, "description": description}
    if parameters:
        document["parameters"] = {
            limit.name: {
                field: value
                for field, value in zip(
                    PARAMETER_FIELDS, (limit.unit, limit.low, limit.high, limit.max_std), strict=True
                )
                if value is not None
            }
            for limit in parameters
        }
    for limit in figures:
        number = int(limit.limit) if limit.figure in COUNTS else limit.limit
        document.setdefault(limit.of, {})[limit.figure] = {_side(limit.figure): number}
    if effects is not None:
        document["effects"] = list(effects)
    return document


def fields_of(node: Node, user_effects: Sequence[UserEffect]) -> dict[str, Any]:
    """The fields of Limits in a document, by name; FormatError names an invalid field."""
    node.require_schema(SCHEMA)
    _require_known(node, FIELDS)
    given = node.mapping()
    # Contradicting numbers in a file are an error of the file, not of an argument.
    try:
        fields = {
            "parameters": _parameters(node.get("parameters"), user_effects) if "parameters" in given else (),
            "figures": tuple(limit for of in FIGURES if of in given for limit in _figures(node.get(of), of)),
            "effects": _effects(node.get("effects"), user_effects) if "effects" in given else None,
            "description": node.get("description").text() if "description" in given else "",
        }
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None
    if not fields["parameters"] and not fields["figures"] and fields["effects"] is None:
        raise FormatError(f"{node.file}: {NO_LIMIT}")
    return fields


def _parameters(node: Node, user_effects: Sequence[UserEffect]) -> tuple[ParameterLimit, ...]:
    _require_some(node)
    known = _known_units(user_effects)
    limits = []
    for name in node.mapping():
        item = node.get(name)
        _require_known(item, PARAMETER_FIELDS)
        numbers = [
            item.get(field).number() if field in item.mapping() else None for field in PARAMETER_FIELDS[1:]
        ]
        limit = ParameterLimit(name, item.get("unit").text(), *numbers)
        covered = [parameter for parameter in known if limit.covers(parameter)]
        if not covered:
            groups = {f"{parameter.rpartition('_')[0]}_*" for parameter in known}
            raise FormatError(
                f"{node.file}: {item.path}: no parameter has this name{_close(name, [*known, *groups])}"
            )
        for parameter in covered:
            if limit.unit not in known[parameter]:
                raise FormatError(
                    f"{node.file}: {item.path}.unit is {limit.unit!r}: {parameter} is in "
                    f"{' or '.join(known[parameter])}"
                )
        limits.append(limit)
    return tuple(limits)


def _figures(node: Node, of: str) -> list[FigureLimit]:
    _require_known(node, FIGURES[of])
    limits = []
    for figure in node.mapping():
        item = node.get(figure)
        side = _side(figure)
        _require_known(item, (side,))
        limits.append(FigureLimit(of, figure, item.get(side).number()))
    return limits


def _effects(node: Node, user_effects: Sequence[UserEffect]) -> tuple[str, ...]:
    known = definitions(user_effects)
    names = tuple(item.text() for item in node.items())
    for name in names:
        if name not in known:
            raise FormatError(f"{node.file}: {node.path}: there is no effect {name!r}{_close(name, known)}")
    return names


def _side(figure: str) -> str:
    return "min" if figure in COUNTS else "max"


def _known_units(user_effects: Sequence[UserEffect]) -> Mapping[str, tuple[str, ...]]:
    """Every parameter that a calibration can have, with its possible units."""
    known: dict[str, tuple[str, ...]] = {}
    accel_entries = dict.fromkeys(entry for frame in ACCEL_ENTRIES.values() for entry in frame)
    for sensor, entries, unit in (
        ("accel", tuple(accel_entries), "m/s^2"),
        ("gyro", GYRO_ENTRIES, "rad/s"),
    ):
        known.update({f"{sensor}_bias_{axis}": (unit, "lsb") for axis in "xyz"})
        known.update({f"{sensor}_sensitivity_{entry}": ("1", f"lsb/({unit})") for entry in entries})
    for effect in definitions(user_effects).values():
        shape = () if effect.shape is None else (effect.shape,)
        known.update({f"{effect.name}_{p.name}": (p.unit,) for p in (*effect.parameters, *shape)})
    return known


def _require_known(node: Node, fields: Sequence[str]) -> None:
    """Raise FormatError for an unknown field: a limit with a misspelt name would test nothing."""
    _require_some(node)
    for name in node.mapping():
        if name not in fields:
            raise FormatError(
                f"{node.file}: {node.path}.{name} is no field of a limits file{_close(name, fields)}; "
                f"{node.path} may have {', '.join(fields)}"
            )


def _require_some(node: Node) -> None:
    if not node.mapping():
        raise FormatError(f"{node.file}: {node.path} is empty: leave it out, or give a limit")


def _close(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), cutoff=0.5)
    return f": is it {' or '.join(close)}?" if close else ""
