"""The limits file, schema imucal.limits/1.

Unknown names are refused, because a limit on them would test nothing.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from imucal.calibration.plausibility import BIAS, SENSITIVITY
from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES
from imucal.calibration.verdict import Verdict, verdict_of
from imucal.document.json_document import Node
from imucal.effects.definition import UserEffect, definitions
from imucal.effects.table import has_parameter
from imucal.errors import FormatError, InputError
from imucal.limits.limit import COUNTS, FIGURES, FigureLimit, ParameterLimit

__all__ = ["NO_LIMIT", "REQUIRED", "document_of", "fields_of"]

SCHEMA: Final = "imucal.limits/1"
FIELDS: Final = ("schema", "description", "parameters", *FIGURES, "effects", "verdict")
# Verdicts that limits can require.
REQUIRED: Final[tuple[Verdict, ...]] = ("good", "incomplete")
NO_LIMIT: Final = "there is no limit, so every unit would pass: give at least one limit"
# A limits file with a larger limit than these is refused.
LARGEST_LIMITS: Final = {
    # Residuals of 1000 times their noise.
    "chi2_per_dof": 1e6,
    # A residual as large as gravity.
    "gravity_norm_rms_mps2": 9.9,
    # Half a revolution.
    "gravity_direction_rms_deg": 180.0,
    # A rest or a move in each second of a day.
    "rests": 86_400,
    "moves": 86_400,
}
RAW_UNITS: Final = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
PARAMETER_FIELDS: Final = ("unit", "min", "max", "max_std")


def document_of(
    parameters: Sequence[ParameterLimit],
    figures: Sequence[FigureLimit],
    effects: Sequence[str] | None,
    verdict: Verdict | None,
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
    if verdict is not None:
        document["verdict"] = verdict
    return document


def fields_of(node: Node, user_effects: Sequence[UserEffect]) -> dict[str, Any]:
    """Read the fields of Limits from a document, by name. Raises FormatError that names an invalid field."""
    node.require_schema(SCHEMA)
    _require_known(node, FIELDS)
    given = node.mapping()
    # An InputError about numbers that contradict each other is converted to a FormatError, because the
    # numbers come from a file.
    try:
        fields: dict[str, Any] = {
            "parameters": _parameters(node.get("parameters"), user_effects) if "parameters" in given else (),
            "figures": tuple(limit for of in FIGURES if of in given for limit in _figures(node.get(of), of)),
            "effects": _effects(node.get("effects"), user_effects) if "effects" in given else None,
            "verdict": verdict_of(node.get("verdict").text(REQUIRED)) if "verdict" in given else None,
            "description": node.get("description").text() if "description" in given else "",
        }
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None
    _require_passable(node, fields["parameters"], fields["effects"], _known_units(user_effects))
    if not any(fields[name] for name in ("parameters", "figures", "verdict")) and fields["effects"] is None:
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
        try:
            limit = ParameterLimit(name, item.get("unit").text(), *numbers)
        except InputError as error:
            raise FormatError(f"{node.file}: {item.path}: {error}") from None
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


def _require_passable(
    node: Node,
    limits: Sequence[ParameterLimit],
    effects: Sequence[str] | None,
    known: Mapping[str, tuple[str, ...]],
) -> None:
    """Raise FormatError for limits that no unit can pass."""
    ranges = [limit for limit in limits if limit.low is not None and limit.high is not None]
    for number, limit in enumerate(ranges):
        path = f"$.parameters.{limit.name}"
        for parameter in filter(limit.covers, known):
            low, high = _possible(parameter, limit.unit)
            for side, value in (("min", limit.low), ("max", limit.high)):
                if not low <= value <= high:  # type: ignore[operator]
                    raise FormatError(
                        f"{node.file}: {path}.{side} is {value}, but {parameter} of a sensor is {low:.4g} to "
                        f"{high:.4g} {limit.unit}: correct the number or $.parameters.{limit.name}.unit"
                    )
            for other in ranges[:number]:
                if other.covers(parameter) and other.unit == limit.unit and _are_apart(limit, other):
                    raise FormatError(
                        f"{node.file}: {path} is {limit.low} to {limit.high}, but $.parameters.{other.name} "
                        f"is {other.low} to {other.high}: no value of {parameter} is in both ranges: correct "
                        "one of the ranges"
                    )
    for limit in limits if effects is not None else ():
        of = [name for name in known if limit.covers(name)]
        if not any(_is_permitted(name, effects or ()) for name in of):
            raise FormatError(
                f"{node.file}: $.parameters.{limit.name} has a limit, but $.effects does not permit its "
                "effect, so every unit would fail: add the effect, or leave the limit out"
            )


def _is_permitted(parameter: str, effects: Sequence[str]) -> bool:
    """Whether a calibration whose only effects are `effects` can have the parameter."""
    is_of_triad = re.fullmatch("(accel|gyro)_(bias_[xyz]|sensitivity_[xyz]{2})", parameter) is not None
    return is_of_triad or any(has_parameter(effect, parameter) for effect in effects)


def _possible(parameter: str, unit: str) -> tuple[float, float]:
    """The range of possible values of a bias or sensitivity; unlimited for a parameter of an effect."""
    sensor = "accelerometer" if parameter.startswith("accel") else "gyroscope"
    if re.fullmatch("(accel|gyro)_bias_[xyz]", parameter):
        return -BIAS[unit], BIAS[unit]
    if re.fullmatch("(accel|gyro)_sensitivity_[xyz]{2}", parameter):
        most = SENSITIVITY[sensor, RAW_UNITS[sensor] if unit == "1" else "lsb"][1]
        return -most, most
    return -math.inf, math.inf


def _are_apart(one: ParameterLimit, other: ParameterLimit) -> bool:
    if one.low is None or one.high is None or other.low is None or other.high is None:
        return False
    return one.low > other.high or other.low > one.high


def _figures(node: Node, of: str) -> list[FigureLimit]:
    _require_known(node, FIGURES[of])
    limits = []
    for figure in node.mapping():
        item = node.get(figure)
        side = _side(figure)
        _require_known(item, (side,))
        number = item.get(side).number()
        if number > LARGEST_LIMITS[figure]:
            raise FormatError(
                f"{node.file}: {item.path}.{side} is {number}: a limit is at most {LARGEST_LIMITS[figure]:g}"
            )
        try:
            limits.append(FigureLimit(of, figure, number))
        except InputError as error:
            raise FormatError(f"{node.file}: {item.path}.{side}: {error}") from None
    return limits


def _effects(node: Node, user_effects: Sequence[UserEffect]) -> tuple[str, ...]:
    known = definitions(user_effects)
    names = tuple(item.text() for item in node.items())
    for k, name in enumerate(names):
        if name in names[:k]:
            raise FormatError(f"{node.file}: {node.path}[{k}] is {name}, which occurs twice: give it once")
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
    """Raise FormatError for an unknown field, because a limit with a misspelt name would test nothing."""
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
