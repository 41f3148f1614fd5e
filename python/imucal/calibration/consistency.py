"""Check that a calibration file does not contradict itself.

The file repeats the matrices as a table of parameters, the covariance as standard deviations, the raw units
as units of the parameters, and the frame in words. The check makes a new document from the calibration that
was read, and compares each of these fields of the file with the same field of the new document. A tolerance
allows for numbers that were rounded by hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES, Frame, Parameter, base_count
from imucal.document.agreement import ROUNDING, Origin, require_agreement
from imucal.document.json_document import Node
from imucal.errors import FormatError

__all__ = ["origins_of", "require_covariance", "require_written_again"]

WAY_OUT: Final = "correct one of them, or calibrate again"
# Fields that files of older versions of imucal do not have.
OPTIONAL: Final = frozenset(
    {
        "axes",
        "reference_temperature_degc",
        "operator",
        "imported",
        "composed_of",
        "references",
        "verdict",
        "reasons",
    }
)
# Accepted relative difference between two copies of a standard deviation in a file. It is larger than the
# error of rounding to four significant digits (5e-4).
STD_ROUNDING: Final = 1e-3
# Accepted difference between two copies of a parameter value in a file, as a fraction of its standard
# deviation. A difference this small has no significant effect on corrected samples.
SHARE_OF_STD: Final = 0.01
# Accepted difference between two copies of a value in a file, which allows for rounding to nine decimals. For
# an entry of a sensitivity, the difference is relative to the largest entry of the matrix. For a bias, it is
# in the raw unit. The limit does not apply to values of effects.
DECIMALS_ROUNDING: Final = 1e-9
# Largest accepted magnitude of a negative eigenvalue of the correlation matrix. Rounding the entries to seven
# digits can cause negative eigenvalues, but of smaller magnitude.
CORRELATION_ROUNDING: Final = 1e-5


def require_written_again(
    node: Node, written: Mapping[str, Any], parameters: Sequence[Parameter], frame: Frame
) -> None:
    """Raise FormatError for the first field of the file that differs from the same field in `written`.

    written      the document that is made from the calibration that was read
    parameters   the parameters of the calibration
    """
    origins = origins_of(written, parameters, frame)
    require_agreement(
        node,
        written,
        origin=lambda path: origins.get(path, Origin("the rest of the file")),
        optional=OPTIONAL,
        way_out=WAY_OUT,
    )


def origins_of(
    written: Mapping[str, Any], parameters: Sequence[Parameter], frame: Frame
) -> dict[str, Origin]:
    """Map the path of each repeated field to the field that it repeats and the accepted difference."""
    places = _places(written, frame)
    names = [] if written["covariance"] is None else written["covariance"]["names"]
    variances = {name: f"$.covariance.matrix[{k}][{k}]" for k, name in enumerate(names)}
    sizes = {
        sensor: max(abs(number) for row in written[key]["T"] for number in row)
        for sensor, key in (("accel", "accelerometer"), ("gyro", "gyroscope"))
        if written[key] is not None
    }
    base = base_count(frame, has_gyroscope=written["gyroscope"] is not None)
    origins = {
        "$.model": Origin("this version of the schema"),
        "$.body_frame": Origin("$.accelerometer.frame"),
        "$.parameters": Origin("the matrices with $.effects"),
    }
    for k, parameter in enumerate(parameters):
        place, unit_place = places[parameter.name]
        scale = (
            sizes[parameter.name.partition("_")[0]] if "_sensitivity_" in parameter.name and k < base else 1.0
        )
        tolerance = max(DECIMALS_ROUNDING * scale if k < base else 0.0, SHARE_OF_STD * (parameter.std or 0.0))
        std = Origin(
            f"the root of {variances[parameter.name]}" if parameter.name in variances else "$.covariance",
            relative=STD_ROUNDING,
        )
        row = f"$.parameters[{k}]"
        origins |= {
            f"{row}.name": Origin(f"the order of the parameters with {place}"),
            f"{row}.value": Origin(place, tolerance),
            f"{row}.std": std,
            f"{row}.unit": Origin(unit_place),
        }
        if k >= base:
            origins[place.removesuffix("value") + "std"] = std
    return origins


def _places(written: Mapping[str, Any], frame: Frame) -> dict[str, tuple[str, str]]:
    """Map the name of each parameter to the paths of its value and of its unit in the document."""
    places = {}
    for sensor, key, entries in (
        ("accel", "accelerometer", ACCEL_ENTRIES[frame]),
        ("gyro", "gyroscope", GYRO_ENTRIES),
    ):
        if written[key] is None:
            continue
        unit = f"$.raw_units.{key}"
        for k, axis in enumerate("xyz"):
            places[f"{sensor}_bias_{axis}"] = (f"$.{key}.bias[{k}]", unit)
        for entry in entries:
            row, column = ("xyz".index(axis) for axis in entry)
            places[f"{sensor}_sensitivity_{entry}"] = (f"$.{key}.T[{row}][{column}]", unit)
    for k, effect in enumerate(written["effects"]):
        numbers = [(f"parameters[{j}]", number) for j, number in enumerate(effect["parameters"])]
        for field, number in [*numbers, *([("shape", effect["shape"])] if effect["shape"] else [])]:
            path = f"$.effects[{k}].{field}"
            places[f"{effect['name']}_{number['name']}"] = (f"{path}.value", f"{path}.unit")
    return places


def require_covariance(node: Node, parameters: Sequence[str]) -> None:
    """Raise FormatError unless `node` contains a covariance matrix whose rows have the order of `parameters`.

    node         the field `covariance` of the file, which is not null
    parameters   names of all parameters in their order
    """
    names, following = [item.text() for item in node.get("names").items()], iter(parameters)
    for k, name in enumerate(names):
        if name not in parameters:
            raise FormatError(
                f"{node.file}: {node.path}.names[{k}] is {name}, but $.parameters has no such parameter: "
                f"{WAY_OUT}"
            )
        if name not in following:
            raise FormatError(
                f"{node.file}: {node.path}.names[{k}] is {name}, but $.parameters[{parameters.index(name)}] "
                "is already named above. The covariance lists the parameters in the order of $.parameters: "
                "restore that order of the names, or calibrate again"
            )
    matrix = node.get("matrix").array(len(names), len(names))
    place = f"{node.path}.matrix"
    variance = np.diag(matrix)
    for k in np.flatnonzero(variance < 0).tolist():
        raise FormatError(f"{node.file}: {place}[{k}][{k}] is {variance[k]}: a variance is not negative")
    _require_symmetric(node, place, matrix)
    known = np.flatnonzero(variance > 0)
    sigma = np.sqrt(variance[known])
    correlation = matrix[np.ix_(known, known)] / sigma[:, None] / sigma
    smallest = float(np.linalg.eigvalsh(correlation)[0]) if len(known) else 0.0
    if smallest < -CORRELATION_ROUNDING:
        raise FormatError(
            f"{node.file}: {place} is no covariance matrix: its correlations have the eigenvalue "
            f"{smallest:.3g}, and none may be negative: {WAY_OUT}"
        )


def _require_symmetric(node: Node, place: str, matrix: FloatArray) -> None:
    """Raise FormatError if entries (i, j) and (j, i) differ, or if a correlation is above 1 in magnitude."""
    size, other = np.abs(matrix), np.abs(matrix).T
    sigma = np.sqrt(np.diag(matrix))
    sigmas = sigma[:, None] * sigma
    differs = np.abs(matrix - matrix.T) > 1e-12 * sigmas + ROUNDING * np.maximum(size, other)
    for i, j in np.argwhere(differs).tolist():
        raise FormatError(
            f"{node.file}: {place}[{i}][{j}] is {matrix[i, j]}, but {place}[{j}][{i}] is {matrix[j, i]}: a "
            f"covariance matrix is symmetric: {WAY_OUT}"
        )
    for i, j in np.argwhere(size > sigmas * (1.0 + CORRELATION_ROUNDING)).tolist():
        raise FormatError(
            f"{node.file}: {place}[{i}][{j}] is {matrix[i, j]}, but {place}[{i}][{i}] and {place}[{j}][{j}] "
            f"allow at most {sigmas[i, j]:.6g}: a correlation is at most 1: {WAY_OUT}"
        )
