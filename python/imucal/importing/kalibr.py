"""Kalibr: imu.yaml, and the blocks imu0, imu1, ... of its results.

    raw_accel = M_a (f + (0, (L r_y)_y, (L r_z)_z)) + b_a,      L r = dw/dt x r + w x (w x r)
    raw_gyro  = M_g C_gyro_i w + A C_gyro_i f + b_g

f and w are the true force and rate in the IMU frame i. r_y and r_z are the positions of the accelerometer's y
and z axes relative to its x axis. C_gyro_i is a rotation, A is the g-sensitivity, and b_a and b_g are the
biases. So the sensitivity of the accelerometer is M_a, that of the gyroscope is T = M_g C_gyro_i, and the
g-sensitivity in the body frame is T^-1 A C_gyro_i. Source: IccSensors.py of ethz-asl/kalibr,
addAccelerometerErrorTerms and addGyroscopeErrorTerms of IccScaledMisalignedImu and
IccScaledMisalignedSizeEffectImu. `imucal.exporting.kalibr` writes these files.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.effects.effect import EffectValues
from imucal.exporting.kalibr import G_SENSITIVITY
from imucal.importing.imu_blocks import NOISE, block_of, imu_blocks, noise_of, rotation_in
from imucal.importing.openvins import OPENVINS
from imucal.importing.source_format import Content, Found, Reader, Wanted

__all__ = ["KALIBR"]

MODELS: Final = ("calibrated", "scale-misalignment", "scale-misalignment-size-effect")


def recognises(content: Content) -> bool:
    """Whether a file is a result of Kalibr with blocks imu0, imu1, ..., or an imu.yaml.

    Files of OpenVINS also have such blocks, but they are not recognised as files of Kalibr.
    """
    if OPENVINS.recognises(content):
        return False
    return bool(imu_blocks(content)) or _is_imu(content.fields)


def _is_imu(fields: object) -> bool:
    return isinstance(fields, dict) and bool(
        fields.keys() & NOISE.keys() or {"accelerometers", "gyroscopes"} <= fields.keys()
    )


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration from one block of the file."""
    (content,) = contents
    block, notes = block_of(content, wanted.instance)
    fields, noise = block.mapping(), noise_of(block)
    model = block.get("model").text(MODELS) if "model" in fields else None
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
    rotation = rotation_in(gyroscopes.get("C_gyro_i"))
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
    """The positions of the accelerometer's axes as effects.

    One effect is the lever arm of the x axis, the other the positions of the y and z axes relative to x.
    """
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
