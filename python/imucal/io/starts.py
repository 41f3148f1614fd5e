"""Bytes at the start of files by which formats are recognised."""

from __future__ import annotations

from typing import Final

__all__ = [
    "DATAFLASH_MAGIC",
    "MATLAB_MAGIC",
    "PARQUET_MAGIC",
    "REALSENSE_HEADER",
    "ROS1_MAGIC",
    "ULOG_MAGIC",
]

DATAFLASH_MAGIC: Final = b"\xa3\x95"
# First bytes of MAT-files of level 5 (MATLAB 5 to 7.2) and of version 7.3. Files of level 4 have no fixed
# first bytes.
MATLAB_MAGIC: Final = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
PARQUET_MAGIC: Final = b"PAR1"
# Start of the header that rs-convert and rs-data-collect write.
REALSENSE_HEADER: Final = b"Stream Type,F#,HW Timestamp (ms)"
# First bytes of a ROS 1 bag.
ROS1_MAGIC: Final = b"#ROSBAG V"
ULOG_MAGIC: Final = b"ULog\x01\x12\x35"
