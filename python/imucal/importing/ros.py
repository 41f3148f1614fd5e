"""ROS: the calibration file of the package imu_calib, which calibrates only the accelerometer.

    corrected_accel = SM raw - bias

SM is stored by rows (AccelCalib::loadCalib and applyCalib in accel_calib.cpp of dpkoch/imu_calib). The file
contains no gyroscope bias; the node apply_calib estimates it as the mean rate after its start.
`imucal.exporting.ros` writes this file.
"""

from __future__ import annotations

from typing import Final

from imucal.importing.source_format import Content, Found, Reader, Wanted, corrected_by

__all__ = ["ROS"]


def recognises(content: Content) -> bool:
    """Whether the file has the matrix SM."""
    return "SM" in content.fields


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of the accelerometer."""
    document = contents[0].document
    assert document is not None
    matrix = document.get("SM").array(9).reshape(3, 3)
    return Found(
        corrected_by(matrix, document.get("bias").array(3)),
        None,
        missing=("noise",),
        notes=("the node apply_calib subtracts the mean of its first gyroscope samples from the rate",),
    )


ROS: Final = Reader(
    name="ros",
    title="ROS package imu_calib: YAML with SM and bias",
    program="imu_calib",
    formula="corrected_accel = SM raw - bias",
    source="dpkoch/imu_calib, accel_calib.cpp, applyCalib",
    recognises=recognises,
    read=read,
    without="gyroscope, covariance, temperature, noise",
)
