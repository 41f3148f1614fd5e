"""The file of a calibration, schema imucal.calibration/1.

Every number is written in full, so reading gives the same bits. A user-defined effect is stored with names,
units and values. Its field is code, which the user passes again on reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, get_args

import numpy as np

import imucal._core as _core
from imucal.calibration.model import SensorModel
from imucal.calibration.provenance import Provenance
from imucal.calibration.triad import FRAMES, Parameter, Triad, as_frame
from imucal.document.json_document import Node
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.effects.definition import UserEffect
from imucal.effects.effect import Effect, EffectParameter, EffectValues
from imucal.effects.table import catalogue
from imucal.errors import FormatError
from imucal.recording.recording import AccelUnit, GyroUnit

__all__ = ["document_of", "fields_of", "require_same_parameters"]

SCHEMA: Final = "imucal.calibration/1"
MODEL: Final = (
    "measured = T (true + effects(true)) + bias; corrected = T^-1 (measured - bias) - effects(corrected)"
)
BODY_FRAME: Final[dict[str, str]] = {
    "symmetric": "right-handed orthogonal frame closest to the accelerometer's three axes: its T is "
    "symmetric positive definite; a still sensor reads +g on the axis that points up",
    "triangular": "right-handed orthogonal frame with x along the accelerometer's x axis and y in its x-y "
    "plane: its T is lower triangular; a still sensor reads +g on the axis that points up",
}
# Fields of a Calibration that the file has under the same name, in the order of the file.
OTHERS: Final = (
    "noise",
    "temperature_range_degc",
    "fit",
    "calibration_set",
    "control_set",
    "provenance",
)


def document_of(
    model: SensorModel, parameters: Sequence[Parameter], others: Mapping[str, Any]
) -> dict[str, Any]:
    """The fields of the file.

    parameters  those of the model, with standard deviations
    others      the fields of a Calibration that are not in its model, by name
    """
    document: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "serial_number": others["serial_number"],
            "model": MODEL,
            "body_frame": BODY_FRAME[model.frame],
            "raw_units": {"accelerometer": model.accel_unit, "gyroscope": model.gyro_unit},
            "gravity_mps2": model.gravity_mps2,
            "accelerometer": {
                "T": model.accelerometer.sensitivity,
                "bias": model.accelerometer.bias,
                "frame": model.frame,
            },
            "gyroscope": {"T": model.gyroscope.sensitivity, "bias": model.gyroscope.bias},
            "reference_temperature_degc": _core.REFERENCE_TEMPERATURE_DEGC,
            "effects": _effects_table(model, parameters),
            "parameters": parameters,
            "covariance": None
            if others["covariance"] is None
            else {"names": others["covariance_names"], "matrix": others["covariance"]},
            **{name: others[name] for name in OTHERS},
        }
    )
    return document


def _effects_table(model: SensorModel, parameters: Sequence[Parameter]) -> list[dict[str, Any]]:
    std = {parameter.name: parameter.std for parameter in parameters}

    def number(values: EffectValues, parameter: EffectParameter, value: float) -> dict[str, Any]:
        full_name = f"{values.name}_{parameter.name}"
        return {"name": parameter.name, "value": value, "std": std[full_name], "unit": parameter.unit}

    table = []
    for values in model.effects:
        effect = model.definition(values)
        entry: dict[str, Any] = {
            "name": effect.name,
            "sensor": effect.sensor,
            "parameters": [
                number(values, parameter, value)
                for parameter, value in zip(effect.parameters, values.values.tolist(), strict=False)
            ],
            "shape": None
            if effect.shape is None or values.shape is None
            else number(values, effect.shape, float(values.shape)),
        }
        if isinstance(effect, UserEffect):
            # Without the user's program the file is the only source of the typical sizes.
            for item, parameter in zip(entry["parameters"], effect.parameters, strict=True):
                item["typical"] = parameter.typical
            entry["user_defined"] = True
        table.append(entry)
    return table


def fields_of(node: Node, user_effects: Mapping[str, UserEffect]) -> dict[str, Any]:
    """The fields of the Calibration in a document, by name.

    Raises FormatError that names a wrong field, and InputError for values that Triad or UserEffect refuses.
    """
    node.require_schema(SCHEMA)
    _require_reference_temperature(node)
    effects = [_effect(item, user_effects) for item in node.get("effects").items()]
    units = node.get("raw_units")
    frame = node.get("accelerometer").get("frame").text(FRAMES)
    covariance = node.get("covariance")
    names: tuple[str, ...] = ()
    if covariance.value is not None:
        names = tuple(item.text() for item in covariance.get("names").items())
    temperature = node.get("temperature_range_degc")
    return {
        "accelerometer": _triad(node.get("accelerometer")),
        "gyroscope": _triad(node.get("gyroscope")),
        "frame": as_frame(frame),
        "accel_unit": units.get("accelerometer").text(get_args(AccelUnit)),
        "gyro_unit": units.get("gyroscope").text(get_args(GyroUnit)),
        "gravity_mps2": node.get("gravity_mps2").number(),
        "effects": tuple(values for values, _ in effects),
        "user_effects": tuple(effect for _, effect in effects if isinstance(effect, UserEffect)),
        "covariance": covariance.get("matrix").array(len(names), len(names)) if names else None,
        "covariance_names": names,
        "noise": {name: node.get("noise").get(name).number() for name in node.get("noise").mapping()},
        "temperature_range_degc": None if temperature.value is None else _pair(temperature),
        "fit": node.get("fit").mapping(),
        "calibration_set": _figures(node.get("calibration_set")),
        "control_set": _figures(node.get("control_set")),
        "provenance": _provenance(node.get("provenance")),
        "serial_number": None
        if node.get("serial_number").value is None
        else node.get("serial_number").text(),
    }


def require_same_parameters(node: Node, parameters: Sequence[Parameter]) -> None:
    """Raise FormatError if the table of parameters differs from the matrices that it repeats for readers."""
    items = node.items()
    if len(items) != len(parameters):
        raise FormatError(f"{node.file}: {node.path} has {len(items)} items, {len(parameters)} are needed")
    for item, parameter in zip(items, parameters, strict=True):
        if item.get("name").text() != parameter.name:
            raise FormatError(f"{node.file}: {item.path}.name must be {parameter.name}")
        if item.get("value").number() != parameter.value:
            raise FormatError(
                f"{node.file}: {item.path}.value ({parameter.name}) is {item.get('value').number()} but the "
                f"matrix or bias has {parameter.value}: correct one of them"
            )


def _require_reference_temperature(node: Node) -> None:
    """Raise FormatError if the reference temperature of the file is not the one of this library.

    A file without a reference temperature is accepted.
    """
    if "reference_temperature_degc" in node.mapping():
        reference = node.get("reference_temperature_degc")
        if reference.number() != _core.REFERENCE_TEMPERATURE_DEGC:
            raise FormatError(
                f"{node.file}: {reference.path} is {reference.value}: this version of imucal counts "
                f"temperature from {_core.REFERENCE_TEMPERATURE_DEGC} degC"
            )


def _effect(node: Node, user_effects: Mapping[str, UserEffect]) -> tuple[EffectValues, Effect | UserEffect]:
    """An effect with its numbers, and its definition."""
    name = node.get("name").text()
    known = {effect.name: effect for effect in catalogue()}
    effect: Effect | UserEffect
    if node.mapping().get("user_defined") is True:
        effect = user_effects.get(name) or _stored_definition(node)
    elif name in known:
        effect = known[name]
    else:
        raise FormatError(
            f"{node.file}: {node.path} is not known to this version of imucal ({name}): install a newer one"
        )
    node.get("sensor").text((effect.sensor,))
    items = node.get("parameters").items()
    counts = sorted({effect.plain, len(effect.parameters)})
    if len(items) not in counts:
        raise FormatError(
            f"{node.file}: {node.path}.parameters has {len(items)} items, "
            f"{' or '.join(map(str, counts))} are needed"
        )
    numbers = np.array([_number(item, p) for item, p in zip(items, effect.parameters, strict=False)])
    shape = node.get("shape")
    if effect.shape is None and shape.value is not None:
        raise FormatError(f"{node.file}: {shape.path} must be null: {name} has none")
    return EffectValues(name, numbers, _number(shape, effect.shape) if effect.shape else None), effect


def _number(node: Node, parameter: EffectParameter) -> float:
    node.get("name").text((parameter.name,))
    node.get("unit").text((parameter.unit,))
    return node.get("value").number()


def _stored_definition(node: Node) -> UserEffect:
    """What a file knows of a user's effect."""
    return UserEffect(
        node.get("name").text(),
        node.get("sensor").text(),
        tuple(
            EffectParameter(item.get("name").text(), item.get("unit").text(), item.get("typical").number())
            for item in node.get("parameters").items()
        ),
        None,
    )


def _triad(node: Node) -> Triad:
    return Triad(node.get("T").array(3, 3), node.get("bias").array(3))


def _pair(node: Node) -> tuple[float, float]:
    low, high = node.array(2).tolist()
    return low, high


def _figures(node: Node) -> dict[str, Any] | None:
    return None if node.value is None else node.mapping()


def _provenance(node: Node) -> Provenance:
    def sources(field: str) -> tuple[Source, ...]:
        return tuple(
            Source(item.get("path").text(), item.get("sha256").text()) for item in node.get(field).items()
        )

    return Provenance(
        sources("files"),
        sources("control_files"),
        node.get("imucal_version").text(),
        node.get("date").text(),
        # Older files have none.
        node.get("operator").text() if "operator" in node.mapping() else "",
    )
