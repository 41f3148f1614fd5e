"""RealSense: the calibration table of the IMU in a camera, an EEPROM image of 520 bytes.

    corrected = S raw - bias

S is stored column by column, in float32, and the bias of the gyroscope in deg/s (dm_v2_eeprom in ds-private.h
and dm_v2_imu_calib_parser in ds-calib-parsers.cpp of librealsense). `imucal.exporting.realsense` writes this
image.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import FormatError
from imucal.exporting.realsense import (
    EEPROM_SIZE,
    EEPROM_TYPE,
    EEPROM_VERSION,
    EXTRINSIC_SIZE,
    HEADER_SIZE,
    VALID,
)
from imucal.importing.realsense import NOTE
from imucal.importing.source_format import Content, Found, Reader, Wanted, corrected_by

__all__ = ["REALSENSE_TABLE"]

# Position of the flags of the IMU's table: after the headers of the image, of the module and of the table.
FLAGS: Final = 3 * HEADER_SIZE
NUMBERS: Final = FLAGS + 4 + EXTRINSIC_SIZE
# If the gyroscope bias in the table is numerically at most this value, a note says that it may be in rad/s
# instead of deg/s. Gyroscopes of these cameras have biases of up to 1 deg/s, which is 0.017 rad/s.
IN_RADIANS: Final = 0.02


def recognises(content: Content) -> bool:
    """Whether the file starts with the version and type in the header of the EEPROM image."""
    return content.data.startswith(EEPROM_VERSION + struct.pack("<H", EEPROM_TYPE))


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration from the contents of the camera's EEPROM.

    Raises FormatError if librealsense would reject these contents: wrong size, wrong CRC, or no valid
    numbers.
    """
    (content,) = contents
    data = content.data
    if len(data) != EEPROM_SIZE:
        raise FormatError(f"{content.name} has {len(data)} bytes: a table has {EEPROM_SIZE}, read it again")
    if struct.unpack_from("<I", data, 12)[0] != zlib.crc32(data[HEADER_SIZE:]):
        raise FormatError(f"{content.name}: the CRC is wrong: the file is damaged, read it again")
    if data[FLAGS + 1] != VALID:
        raise FormatError(f"{content.name}: the table has no valid intrinsics: the camera is not calibrated")
    numbers = np.frombuffer(data, "<f4", count=24, offset=NUMBERS).astype(np.float64)
    if not np.isfinite(numbers).all():
        raise FormatError(f"{content.name}: a number is not finite: write the table again")
    (accel, accel_bias), (gyro, bias_dps) = (
        (part[:9].reshape(3, 3).T, part[9:]) for part in (numbers[:12], numbers[12:])
    )
    return Found(
        corrected_by(accel, accel_bias),
        corrected_by(gyro, np.radians(bias_dps)),
        missing=("noise",),
        notes=(NOTE, *_unit_of(bias_dps)),
    )


def _unit_of(bias_dps: FloatArray) -> tuple[str, ...]:
    """A note if the gyroscope bias may be in rad/s, the unit that rs-imu-calibration.py writes."""
    largest = float(np.abs(bias_dps).max())
    if not 0.0 < largest < IN_RADIANS:
        return ()
    return (
        f"the bias of the gyroscope is up to {largest:.2g} deg/s: if rs-imu-calibration.py has written this "
        "table, the number is in rad/s, and the camera corrects only 1/57 of the bias, as this calibration "
        "does",
    )


REALSENSE_TABLE: Final = Reader(
    name="realsense-table",
    title="RealSense: calibration table of the camera, EEPROM image of 520 bytes",
    program="librealsense",
    formula="corrected = S raw - bias for both sensors; the table has the bias of the gyroscope in deg/s",
    source="librealsense, ds-private.h, ds-calib-parsers.cpp and motion-transform.cpp",
    recognises=recognises,
    read=read,
    without="covariance, temperature, noise",
)
