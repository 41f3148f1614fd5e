"""OpenVINS: the blocks imu0, imu1, ... of kalibr_imu_chain.yaml.

    force = R_IMUtoACC^T D_a (raw_accel - b_a)
    rate  = R_IMUtoGYRO^T D_w (raw_gyro - Tg force - b_g)

R_IMUtoACC and R_IMUtoGYRO are rotations, Tg is the g-sensitivity, and b_a and b_g are the biases. D_a and D_w
are the triangular parts of Ta^-1 and Tw^-1: the lower parts in the models `kalibr` and `calibrated`, the
upper parts in the model `rpng`. So the g-sensitivity in the body frame is T^-1 Tg, where T is the sensitivity
of the gyroscope. Sources: print_and_load_state in VioManagerOptions.h, print in StateOptions.h, and
Propagator.cpp of rpng/open_vins. `imucal.exporting.openvins` writes these files.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from imucal.effects.effect import EffectValues
from imucal.exporting.kalibr import G_SENSITIVITY
from imucal.importing.imu_blocks import block_of, imu_blocks, noise_of, rotation_in
from imucal.importing.source_format import Content, Found, Reader, Wanted, corrected_by

__all__ = ["OPENVINS"]

MATRICES: Final = ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC", "Tg")
# For each value of the field `model`: the function that keeps the triangular part of Ta^-1 and Tw^-1 that
# OpenVINS uses with this model.
TRIANGLES: Final = {"kalibr": np.tril, "calibrated": np.tril, "rpng": np.triu}


def recognises(content: Content) -> bool:
    """Whether a block of the file has a matrix with a name of OpenVINS."""
    blocks = [content.fields[name] for name in imu_blocks(content)]
    return any(isinstance(block, dict) and block.keys() & set(MATRICES) for block in blocks)


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration from one block of the file."""
    (content,) = contents
    block, notes = block_of(content, wanted.instance)
    fields = block.mapping()
    model = block.get("model").text(tuple(TRIANGLES)) if "model" in fields else "kalibr"
    triads = {}
    for name, to_sensor in (("Ta", "R_IMUtoACC"), ("Tw", "R_IMUtoGYRO")):
        triangle = TRIANGLES[model](np.linalg.inv(block.get(name).array(3, 3)))
        triads[name] = corrected_by(rotation_in(block.get(to_sensor)).T @ triangle, np.zeros(3))
    effects = []
    if (from_force := block.get("Tg").array(3, 3)).any():
        in_body = np.linalg.solve(triads["Tw"].sensitivity, from_force)
        effects.append(EffectValues(G_SENSITIVITY, np.asarray(in_body.ravel(), dtype=np.float64)))
    noise = noise_of(block)
    return Found(
        triads["Ta"],
        triads["Tw"],
        tuple(effects),
        noise=noise,
        missing=("accel_bias", "gyro_bias", *(() if noise else ("noise",))),
        notes=(*notes, "OpenVINS estimates the biases: they remain in the corrected samples"),
    )


OPENVINS: Final = Reader(
    name="openvins",
    title="OpenVINS: kalibr_imu_chain.yaml, models kalibr, calibrated and rpng",
    program="OpenVINS",
    formula="f = R_IMUtoACC^T D_a (raw_accel - b_a); w = R_IMUtoGYRO^T D_w (raw_gyro - Tg f - b_g)",
    source="rpng/open_vins, VioManagerOptions.h, StateOptions.h and Propagator.cpp",
    recognises=recognises,
    read=read,
    without="biases, covariance, temperature",
)
