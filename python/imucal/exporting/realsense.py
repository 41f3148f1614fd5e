"""RealSense: calibration.json of rs-imu-calibration, and the camera's own calibration table.

    corrected = S raw - bias

Source: correct_motion_helper in motion-transform.cpp of librealsense. S is the inverse of the sensitivity T
of imucal; librealsense calls S `sensitivity`. Both files contain S column by column (float3x3 in float3.h).
In calibration.json the bias of the gyroscope is in rad/s, as rs-imu-calibration writes it. In the table it is
in deg/s, because librealsense multiplies the value in the table by pi / 180
(dm_v2_imu_calib_parser::get_intrinsic in ds-calib-parsers.cpp).

The table is the EEPROM image of 520 bytes that rs-imu-calibration.py writes to the camera (dm_v2_eeprom in
ds-private.h). It consists of three nested tables. Each table starts with a header of 16 bytes, which contains
the CRC-32 of the content.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.calibration.calibration import Calibration
from imucal.exporting.format import SI, Format, Written, in_json
from imucal.exporting.model import FRAMES, inverse, linear, lost_effects

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["REALSENSE", "REALSENSE_TABLE"]


RECORD: Final = (
    "Record with motion correction switched off (enable_motion_correction 0), in the frame of the "
    "depth sensor, which is librealsense's default."
)
# Layout of the table, in bytes, and the values of its headers (ds-private.h and rs-imu-calibration.py).
EEPROM_SIZE: Final = 520
HEADER_SIZE: Final = 16
EXTRINSIC_SIZE: Final = 48
RESERVED_SIZE: Final = 96
SERIAL_NUMBER_SIZE: Final = 32
EEPROM_VERSION, MODULE_VERSION, IMU_VERSION = b"\x01\x01", b"\x02\x00", b"\x02\x01"
EEPROM_TYPE, IMU_TYPE = 0x09, 0x20
UNUSED: Final = b"\xff"
NOT_VALID, VALID = 0, 1


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write S = T^-1 and T^-1 b of both sensors as JSON; T is the sensitivity and b the bias of a sensor."""
    imu = {}
    for sensor in ("accelerometer", "gyroscope"):
        triad = getattr(calibration, sensor)
        correction = inverse(triad)
        imu[sensor] = {
            "scale_and_alignment": correction.T.ravel().tolist(),
            "bias": (correction @ triad.bias).tolist(),
        }
    return Written(
        body=json.dumps({"device_type": "D435i", "imus": [imu]}),
        lost=lost_effects(calibration),
        same_as=linear(calibration),
        frame=FRAMES[calibration.frame],
        notes=(
            RECORD,
            "The biases are in m/s^2 and rad/s, as rs-imu-calibration writes them. The camera does not "
            "read this file, and its own table has the bias of the gyroscope in deg/s: use --to "
            "realsense-table for it.",
        ),
    )


def write_table(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the calibration table as an EEPROM image, which consists of three nested tables."""
    numbers = []
    for sensor, per_si in (("accelerometer", 1.0), ("gyroscope", 180 / np.pi)):
        triad = getattr(calibration, sensor)
        correction = inverse(triad)
        # The order in the table: the entries of S column by column, then the bias.
        numbers += [*correction.T.ravel(), *(per_si * (correction @ triad.bias))]
    flags = bytes([NOT_VALID, VALID, 0, 0])
    imu = flags + UNUSED * EXTRINSIC_SIZE + struct.pack("<24f", *numbers) + UNUSED * RESERVED_SIZE
    module = _table(IMU_VERSION, IMU_TYPE, imu) + UNUSED * SERIAL_NUMBER_SIZE
    image = _table(MODULE_VERSION, IMU_TYPE, module)
    image += UNUSED * (EEPROM_SIZE - HEADER_SIZE - len(image))
    return Written(
        body="",
        lost=lost_effects(calibration),
        same_as=linear(calibration),
        frame=FRAMES[calibration.frame],
        notes=(
            RECORD,
            "The numbers are float32. The bias of the gyroscope is in deg/s, because librealsense "
            "multiplies it by pi / 180.",
            "Write it to the camera by write_eeprom_to_camera(numpy.fromfile(FILE, numpy.uint8)) of "
            "rs-imu-calibration.py. This replaces the camera's calibration table of the IMU. As with "
            "rs-imu-calibration.py, the extrinsics are then those of the camera's mechanical drawing.",
        ),
        binary=_table(EEPROM_VERSION, EEPROM_TYPE, image),
    )


def _table(version: bytes, kind: int, content: bytes) -> bytes:
    """The bytes of a table: table_header of ds-private.h (version, type, size, CRC-32), then the content."""
    return version + struct.pack("<HIII", kind, len(content), 0xFFFFFFFF, zlib.crc32(content)) + content


def header_alone(lines: Sequence[str], body: str) -> str:
    """The header as text, to be printed, because the EEPROM table cannot contain a header."""
    return "\n".join(lines) + "\n"


REALSENSE = Format(
    name="realsense",
    title="RealSense calibration.json",
    suffix=".json",
    formula="corrected = S raw - bias for both sensors, S being scale_and_alignment column by column",
    source="librealsense, motion-transform.cpp and tools/rs-imu-calibration",
    units=SI,
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=in_json,
    write=write,
)

REALSENSE_TABLE: Final = Format(
    name="realsense-table",
    title="RealSense calibration table, EEPROM image of D435i, D455 and later",
    suffix=".bin",
    formula="corrected = S raw - bias for both sensors; the table has the bias of the gyroscope in deg/s",
    source="librealsense, ds-private.h, ds-calib-parsers.cpp, motion-transform.cpp and "
    "tools/rs-imu-calibration",
    units=SI + ", float32",
    includes="bias, scale and misalignment of both sensors",
    omits="all effects, noise figures",
    layout=header_alone,
    write=write_table,
    is_binary=True,
)
