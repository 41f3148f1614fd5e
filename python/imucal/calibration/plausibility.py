"""Checks that the numbers of a calibration file agree with its body frame and are possible for sensors."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.triad import Frame, Triad
from imucal.document.json_document import Node
from imucal.errors import FormatError
from imucal.rig import unit_bounds
from imucal.rig.unit_bounds import ENTRY_ROUNDING, LARGEST

__all__ = [
    "BIAS",
    "SENSITIVITY",
    "require_accelerometer",
    "require_gravity",
    "require_gyroscope",
    "require_noise",
    "require_temperature_range",
]

AGAIN: Final = "correct it, or calibrate again"
# Accepted range of the sensitivity by sensor and raw unit, in raw units per SI unit. In counts, the lower
# limits are those of converters of 8 bits for +-30 g (0.43 per m/s^2) and +-4000 deg/s (1.8 per rad/s), and
# the upper limits are those of converters of 32 bits for +-1 g and +-10 deg/s, with a margin.
SENSITIVITY: Final[dict[tuple[str, str], tuple[float, float]]] = {
    ("accelerometer", "m/s^2"): unit_bounds.SENSITIVITY,
    ("gyroscope", "rad/s"): unit_bounds.SENSITIVITY,
    ("accelerometer", "lsb"): (0.4, 3e8),
    ("gyroscope", "lsb"): (1.5, 2e10),
}
# Largest accepted bias by raw unit. In counts it is 2^33. Counts of 32 bits are below 2^32, and the factor of
# two allows for an offset.
BIAS: Final = {**{unit: most["bias"] for unit, most in LARGEST.items()}, "lsb": 2.0**33}
# Largest accepted noise densities and random walks. The keys are the units in the names of the noise figures.
NOISE: Final = {
    "mps2": LARGEST["m/s^2"]["noise_density"],
    "radps": LARGEST["rad/s"]["noise_density"],
    "mps3": LARGEST["m/s^2"]["random_walk"],
    "radps2": LARGEST["rad/s"]["random_walk"],
}
NOISE_UNITS: Final = {
    ("accel", "noise_density"): "mps2",
    ("gyro", "noise_density"): "radps",
    ("accel", "random_walk"): "mps3",
    ("gyro", "random_walk"): "radps2",
}
# Accepted temperatures, degC: the specified range of MEMS sensors with a margin.
TEMPERATURE_DEGC: Final = (-60.0, 150.0)


def require_accelerometer(node: Node, triad: Triad, frame: Frame, unit: str) -> None:
    """Raise FormatError unless an accelerometer can have this sensitivity and bias in this body frame."""
    matrix, T = triad.sensitivity, node.get("T")
    rounding = ENTRY_ROUNDING * float(np.abs(matrix).max())
    for row, column in ((1, 0), (2, 0), (2, 1)):
        lower, upper = float(matrix[row, column]), float(matrix[column, row])
        places = (f"{T.path}[{row}][{column}]", f"{T.path}[{column}][{row}]")
        if frame == "symmetric" and abs(lower - upper) > rounding:
            raise FormatError(
                f"{node.file}: {places[0]} is {lower}, but {places[1]} is {upper}: in the frame "
                f"{node.path}.frame, symmetric, both are the same number: correct one of them"
            )
        if frame == "triangular" and abs(upper) > rounding:
            raise FormatError(
                f"{node.file}: {places[1]} is {upper}, but in the frame {node.path}.frame, triangular, it is "
                f"0: {AGAIN}"
            )
    if frame == "given":
        _require_range(node, triad, "accelerometer", unit)
        return
    smallest = float(np.linalg.eigvalsh((matrix + matrix.T) / 2.0)[0] if frame == "symmetric" else 1.0)
    if smallest <= 0.0:
        raise FormatError(
            f"{node.file}: {T.path} has the eigenvalue {smallest:.6g}, but in the frame {node.path}.frame, "
            f"symmetric, all are positive: {AGAIN}"
        )
    _require_positive_diagonal(node, T, matrix, frame)
    _require_range(node, triad, "accelerometer", unit)


def require_gyroscope(node: Node, triad: Triad, frame: Frame, unit: str) -> None:
    """Raise FormatError unless a gyroscope can have this sensitivity and bias.

    The determinant of the sensitivity must be positive, because the body frame is right-handed. In the frame
    "given" a negative determinant is accepted.
    """
    determinant = float(np.linalg.det(triad.sensitivity / np.abs(triad.sensitivity).max()))
    if determinant <= 0.0 and frame != "given":
        raise FormatError(
            f"{node.file}: {node.path}.T has a negative determinant, but the body frame of the accelerometer "
            f"is right-handed: {AGAIN}"
        )
    _require_range(node, triad, "gyroscope", unit)


def _require_positive_diagonal(node: Node, T: Node, matrix: FloatArray, frame: Frame) -> None:
    for axis in range(3):
        if matrix[axis, axis] <= 0.0:
            raise FormatError(
                f"{node.file}: {T.path}[{axis}][{axis}] is {matrix[axis, axis]}, but in the frame "
                f"{node.path}.frame, {frame}, it is positive: {AGAIN}"
            )


def _require_range(node: Node, triad: Triad, sensor: str, unit: str) -> None:
    low, high = SENSITIVITY[sensor, unit]
    sizes = np.linalg.svd(triad.sensitivity, compute_uv=False)
    smallest, largest = float(sizes[-1]), float(sizes[0])
    if not (low <= smallest and largest <= high):
        si_unit = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}[sensor]
        wrong = smallest if smallest < low else largest
        raise FormatError(
            f"{node.file}: {node.path}.T is about {wrong:.3g} {unit} per {si_unit}, but $.raw_units.{sensor} "
            f"is {unit}, in which sensors have sensitivities of {low:g} to {high:g} {unit} per {si_unit}: "
            "correct the unit, or calibrate again"
        )
    for axis, bias in enumerate(triad.bias.tolist()):
        if abs(bias) > BIAS[unit]:
            raise FormatError(
                f"{node.file}: {node.path}.bias[{axis}] is {bias} {unit}, beyond the {BIAS[unit]:.4g} {unit} "
                f"that a sensor can have: {AGAIN}"
            )


def require_gravity(node: Node) -> float:
    """Read local gravity, m/s^2. Raises FormatError if this gravity occurs nowhere on Earth."""
    gravity, (low, high) = node.number(), _core.GRAVITY_ON_EARTH_MPS2
    if not low <= gravity <= high:
        raise FormatError(
            f"{node.file}: {node.path} is {gravity}, but on Earth gravity is {low} to {high} m/s^2: {AGAIN}"
        )
    return gravity


def require_temperature_range(node: Node) -> tuple[float, float] | None:
    """Read the lowest and the highest temperature, degC.

    Raises FormatError if the order of the two temperatures is reversed, or if one of them is impossible.
    """
    if node.value is None:
        return None
    low, high = node.array(2).tolist()
    if low > high:
        raise FormatError(
            f"{node.file}: {node.path}[0] is {low}, but {node.path}[1] is {high}: the lowest temperature "
            "comes first: exchange them"
        )
    for index, degc in enumerate((low, high)):
        if not TEMPERATURE_DEGC[0] <= degc <= TEMPERATURE_DEGC[1]:
            raise FormatError(
                f"{node.file}: {node.path}[{index}] is {degc} degC, outside {TEMPERATURE_DEGC[0]:g} to "
                f"{TEMPERATURE_DEGC[1]:g} degC: convert it from its unit, or calibrate again"
            )
    return low, high


def require_noise(node: Node) -> dict[str, float]:
    """Read the noise figures, such as noise densities, by name.

    Raises FormatError for an unknown name, a missing axis, or noise that no sensor has.
    """
    figures = {name: node.get(name).number() for name in node.mapping()}
    for name, value in figures.items():
        parts = re.fullmatch(
            r"(accel|gyro)_(noise_density|random_walk)(_[xyz])?_([a-z]+[23]?)_per_sqrt_hz", name
        )
        if parts is None or NOISE_UNITS[parts[1], parts[2]] != parts[4]:
            raise FormatError(
                f"{node.file}: {node.path}.{name} is not the name of a noise figure. Names are, for example, "
                "gyro_noise_density_x_radps_per_sqrt_hz or accel_noise_density_x_mps2_per_sqrt_hz"
            )
        if not 0.0 <= value <= NOISE[parts[4]]:
            raise FormatError(
                f"{node.file}: {node.path}.{name} is {value}, but the noise of a sensor is 0 to "
                f"{NOISE[parts[4]]}: {AGAIN}"
            )
        others = [name.replace(f"{parts[3]}_", f"_{axis}_", 1) for axis in "xyz"] if parts[3] else []
        missing = [other for other in others if other not in figures]
        if missing:
            raise FormatError(f"{node.file}: {node.path} has {name}, but not {missing[0]}: {AGAIN}")
    return figures
