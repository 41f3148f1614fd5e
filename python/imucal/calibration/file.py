"""The file of a calibration, schema imucal.calibration/1.

Every number is written with full precision, so reading returns the same bits. For a user-defined effect, the
file contains the names, units and values of its parameters. If a formula defines the effect, the file also
contains the formula. If a Python function defines the effect, the user passes the definition again when
reading the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, cast, get_args

import numpy as np

import imucal._core as _core
from imucal.calibration.consistency import require_covariance, require_written_again
from imucal.calibration.model import SensorModel
from imucal.calibration.plausibility import (
    require_accelerometer,
    require_gravity,
    require_gyroscope,
    require_noise,
    require_temperature_range,
)
from imucal.calibration.provenance import Imported, Provenance
from imucal.calibration.references import References
from imucal.calibration.report import (
    require_date,
    require_figures,
    require_fit,
    require_sha256,
    require_version,
)
from imucal.calibration.triad import FRAMES, Frame, Parameter, Triad, as_frame
from imucal.calibration.verdict import VERDICTS, verdict_of
from imucal.document.json_document import Node
from imucal.document.name import require_name
from imucal.document.plain import plain
from imucal.document.source import Source
from imucal.effects.definition import UserEffect, counts_of
from imucal.effects.effect import Effect, EffectParameter, EffectValues
from imucal.effects.formula_effect import FormulaEffect
from imucal.effects.table import catalogue
from imucal.errors import FormatError, InputError
from imucal.recording.axes import UNCHANGED
from imucal.recording.recording import AccelUnit, GyroUnit

__all__ = ["document_of", "fields_of", "require_consistent"]

SCHEMA: Final = "imucal.calibration/1"
MODEL: Final = (
    "measured = T (true + effects(true)) + bias; corrected = T^-1 (measured - bias) - effects(corrected)"
)
BODY_FRAME: Final[dict[str, str]] = {
    "symmetric": "right-handed orthogonal frame closest to the accelerometer's three axes: its T is "
    "symmetric positive definite; a still sensor reads +g on the axis that points up",
    "triangular": "right-handed orthogonal frame with x along the accelerometer's x axis and y in its x-y "
    "plane: its T is lower triangular; a still sensor reads +g on the axis that points up",
    "given": "frame in which another program, or the second of two composed calibrations, gives corrected "
    "samples; T of the accelerometer has nine free entries",
}
# Fields of a Calibration that have the same name in the file, in the order of the file.
OTHERS: Final = (
    "noise",
    "temperature_range_degc",
    "fit",
    "calibration_set",
    "control_set",
    "verdict",
    "reasons",
    "provenance",
)


def document_of(
    model: SensorModel, parameters: Sequence[Parameter], others: Mapping[str, Any]
) -> dict[str, Any]:
    """The document (a dictionary of plain values) that the calibration file contains.

    parameters  the parameters of the model, with standard deviations
    others      the fields of a Calibration that SensorModel does not have, by name
    """
    document: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "serial_number": others["serial_number"],
            "model": MODEL,
            "body_frame": BODY_FRAME[model.frame],
            "raw_units": {
                "accelerometer": model.accel_unit,
                "gyroscope": None if model.gyroscope is None else model.gyro_unit,
            },
            "axes": model.axes,
            "gravity_mps2": model.gravity_mps2,
            "references": others["references"],
            "accelerometer": {
                "T": model.accelerometer.sensitivity,
                "bias": model.accelerometer.bias,
                "frame": model.frame,
            },
            "gyroscope": None
            if model.gyroscope is None
            else {"T": model.gyroscope.sensitivity, "bias": model.gyroscope.bias},
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
            # The typical sizes of the parameters are stored, because a program that reads the file may not
            # have the definition of the effect.
            for item, parameter in zip(entry["parameters"], effect.parameters, strict=True):
                item["typical"] = parameter.typical
            entry["user_defined"] = True
        if isinstance(effect, FormulaEffect):
            entry["formula"] = effect.text
        table.append(entry)
    return table


def fields_of(node: Node, user_effects: Mapping[str, UserEffect]) -> dict[str, Any]:
    """Read the fields of a Calibration, by name, from its document.

    Raises FormatError that names an invalid field, and InputError for values that Triad or UserEffect
    refuses.
    """
    if isinstance(node.value, dict) and "schema" not in node.value:
        raise FormatError(
            f"{node.file}: the document has no schema, {SCHEMA!r} is needed: imucal import reads "
            "calibrations of other programs"
        )
    node.require_schema(SCHEMA)
    _require_reference_temperature(node)
    effects = [_effect(item, user_effects) for item in node.get("effects").items()]
    names_of_effects = [values.name for values, _ in effects]
    for k, name in enumerate(names_of_effects):
        if name in names_of_effects[:k]:
            raise FormatError(
                f"{node.file}: an effect occurs twice: $.effects[{k}] and "
                f"$.effects[{names_of_effects.index(name)}] "
                f"are {name}: leave one out"
            )
    units = node.get("raw_units")
    frame = as_frame(node.get("accelerometer").get("frame").text(FRAMES))
    accel_unit = units.get("accelerometer").text(get_args(AccelUnit))
    accelerometer = _triad(node.get("accelerometer"))
    gyroscope, gyro_unit = _gyroscope(node.get("gyroscope"), units.get("gyroscope"), frame)
    require_accelerometer(node.get("accelerometer"), accelerometer, frame, accel_unit)
    covariance = node.get("covariance")
    names: tuple[str, ...] = ()
    if covariance.value is not None:
        names = tuple(item.text() for item in covariance.get("names").items())
        # The names in the table of parameters are themselves checked later, by `require_consistent`.
        require_covariance(covariance, [item.get("name").text() for item in node.get("parameters").items()])
    return {
        "accelerometer": accelerometer,
        "gyroscope": gyroscope,
        "frame": frame,
        "accel_unit": accel_unit,
        "gyro_unit": gyro_unit,
        "axes": node.get("axes").text() if "axes" in node.mapping() else UNCHANGED,
        "gravity_mps2": require_gravity(node.get("gravity_mps2")),
        "references": References.of_file(node),
        "effects": tuple(values for values, _ in effects),
        "user_effects": tuple(effect for _, effect in effects if isinstance(effect, UserEffect)),
        "covariance": covariance.get("matrix").array(len(names), len(names)) if names else None,
        "covariance_names": names,
        "noise": require_noise(node.get("noise")),
        "temperature_range_degc": require_temperature_range(node.get("temperature_range_degc")),
        "fit": node.get("fit").mapping(),
        "calibration_set": require_figures(node.get("calibration_set")),
        "control_set": require_figures(node.get("control_set")),
        **_verdict(node),
        "provenance": _provenance(node.get("provenance"), node.get("control_set")),
        "serial_number": None
        if node.get("serial_number").value is None
        else _name(node.get("serial_number")),
    }


def _gyroscope(node: Node, unit: Node, frame: Frame) -> tuple[Triad | None, GyroUnit]:
    """The gyroscope and its raw unit; None and the SI unit if both fields are null (accelerometer alone)."""
    if (node.value is None) != (unit.value is None):
        absent, there = (node, unit) if node.value is None else (unit, node)
        raise FormatError(
            f"{node.file}: {absent.path} is null, but {there.path} is not: an accelerometer alone has null "
            "in both; correct one of them"
        )
    if node.value is None:
        return None, "rad/s"
    gyro_unit, triad = unit.text(get_args(GyroUnit)), _triad(node)
    require_gyroscope(node, triad, frame, gyro_unit)
    return triad, cast(GyroUnit, gyro_unit)


def require_consistent(node: Node, model: SensorModel, written: Mapping[str, Any]) -> None:
    """Raise FormatError if the document contradicts itself.

    model     the calibration that was read
    written   the document that `to_dict` of this calibration returns
    """
    require_written_again(node, written, model.parameters, model.frame)
    effects = {
        effect["name"]: {f"{effect['name']}_{item['name']}": item["value"] for item in effect["parameters"]}
        for effect in written["effects"]
    }
    matrix = written["covariance"]
    names, numbers = ((), None) if matrix is None else (matrix["names"], np.array(matrix["matrix"]))
    require_fit(node.get("fit"), effects, names, numbers)


def _verdict(node: Node) -> dict[str, Any]:
    """The verdict and its reasons. Both may be missing in a file that another program wrote."""
    if not {"verdict", "reasons"} & node.mapping().keys():
        return {"verdict": None, "reasons": ()}
    reasons = tuple(item.text() for item in node.get("reasons").items())
    if node.get("verdict").value is None and not reasons:
        return {"verdict": None, "reasons": ()}
    verdict = node.get("verdict").text(VERDICTS)
    if (verdict == "good") == bool(reasons):
        raise FormatError(
            f"{node.file}: {node.get('verdict').path} is {verdict} with {len(reasons)} reasons: a verdict "
            "other than good needs reasons, and the verdict good has none; correct the verdict or the reasons"
        )
    return {"verdict": verdict_of(verdict), "reasons": reasons}


def _require_reference_temperature(node: Node) -> None:
    """Raise FormatError if the reference temperature in the file differs from that of this library.

    A file without a reference temperature is accepted.
    """
    if "reference_temperature_degc" in node.mapping():
        reference = node.get("reference_temperature_degc")
        if reference.number() != _core.REFERENCE_TEMPERATURE_DEGC:
            raise FormatError(
                f"{node.file}: {reference.path} is {reference.value}: the reference temperature of this "
                f"version of imucal is {_core.REFERENCE_TEMPERATURE_DEGC} degC"
            )


def _effect(node: Node, user_effects: Mapping[str, UserEffect]) -> tuple[EffectValues, Effect | UserEffect]:
    """Read the values of an effect from the file, and find the definition of this effect."""
    name = node.get("name").text()
    known = {effect.name: effect for effect in catalogue()}
    effect: Effect | UserEffect
    if node.mapping().get("user_defined") is True:
        effect = user_effects.get(name) or _stored_definition(node)
    elif name in known:
        effect = known[name]
    else:
        raise FormatError(
            f"{node.file}: {node.path} is not known to this version of imucal ({name}): install a newer "
            "version"
        )
    node.get("sensor").text((effect.sensor,))
    items = node.get("parameters").items()
    if len(items) not in counts_of(effect):
        raise FormatError(
            f"{node.file}: {node.path}.parameters has {len(items)} items, "
            f"{' or '.join(map(str, counts_of(effect)))} are needed"
        )
    numbers = np.array([_number(item, p) for item, p in zip(items, effect.parameters, strict=False)])
    shape = node.get("shape")
    if effect.shape is None and shape.value is not None:
        raise FormatError(f"{node.file}: {shape.path} must be null: {name} has no shape")
    return EffectValues(name, numbers, _number(shape, effect.shape) if effect.shape else None), effect


def _number(node: Node, parameter: EffectParameter) -> float:
    node.get("name").text((parameter.name,))
    node.get("unit").text((parameter.unit,))
    return node.get("value").number()


def _stored_definition(node: Node) -> UserEffect:
    """Read the definition of a user-defined effect from a file.

    If a formula defines the effect, the definition is complete. Otherwise it lacks the Python function.
    """
    name, sensor = node.get("name").text(), node.get("sensor").text()
    parameters = tuple(
        EffectParameter(item.get("name").text(), item.get("unit").text(), item.get("typical").number())
        for item in node.get("parameters").items()
    )
    if "formula" not in node.mapping():
        return UserEffect(name, sensor, parameters, None)
    try:
        effect = FormulaEffect.stored(node.get("formula").text(), name, parameters)
    except InputError as error:
        raise FormatError(f"{node.file}: {node.path}.formula: {error}") from None
    if (effect.sensor, effect.parameters) != (sensor, parameters):
        raise FormatError(
            f"{node.file}: {node.path}.formula is {effect.text!r}, but {node.path} has another sensor "
            "or other parameters: correct one of them"
        )
    return effect


def _triad(node: Node) -> Triad:
    try:
        return Triad(node.get("T").array(3, 3), node.get("bias").array(3))
    except InputError as error:
        raise FormatError(f"{node.file}: {node.path}.T: {error}") from None


def _provenance(node: Node, control_set: Node) -> Provenance:
    files, control_files = _sources(node.get("files")), _sources(node.get("control_files"))
    for k, source in enumerate(control_files):
        for j, other in enumerate(files):
            if source.sha256 == other.sha256:
                raise FormatError(
                    f"{node.file}: {node.path}.control_files[{k}].sha256 is that of {node.path}.files[{j}]: "
                    "a control recording must not be one of the calibration recordings: calibrate again"
                )
    if control_files and control_set.value is None:
        raise FormatError(
            f"{node.file}: {node.path}.control_files has {len(control_files)} items, but {control_set.path} "
            "is null: correct one of them, or calibrate again"
        )
    return Provenance(
        files,
        control_files,
        require_version(node.get("imucal_version")),
        require_date(node.get("date")),
        # Calibration files of older versions have no field `operator`.
        _name(node.get("operator"), empty=True) if "operator" in node.mapping() else "",
        _imported(node.get("imported")) if "imported" in node.mapping() else None,
        _sources(node.get("composed_of")) if "composed_of" in node.mapping() else (),
    )


def _sources(node: Node) -> tuple[Source, ...]:
    return tuple(Source(item.get("path").text(), require_sha256(item.get("sha256"))) for item in node.items())


def _imported(node: Node) -> Imported | None:
    if node.value is None:
        return None
    return Imported(
        node.get("format").text(),
        node.get("program").text(),
        node.get("formula").text(),
        _sources(node.get("files")),
        tuple(item.text() for item in node.get("missing").items()),
        tuple(item.text() for item in node.get("notes").items()),
    )


def _name(node: Node, *, empty: bool = False) -> str:
    """A name in a file. Raises FormatError for a name with characters that cannot be printed.

    empty   whether the name may be an empty text
    """
    if empty and node.value == "":
        return ""
    try:
        return require_name(node.value, f"{node.path}")
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None
