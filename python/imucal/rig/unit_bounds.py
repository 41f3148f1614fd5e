"""Checks of the datasheet figures in a unit file.

The figures must not contradict each other, and they must be possible for real sensors.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np

from imucal.document.agreement import require_fields
from imucal.document.json_document import Node
from imucal.errors import FormatError

__all__ = [
    "ENTRY_ROUNDING",
    "LARGEST",
    "SENSITIVITY",
    "require_figure",
    "require_sensor",
    "require_tolerance",
]

FIGURE_FIELDS: Final = ("value", "unit", "source", "note", "limit")
# Fields of a sensor in a unit file that are not datasheet figures with a value and a unit.
OTHERS: Final = ("part", "averaging")
# Datasheet figures that cannot be zero.
POSITIVE: Final = ("range", "resolution", "bits", "bandwidth", "filter", "output_rate")
# Largest accepted datasheet figures, by SI unit of the sensor. The noise density is at most 50 mg/sqrt(Hz) or
# 6 deg/s/sqrt(Hz), fifty times the noise density of the noisiest MEMS sensors. The bias is at most 10 g or
# 2000 deg/s. The range is at most 10,000 g or 100,000 deg/s.
LARGEST: Final[dict[str, dict[str, float]]] = {
    "m/s^2": {"noise_density": 0.5, "bias": 98.0665, "random_walk": 1.0, "range": 98_066.5},
    "rad/s": {"noise_density": 0.1, "bias": 34.9066, "random_walk": 1.0, "range": 1_745.33},
}
LARGEST_HZ: Final = 1e6
LARGEST_BITS: Final = 32.0
# Largest accepted ratio of the noise in motion to the noise at rest.
LARGEST_FACTOR: Final = 1e3
# The entries ij and ji of a symmetric sensitivity may differ by this share of the largest entry, because of
# rounding.
ENTRY_ROUNDING: Final = 1e-7
# Accepted range of the sensitivity in SI units, in which 1 is perfect. A sensitivity outside this range means
# that its unit is wrong.
SENSITIVITY: Final = (0.2, 5.0)
# Accepted ratio of the specified measurement range to the range that the counts can represent. In some
# sensors the counts can represent twice the specified range.
SHARE_OF_COUNTS: Final = (0.45, 1.05)
# Largest accepted tolerance of a scale factor (50 %) or a misalignment (0.5 rad, about 30 deg).
LARGEST_TOLERANCE: Final = 0.5
# Largest accepted tolerance of an effect, as a multiple of its typical size.
LARGEST_EFFECT: Final = 1e5


def require_sensor(node: Node, found: Mapping[str, Any], unit: str, sources: Collection[str]) -> None:
    """Raise FormatError for datasheet figures of a sensor that contradict each other or are impossible.

    found     the figures by name in SI units, without those that are null
    unit      SI unit of the measured quantity
    sources   names of the sources of the file
    """
    for name in node.mapping():
        if name not in OTHERS and node.get(name).value is not None:
            require_figure(node.get(name), sources)
    largest = {
        **LARGEST[unit],
        "noise_density_one_sided": LARGEST[unit]["noise_density"],
        "allan_floor": LARGEST[unit]["bias"],
        "bias_instability": LARGEST[unit]["bias"],
        "noise_in_motion": LARGEST_FACTOR,
        "bits": LARGEST_BITS,
        **dict.fromkeys(("bandwidth", "filter", "output_rate"), LARGEST_HZ),
    }
    for name, value in found.items():
        signed = name in ("bias", "sensitivity")
        low = -np.inf if signed else 0.0
        sizes = np.abs(value) if signed else np.asarray(value)
        if not (sizes >= low).all() or (name in POSITIVE and not (sizes > 0).all()):
            raise FormatError(
                f"{node.file}: {node.path}.{name}.value is {_given(node, name)}: give a positive one"
            )
        if not (sizes <= largest.get(name, np.inf)).all():
            raise FormatError(
                f"{node.file}: {node.path}.{name} is {_given(node, name)}, more than the {largest[name]:.4g} "
                "in SI units that a sensor can have: correct the number or its unit"
            )
    if "bits" in found and found["bits"] != int(found["bits"]):
        raise FormatError(f"{node.file}: {node.path}.bits.value is {found['bits']}: give a whole number")
    _require_range_of_counts(node, found)
    if {"bandwidth", "output_rate"} <= found.keys() and found["bandwidth"] > found["output_rate"]:
        raise FormatError(
            f"{node.file}: {node.path}.bandwidth is {found['bandwidth']:g} Hz, but {node.path}.output_rate "
            f"is {found['output_rate']:g} Hz; the bandwidth must be the smaller number: correct one of them"
        )
    if "sensitivity" in found:
        _require_sensitivity(
            node.get("sensitivity").get("value"), found["sensitivity"], is_frame=unit == "m/s^2"
        )


def require_tolerance(
    node: Node, value: Any, name: str, typical: float | None, largest: Mapping[str, float]
) -> None:
    """Raise FormatError if the tolerance of a randomly drawn parameter is zero, negative or impossible.

    value     the tolerance in SI units
    typical   typical size if the parameter is an effect, otherwise None
    largest   the largest accepted tolerance of parameters that are no effects, by name
    """
    most = LARGEST_EFFECT * typical if typical is not None else largest.get(name, LARGEST_TOLERANCE)
    if not (np.asarray(value) > 0).all() or not (np.asarray(value) <= most).all():
        raise FormatError(
            f"{node.file}: {node.path} is {node.get('value').value} {node.get('unit').value}: a tolerance is "
            f"positive and at most {most:.4g} in SI units: correct the number or its unit"
        )


def require_figure(node: Node, sources: Collection[str]) -> None:
    """Raise FormatError if a datasheet figure has an unknown field, or a source that the file lacks."""
    require_fields(node, FIGURE_FIELDS, "a figure")
    if "source" in node.mapping():
        source = node.get("source").text()
        if source not in sources:
            raise FormatError(
                f"{node.file}: {node.path}.source is {source!r}, but $.sources has "
                f"{', '.join(sources) or 'none'}: "
                "correct one of them"
            )
    if "note" in node.mapping():
        node.get("note").text()


def _require_range_of_counts(node: Node, found: Mapping[str, Any]) -> None:
    if not {"range", "resolution", "bits"} <= found.keys():
        return
    counts = found["resolution"] * 2.0 ** (found["bits"] - 1)
    low, high = SHARE_OF_COUNTS
    if not low <= found["range"] / counts <= high:
        raise FormatError(
            f"{node.file}: {node.path}.range is {_given(node, 'range')}, but {node.path}.resolution of "
            f"{_given(node, 'resolution')} with {node.path}.bits of {found['bits']:g} gives "
            f"{counts:.4g} in SI units: correct one of them"
        )


def _require_sensitivity(node: Node, matrix: Any, *, is_frame: bool) -> None:
    """Raise FormatError unless `matrix` is a valid sensitivity; with `is_frame` it must be symmetric."""
    if is_frame:
        for row, column in ((1, 0), (2, 0), (2, 1)):
            if abs(matrix[row, column] - matrix[column, row]) > ENTRY_ROUNDING * np.abs(matrix).max():
                raise FormatError(
                    f"{node.file}: {node.path}[{row}][{column}] is {matrix[row, column]}, but "
                    f"{node.path}[{column}][{row}] is {matrix[column, row]}: in the body frame of a unit "
                    "file, which is symmetric, both must be the same number: correct one of the numbers"
                )
    sizes = np.linalg.svd(matrix / np.abs(matrix).max(), compute_uv=False) * np.abs(matrix).max()
    if not (SENSITIVITY[0] <= sizes[-1] and sizes[0] <= SENSITIVITY[1]) or np.linalg.det(matrix) <= 0:
        raise FormatError(
            f"{node.file}: {node.path} is {matrix.tolist()}: 1 is perfect, and no sensor has less than "
            f"{SENSITIVITY[0]:g}, more than {SENSITIVITY[1]:g}, or a negative determinant: correct it"
        )


def _given(node: Node, name: str) -> str:
    """The value and the unit of the entry `name`, as they are written in the file."""
    figure = node.get(name)
    return f"{figure.get('value').value} {figure.get('unit').value}"
