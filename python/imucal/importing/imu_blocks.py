"""Blocks imu0, imu1, ... in YAML files of Kalibr and OpenVINS: their noise figures, frames and rotations."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.json_document import Node
from imucal.errors import FormatError, InputError
from imucal.importing.source_format import Content

__all__ = ["NOISE", "block_of", "imu_blocks", "noise_of", "rotation_in"]

# For each noise figure (continuous time): its name in files of Kalibr and OpenVINS, and its name in a
# calibration file of imucal.
NOISE: Final = {
    "accelerometer_noise_density": "accel_noise_density_mps2_per_sqrt_hz",
    "accelerometer_random_walk": "accel_random_walk_mps3_per_sqrt_hz",
    "gyroscope_noise_density": "gyro_noise_density_radps_per_sqrt_hz",
    "gyroscope_random_walk": "gyro_random_walk_radps2_per_sqrt_hz",
}
# Largest accepted deviation of a matrix from a rotation. Files state the matrix with seven digits or more, so
# rounding errors are smaller.
ROTATION_ROUNDING: Final = 1e-6


def imu_blocks(content: Content) -> list[str]:
    """The names of the blocks of IMUs in a file."""
    return sorted(name for name in content.fields if re.fullmatch(r"imu\d+", name))


def block_of(content: Content, instance: int) -> tuple[Node, list[str]]:
    """The block of one IMU, or the whole file if it has no blocks; and notes on unused contents."""
    if content.document is None:
        raise FormatError(f"{content.name} is no YAML document")
    block, notes = content.document, []
    if blocks := imu_blocks(content):
        name = f"imu{instance}"
        if name not in blocks:
            raise InputError(
                f"{content.name} has {', '.join(blocks)}, but no {name}: give instance={blocks[0][3:]}"
            )
        if len(blocks) > 1:
            notes.append(f"{name} was read; the file also has {', '.join(b for b in blocks if b != name)}")
        block = content.document.get(name)
    if "T_i_b" in block.mapping() and not np.allclose(
        rotation := block.get("T_i_b").array(4, 4)[:3, :3], np.eye(3)
    ):
        notes.append(
            f"corrected samples are in the frame of this IMU; T_i_b, with the rotation {rotation.tolist()} "
            "from the frame of imu0, is not applied"
        )
    return block, notes


def noise_of(block: Node) -> dict[str, float]:
    """The noise figures in a block, named as in a calibration file."""
    return {ours: block.get(name).number() for name, ours in NOISE.items() if name in block.mapping()}


def rotation_in(node: Node) -> FloatArray:
    """Read a rotation matrix. Raises FormatError for any other matrix."""
    matrix = node.array(3, 3)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_ROUNDING or np.linalg.det(matrix) < 0:
        raise FormatError(f"{node.file}: {node.path} is no rotation: the file is damaged, export it again")
    return matrix
