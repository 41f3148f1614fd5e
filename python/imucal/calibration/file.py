"""The file of a calibration, schema imucal.calibration/1.

It holds every number in full: reading gives the same bits. A user's own effect is in it with names, units and
numbers; its field is code, and is given again on reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, get_args

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import FRAMES, Calibration, Provenance, Triad, as_frame
from imucal.document.json_document import Node
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.effects.effect import Effect, EffectParameter, EffectValues, UserEffect, by_name, catalogue
from imucal.errors import FormatError, InputError
from imucal.recording.recording import AccelUnit, GyroUnit

__all__ = ["calibration_of", "document_of"]

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


def document_of(calibration: Calibration) -> dict[str, Any]:
    """The fields of the file."""
    document: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "serial_number": calibration.serial_number,
            "model": MODEL,
            "body_frame": BODY_FRAME[calibration.frame],
            "raw_units": {"accelerometer": calibration.accel_unit, "gyroscope": calibration.gyro_unit},
            "gravity_mps2": calibration.gravity_mps2,
            "accelerometer": {
                "T": calibration.accelerometer.sensitivity,
                "bias": calibration.accelerometer.bias,
                "frame": calibration.frame,
            },
            "gyroscope": {"T": calibration.gyroscope.sensitivity, "bias": calibration.gyroscope.bias},
            "reference_temperature_degc": _core.REFERENCE_TEMPERATURE_DEGC,
            "effects": _effects_table(calibration),
            "parameters": calibration.parameters,
            "covariance": None
            if calibration.covariance is None
            else {"names": calibration.covariance_names, "matrix": calibration.covariance},
            "noise": calibration.noise,
            "temperature_range_degc": calibration.temperature_range_degc,
            "fit": calibration.fit,
            "calibration_set": calibration.calibration_set,
            "control_set": calibration.control_set,
            "provenance": calibration.provenance,
        }
    )
    return document


def _effects_table(calibration: Calibration) -> list[dict[str, Any]]:
    std = {parameter.name: parameter.std for parameter in calibration.parameters}

    def number(values: EffectValues, parameter: EffectParameter, value: float) -> dict[str, Any]:
        full_name = f"{values.name}_{parameter.name}"
        return {"name": parameter.name, "value": value, "std": std[full_name], "unit": parameter.unit}

    table = []
    for values in calibration.effects:
        effect = calibration.definition(values)
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
            # The file is the only place from which these can be known without the user's program.
            for item, parameter in zip(entry["parameters"], effect.parameters, strict=True):
                item["typical"] = parameter.typical
            entry["user_defined"] = True
        table.append(entry)
    return table


def calibration_of(node: Node, user_effects: Sequence[UserEffect]) -> Calibration:
    """The calibration of a document; FormatError names the field that is wrong."""
    own = by_name(user_effects)
    # What the fields contradict among themselves is a fault of the file.
    try:
        return _from_node(node, own)
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None


def _from_node(node: Node, user_effects: Mapping[str, UserEffect]) -> Calibration:
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
    calibration = Calibration(
        accelerometer=_triad(node.get("accelerometer")),
        gyroscope=_triad(node.get("gyroscope")),
        frame=as_frame(frame),
        accel_unit="lsb" if units.get("accelerometer").text(get_args(AccelUnit)) == "lsb" else "m/s^2",
        gyro_unit="lsb" if units.get("gyroscope").text(get_args(GyroUnit)) == "lsb" else "rad/s",
        gravity_mps2=node.get("gravity_mps2").number(),
        effects=tuple(values for values, _ in effects),
        user_effects=tuple(effect for _, effect in effects if isinstance(effect, UserEffect)),
        covariance=covariance.get("matrix").array(len(names), len(names)) if names else None,
        covariance_names=names,
        noise={name: node.get("noise").get(name).number() for name in node.get("noise").mapping()},
        temperature_range_degc=None if temperature.value is None else _pair(temperature),
        fit=node.get("fit").mapping(),
        calibration_set=_figures(node.get("calibration_set")),
        control_set=_figures(node.get("control_set")),
        provenance=_provenance(node.get("provenance")),
        serial_number=None if node.get("serial_number").value is None else node.get("serial_number").text(),
    )
    _require_same_parameters(node.get("parameters"), calibration)
    return calibration


def _require_reference_temperature(node: Node) -> None:
    """Files from before there were effects of temperature do not say from where these count."""
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


def _require_same_parameters(node: Node, calibration: Calibration) -> None:
    """The table repeats the matrices for readers; a file in which they differ was edited by halves."""
    items = node.items()
    if len(items) != len(calibration.parameters):
        raise FormatError(
            f"{node.file}: {node.path} has {len(items)} items, {len(calibration.parameters)} are needed"
        )
    for item, parameter in zip(items, calibration.parameters, strict=True):
        if item.get("name").text() != parameter.name:
            raise FormatError(f"{node.file}: {item.path}.name must be {parameter.name}")
        if item.get("value").number() != parameter.value:
            raise FormatError(
                f"{node.file}: {item.path}.value ({parameter.name}) is {item.get('value').number()} but the "
                f"matrix or bias has {parameter.value}: correct one of them"
            )
