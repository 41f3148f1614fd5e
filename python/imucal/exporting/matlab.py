"""MATLAB and Octave: a function that corrects arrays of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucal.calibration.calibration import Calibration
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.model import FRAMES, linear, lost_effects

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["MATLAB"]


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the MATLAB function. Each row of its arrays is one sample, as in `Calibration.apply`."""
    has_gyroscope = calibration.gyroscope is not None
    lines = [
        "function [rate, force] = imucal_correct(raw_rate, raw_force)"
        if has_gyroscope
        else "function force = imucal_correct(raw_force)"
    ]
    for name, triad in (("gyro", calibration.gyroscope), ("accel", calibration.accelerometer)):
        if triad is None:
            continue
        rows = "; ".join(", ".join(number(value) for value in row) for row in triad.sensitivity)
        lines.append(f"{name}_T = [{rows}];")
        lines.append(f"{name}_bias = [{', '.join(number(value) for value in triad.bias)}];")
    lines += [
        *(["rate = bsxfun(@minus, raw_rate, gyro_bias) / gyro_T';"] if has_gyroscope else []),
        "force = bsxfun(@minus, raw_force, accel_bias) / accel_T';",
        "end",
        "",
    ]
    return Written(
        body="\n".join(lines),
        lost=lost_effects(calibration),
        same_as=linear(calibration),
        frame=FRAMES[calibration.frame],
        notes=("Save the file as imucal_correct.m. Arrays are N-by-3, rows are samples.",),
    )


MATLAB = Format(
    name="matlab",
    title="MATLAB or Octave function",
    suffix=".m",
    formula="true = T^-1 (raw - bias); for arrays with one sample per row: (raw - bias) / T'",
    source="this function",
    units=SI,
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=line_comments("%"),
    write=write,
    takes_counts=True,
    needs_gyroscope=False,
)
