"""Kalibr: imu.yaml, and the blocks imu0, imu1, ... of its results.

    raw_accel = M_a (f + (0, (L r_y)_y, (L r_z)_z)) + b_a,      L r = dw/dt x r + w x (w x r)
    raw_gyro  = M_g C_gyro_i w + A C_gyro_i f + b_g

f and w are in the IMU frame i. So T of the accelerometer is M_a, T of the gyroscope is M_g C_gyro_i, and the
g-sensitivity in the body frame is T^-1 A C_gyro_i. Source: IccSensors.py of ethz-asl/kalibr,
addAccelerometerErrorTerms and addGyroscopeErrorTerms of IccScaledMisalignedImu and
IccScaledMisalignedSizeEffectImu. `imucal.exporting.kalibr` writes these files.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.effects.effect import EffectValues
from imucal.errors import FormatError, InputError
from imucal.exporting.kalibr import G_SENSITIVITY
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["KALIBR"]

MODELS: Final = ("calibrated", "scale-misalignment", "scale-misalignment-size-effect")
# Kalibr's names of noise figures (continuous time), and the names in a calibration file.
NOISE: Final = {
    "accelerometer_noise_density": "accel_noise_density_mps2_per_sqrt_hz",
    "accelerometer_random_walk": "accel_random_walk_mps3_per_sqrt_hz",
    "gyroscope_noise_density": "gyro_noise_density_radps_per_sqrt_hz",
    "gyroscope_random_walk": "gyro_random_walk_radps2_per_sqrt_hz",
}
# Largest accepted deviation of C_gyro_i from a rotation. The matrix is written with seven digits or more.
ROTATION_ROUNDING: Final = 1e-6


def recognises(content: Content) -> bool:
    """Whether a file is a result of Kalibr with blocks imu0, imu1, ..., or an imu.yaml."""
    return bool(_blocks(content)) or _is_imu(content.fields)


def _blocks(content: Content) -> list[str]:
    return sorted(name for name in content.fields if re.fullmatch(r"imu\d+", name))


def _is_imu(fields: object) -> bool:
    return isinstance(fields, dict) and bool(
        fields.keys() & NOISE.keys() or {"accelerometers", "gyroscopes"} <= fields.keys()
    )


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """The calibration in one block of the file."""
    (content,) = contents
    if content.document is None:
        raise FormatError(f"{content.name} is no YAML document")
    block, notes = content.document, []
    if blocks := _blocks(content):
        name = f"imu{wanted.instance}"
        if name not in blocks:
            raise InputError(
                f"{content.name} has {', '.join(blocks)}, but no {name}: give instance={blocks[0][3:]}"
            )
        if len(blocks) > 1:
            notes.append(f"{name} was read; the file also has {', '.join(b for b in blocks if b != name)}")
        block = content.document.get(name)
    fields = block.mapping()
    model = block.get("model").text(MODELS) if "model" in fields else None
    noise = {ours: block.get(name).number() for name, ours in NOISE.items() if name in fields}
    if "T_i_b" in fields and not np.allclose(rotation := block.get("T_i_b").array(4, 4)[:3, :3], np.eye(3)):
        notes.append(
            f"corrected samples are in the frame of this IMU; T_i_b, with the rotation {rotation.tolist()} "
            "from the frame of imu0, is not applied"
        )
    if model is None and not {"accelerometers", "gyroscopes"} & fields.keys():
        notes.append("the file contains noise figures and no correction: samples remain as they are")
    elif model == "calibrated":
        notes.append("Kalibr's model `calibrated` has no correction: samples remain as they are")
    else:
        return _corrected(block, noise, tuple(notes))
    neutral = Triad(np.eye(3), np.zeros(3))
    missing = tuple(
        f"{sensor}_{part}" for sensor in ("accel", "gyro") for part in ("bias", "scale", "misalignment")
    )
    return Found(neutral, neutral, noise=noise, missing=(*missing, *_without(noise)), notes=tuple(notes))


def _corrected(block: Node, noise: dict[str, float], notes: tuple[str, ...]) -> Found:
    """The calibration of a block with the model scale-misalignment or scale-misalignment-size-effect."""
    accelerometers, gyroscopes = block.get("accelerometers"), block.get("gyroscopes")
    from_body = accelerometers.get("M").array(3, 3)
    rotation = _rotation(gyroscopes.get("C_gyro_i"))
    gyro_from_body = gyroscopes.get("M").array(3, 3) @ rotation
    accelerometer, gyroscope = (Triad(matrix, np.zeros(3)) for matrix in (from_body, gyro_from_body))
    effects = []
    if (in_gyro := gyroscopes.get("A").array(3, 3)).any():
        in_body = np.linalg.solve(gyro_from_body, in_gyro @ rotation)
        effects.append(EffectValues(G_SENSITIVITY, np.asarray(in_body.ravel(), dtype=np.float64)))
    effects += _size_effect(accelerometers)
    return Found(
        accelerometer,
        gyroscope,
        tuple(effects),
        noise=noise,
        missing=("accel_bias", "gyro_bias", *_without(noise)),
        notes=(*notes, "Kalibr estimates the biases anew in each run: they remain in the corrected samples"),
    )


def _size_effect(accelerometers: Node) -> list[EffectValues]:
    """The positions of the axes as effects: lever arm of the x axis; positions of y and z relative to x."""
    names = ("rx_i", "ry_i", "rz_i")
    if not set(names) & accelerometers.mapping().keys():
        return []
    x, y, z = (accelerometers.get(name).array(3) for name in names)
    effects = []
    if x.any():
        effects.append(EffectValues("accel_lever_arm", x))
    if (relative := np.concatenate((y - x, z - x))).any():
        effects.append(EffectValues("accel_size_effect", relative))
    return effects


def _rotation(node: Node) -> FloatArray:
    matrix = node.array(3, 3)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_ROUNDING or np.linalg.det(matrix) < 0:
        raise FormatError(f"{node.file}: {node.path} is no rotation: the file is damaged, export it again")
    return matrix


def _without(noise: dict[str, float]) -> tuple[str, ...]:
    return () if noise else ("noise",)


KALIBR: Final = Reader(
    name="kalibr",
    title="Kalibr: imu.yaml, or the blocks imu0, imu1, ... of a result",
    program="Kalibr",
    formula="raw_accel = M_a f + b_a; raw_gyro = M_g C_gyro_i w + A C_gyro_i f + b_g, solved for f and w",
    source="ethz-asl/kalibr, IccSensors.py, IccScaledMisalignedImu and IccScaledMisalignedSizeEffectImu",
    recognises=recognises,
    read=read,
    without="biases, covariance, temperature",
)
