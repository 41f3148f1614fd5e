"""The correction without effects as C code in single precision, accurate to two units in the last place.

If T^-1 (raw - bias) is computed with a rounded T^-1, the error can reach four units. The largest coefficient,
its product, the difference from the bias and each sum contribute half a unit each, and twice as much if an
intermediate value has a larger exponent than the result. This code therefore keeps the low part of the
largest coefficient (the part lost by rounding) and adds the small terms first. It makes the difference
raw - bias exact (counts) or avoids this difference (SI units). The rounding errors of the product and of the
last sum remain.

The limit of two units applies if each sensor axis is close to a body axis. For other sensors, `Split.rest`
contains large coefficients whose low parts are lost, and errors of 3.1 units were measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.exporting.c_file import assigned_sum, matrix_constant
from imucal.exporting.model import inverse

__all__ = ["Split", "comment", "constants", "corrected_row", "split", "sum_function", "sum_of"]

# Value of `Split.axis` if each sensor axis is closest to the body axis of the same name.
ALONG_BODY: Final = (0, 1, 2)
# Parts of the C comment on the constants of the single-precision function: COMMENT for any unit, COMMENT_SI
# and COMMENT_COUNTS for raw samples in these units, COMMENT_AXIS if sensor axes are far from the body axes.
COMMENT: Final = (
    "    /* scale: largest coefficient of each row of T^-1, rounded to float.",
    "     * rest: the other coefficients, and the part of scale that is lost by rounding to float. With this",
    "     * part, and by adding the small terms first, the rounding error is below 2 units in the last place",
    "     * of the largest component instead of 3 to 4, if the sensor axes are close to the body axes and",
    "     * the effects are small.",
)
COMMENT_SI: Final = (
    "     * SI units: true = scale * raw + (offset + (rest * raw + offset_low)).",
    "     * offset + offset_low is -T^-1 bias.",
)
COMMENT_COUNTS: Final = (
    "     * Counts: true = scale * (raw - bias) + (rest * (raw - bias) + offset). bias is in whole counts,",
    "     * so that raw - bias is exact. offset corrects the remaining fraction of a count, in SI units.",
)
COMMENT_AXIS: Final = ("     * axis: index of the raw component that is multiplied by scale.",)


@dataclass(frozen=True)
class Split:
    """The correction of a triad in a form that single precision evaluates with a small error.

    true_i = scale_i x_(axis_i) + (offset_i + (sum_k rest_ik x_k + offset_low_i)),    x = raw - bias

    The exact correction is T^-1 (raw - b). The numbers are written in single precision.

    is_counts   whether the raw samples are counts
    axis        for each body axis, the index of the raw component with the largest coefficient: (0, 1, 2)
                unless the sensor axes are far from the body axes
    bias        for counts, b rounded to whole counts, so that its difference from counts is exact; for SI
                units zero, because the difference would be rounded
    scale       the largest coefficient of each row of T^-1
    rest        T^-1 without `scale`: the other coefficients, and the rounding error of the largest one
    offset      -T^-1 (b - bias)
    offset_low  rounding error of `offset`; negligible for counts, whose offset is half a count at most
    """

    is_counts: bool
    axis: tuple[int, ...]
    bias: Sequence[float]
    scale: Sequence[float]
    rest: Sequence[Sequence[float]]
    offset: Sequence[float]
    offset_low: Sequence[float]


def split(triad: Triad, unit: str) -> Split:
    """Split the correction of a triad into the parts of `Split`; `unit` is the unit of the raw samples."""
    rest = inverse(triad)
    is_counts = unit == "lsb"
    bias = _single(np.round(triad.bias)) if is_counts else np.zeros(3)
    exact_offset = -(rest @ (triad.bias - bias))
    offset = _single(exact_offset)
    axis = np.abs(rest).argmax(axis=1)
    largest = (np.arange(3), axis)
    scale = _single(rest[largest])
    rest[largest] -= scale
    return Split(
        is_counts=is_counts,
        axis=tuple(axis.tolist()),
        bias=bias.tolist(),
        scale=scale.tolist(),
        rest=rest.tolist(),
        offset=offset.tolist(),
        offset_low=(exact_offset - offset).tolist(),
    )


def _single(values: FloatArray) -> FloatArray:
    """The values rounded to single precision."""
    rounded: FloatArray = values.astype(np.float32).astype(np.float64)
    return rounded


def comment(splits: Sequence[Split]) -> list[str]:
    """C comment on the constants of the single-precision correction."""
    lines = [*COMMENT]
    if any(not parts.is_counts for parts in splits):
        lines += COMMENT_SI
    if any(parts.is_counts for parts in splits):
        lines += COMMENT_COUNTS
    if any(parts.axis != ALONG_BODY for parts in splits):
        lines += COMMENT_AXIS
    return [*lines[:-1], f"{lines[-1]} */"]


def constants(sensor: str, parts: Split, row: Callable[[Sequence[float]], str]) -> list[str]:
    """C constants of the single-precision correction of one sensor."""
    lines = []
    if parts.axis != ALONG_BODY:
        lines.append(f"    static const int {sensor}_axis[3] = {{{', '.join(map(str, parts.axis))}}};")
    if parts.is_counts:
        lines.append(f"    static const float {sensor}_bias[3] = {row(parts.bias)};")
    lines.append(f"    static const float {sensor}_scale[3] = {row(parts.scale)};")
    lines += matrix_constant(f"float {sensor}_rest", parts.rest, row)
    lines.append(f"    static const float {sensor}_offset[3] = {row(parts.offset)};")
    if not parts.is_counts:
        lines.append(f"    static const float {sensor}_offset_low[3] = {row(parts.offset_low)};")
    return lines


def corrected_row(
    target: str, sensor: str, raw: str, parts: Split, prefix: str, *, has_effects: bool
) -> list[str]:
    """C code of the single-precision correction of one sensor for the axis i, without effects.

    With effects, the large and the small part stay separate for the iteration that compensates the effects.
    """

    def measured(k: str) -> str:
        return f"({raw}[{k}] - {sensor}_bias[{k}])" if parts.is_counts else f"{raw}[{k}]"

    axis = "i" if parts.axis == ALONG_BODY else f"{sensor}_axis[i]"
    large = f"{sensor}_scale[i] * {measured(axis)}"
    last = f"{sensor}_offset[i]" if parts.is_counts else f"{sensor}_offset_low[i]"
    small = [*(f"{sensor}_rest[i][{k}] * {measured(str(k))}" for k in range(3)), last]
    if not has_effects:
        return [
            *assigned_sum(f"        {target}[i] =", small),
            f"        {target}[i] = {sum_of(large, sensor, f'{target}[i]', parts, prefix)};",
        ]
    total = sum_of(f"large_{target}[i]", sensor, f"small_{target}[i]", parts, prefix)
    return [
        f"        large_{target}[i] = {large};",
        *assigned_sum(f"        small_{target}[i] =", small),
        f"        {target}[i] = {total};",
    ]


def sum_of(large: str, sensor: str, small: str, parts: Split, prefix: str) -> str:
    """C expression of the corrected component i of one sensor from its large and its small part."""
    if parts.is_counts:
        return f"{large} + {f'({small})' if ' ' in small else small}"
    return f"{prefix}_sum_f32({large}, {sensor}_offset[i], {small})"


def sum_function(prefix: str) -> list[str]:
    """C function that adds the parts of a single-precision correction of SI units."""
    return [
        "/* large + (offset + small). The rounding error of the inner sum is added last, because it matters",
        " * if large and offset nearly cancel. -ffast-math would remove it. */",
        f"static inline float {prefix}_sum_f32(float large, float offset, float small)",
        "{",
        "    const float sum = offset + small;",
        "    return (large + sum) + (small - (sum - offset));",
        "}",
        "",
    ]
