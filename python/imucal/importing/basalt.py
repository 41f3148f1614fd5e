"""Basalt: the arrays calib_accel_bias (9 numbers) and calib_gyro_bias (12 numbers) of calibration.json.

    corrected = raw + S raw - b

b is the bias of a sensor, and S (3x3) corrects its scale and misalignment. Each array has the three biases,
then S column by column; S of the accelerometer is lower triangular (calib_bias.hpp of basalt-headers,
getBiasAndScale and getCalibrated). `imucal.exporting.basalt` defines the order of the entries.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.exporting.basalt import ENTRIES
from imucal.importing.source_format import Content, Found, Reader, Wanted, corrected_by

__all__ = ["BASALT"]

# Basalt's names of noise figures (continuous time, one per axis), and the names in a calibration file.
NOISE: Final = {
    "accel_noise_std": "accel_noise_density_{}_mps2_per_sqrt_hz",
    "gyro_noise_std": "gyro_noise_density_{}_radps_per_sqrt_hz",
    "accel_bias_std": "accel_random_walk_{}_mps3_per_sqrt_hz",
    "gyro_bias_std": "gyro_random_walk_{}_radps2_per_sqrt_hz",
}


def recognises(content: Content) -> bool:
    """Whether the file has one of Basalt's arrays.

    The arrays may be inside an object value0, which the serialisation library cereal writes.
    """
    return bool(_fields(content.fields).keys() & ENTRIES.keys())


def _fields(fields: dict[str, object]) -> dict[str, object]:
    inner = fields.get("value0")
    return inner if isinstance(inner, dict) else fields


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the biases and scales of both sensors, with the noise figures if the file has them."""
    node = contents[0].document
    assert node is not None
    if "value0" in node.mapping():
        node = node.get("value0")
    noise: dict[str, float] = {}
    for name, ours in NOISE.items():
        if name in node.mapping():
            noise |= {
                ours.format(axis): float(v) for axis, v in zip("xyz", _axes(node.get(name)), strict=True)
            }
    return Found(
        _triad(node.get("calib_accel_bias")),
        _triad(node.get("calib_gyro_bias")),
        noise=noise,
        missing=() if noise else ("noise",),
    )


def _triad(node: Node) -> Triad:
    entries = ENTRIES[node.path.rpartition(".")[2]]
    values = node.array(3 + len(entries))
    matrix = np.eye(3)
    for entry, value in zip(entries, values[3:], strict=True):
        matrix[entry] += value
    return corrected_by(matrix, values[:3])


def _axes(node: Node) -> list[float]:
    """A noise figure per axis. Older files have a common number for all axes."""
    return node.array(3).tolist() if isinstance(node.value, list) else [node.number()] * 3


BASALT: Final = Reader(
    name="basalt",
    title="Basalt: calibration.json",
    program="Basalt",
    formula="corrected = raw + S raw - b, for both sensors",
    source="basalt-headers, calib_bias.hpp, CalibAccelBias and CalibGyroBias",
    recognises=recognises,
    read=read,
    without="covariance, temperature",
)
