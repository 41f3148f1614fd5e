"""x-io Fusion: misalignment, sensitivity and offset of both sensors as C constants.

    calibrated = misalignment * hadamard(uncalibrated - offset, sensitivity)

Sources: FusionModelInertial in FusionModel.h (before Fusion 1.3: FusionCalibrationInertial in
FusionCalibration.h), and `imufusion.model_inertial` in Python. Fusion's AHRS expects deg/s and g, so the
sensitivities also convert from the raw units to deg/s and g.

The initialisers use the member names. FusionMatrix is a union whose first member is float[3][3] before
version 1.3 and float[9] from version 1.3. A list without names therefore has a different meaning in each
version. The member `element` has the same nine names in both versions.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.exporting.c_file import PREFIX, guarded, require_prefix
from imucal.exporting.format import Format, Written, block_comment, number
from imucal.exporting.model import FRAMES, linear, lost_effects
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["FUSION"]

PER_SI_UNIT: Final = {"gyroscope": 180 / np.pi, "accelerometer": 1 / STANDARD_GRAVITY_MPS2}


def write(calibration: Calibration, noise: NoiseResult | None, prefix: str | None = None) -> Written:
    """Write the C constants of both sensors.

    The sensitivity matrix is T = diag(gain) N, where the rows of N are the unit vectors of the sensor axes.
    The misalignment is N^-1.
    """
    start = f"{prefix}_" if prefix else ""
    lines = ['#include "Fusion.h"', ""]
    for sensor in ("gyroscope", "accelerometer"):
        triad = getattr(calibration, sensor)
        gain = np.linalg.norm(triad.sensitivity, axis=1)
        misalignment = np.linalg.inv(triad.sensitivity / gain[:, None])
        lines += [
            f"static const FusionMatrix {start}{sensor}Misalignment = {_matrix(misalignment)};",
            f"static const FusionVector {start}{sensor}Sensitivity = {_vector(PER_SI_UNIT[sensor] / gain)};",
            f"static const FusionVector {start}{sensor}Offset = {_vector(triad.bias)};",
            "",
        ]
    return Written(
        body="\n".join(guarded(lines[:-1], prefix or PREFIX, "fusion")),
        lost=lost_effects(calibration),
        same_as=linear(calibration),
        frame=FRAMES[calibration.frame],
        notes=(f"1 g is {STANDARD_GRAVITY_MPS2} m/s^2.",),
    )


def _matrix(matrix: FloatArray) -> str:
    rows = (
        ", ".join(f".{i}{j} = {number(value, single=True)}f" for j, value in zip("xyz", row, strict=True))
        for i, row in zip("xyz", matrix, strict=True)
    )
    return "{.element = {\n    " + ",\n    ".join(rows) + ",\n}}"


def _vector(values: FloatArray) -> str:
    entries = (f".{i} = {number(value, single=True)}f" for i, value in zip("xyz", values, strict=True))
    return f"{{.axis = {{{', '.join(entries)}}}}}"


def named(prefix: str) -> Format:
    """The export format with a prefix of its C names. Raises InputError for an invalid prefix."""
    require_prefix(prefix)
    return replace(FUSION, write=partial(write, prefix=prefix))


FUSION = Format(
    name="fusion",
    title="x-io Fusion constants",
    suffix=".h",
    formula="calibrated = misalignment * ((raw - offset) .* sensitivity)",
    source="xioTechnologies/Fusion, FusionModel.h, FusionModelInertial (before 1.3: FusionCalibration.h)",
    units="g and deg/s, float32",
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=block_comment,
    write=write,
    takes_counts=True,
    named=named,
)
