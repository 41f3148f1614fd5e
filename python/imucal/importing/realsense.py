"""RealSense: calibration.json of rs-imu-calibration, and the IMUInfo messages of the ROS driver.

    corrected = S raw - bias

calibration.json has S column by column (`scale_and_alignment`), IMUInfo has the 3x4 matrix (S | bias) row by
row. Sources: correct_motion_helper in motion-transform.cpp and operator* of float3x3 in float3.h of
librealsense, rs-imu-calibration.py, create_motion_intrinsics in ds-private.h. `imucal.exporting.realsense`
writes calibration.json.
"""

from __future__ import annotations

from typing import Final

from imucal.calibration.triad import Triad
from imucal.document.json_document import Node
from imucal.errors import FormatError, InputError
from imucal.importing.source_format import Content, Found, Reader, Wanted, corrected_by

__all__ = ["IMU_INFO", "REALSENSE"]

SENSORS: Final = {"accel": "accelerometer", "gyro": "gyroscope"}


def is_calibration(content: Content) -> bool:
    """Whether the file is a calibration.json of rs-imu-calibration."""
    return isinstance(content.fields.get("imus"), list)


def read(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration of one IMU in the file."""
    (content,) = contents
    assert content.document is not None
    device = content.document.mapping().get("device_type")
    if isinstance(device, str) and device.upper().startswith("T2"):
        raise InputError(
            f"{content.name} is of a {device}, whose files have another order of the matrix entries than "
            "files of rs-imu-calibration (D435i, D455, L515), so it cannot be read"
        )
    imus = content.document.get("imus").items()
    if not wanted.instance < len(imus):
        raise InputError(f"{content.name} has {len(imus)} IMUs, numbered from 0: give instance=0")
    imu = imus[wanted.instance]
    triads = {}
    for sensor in SENSORS.values():
        node = imu.get(sensor)
        # The matrix is transposed, because the array is stored by columns and numpy's reshape fills rows.
        matrix = node.get("scale_and_alignment").array(9).reshape(3, 3).T
        triads[sensor] = corrected_by(matrix, node.get("bias").array(3))
    return Found(triads["accelerometer"], triads["gyroscope"], missing=("noise",), notes=(NOTE,))


def is_info(content: Content) -> bool:
    """Whether the file is a dump of IMUInfo messages."""
    return bool(_messages(content))


def _messages(content: Content) -> list[Node]:
    if content.document is None:
        return []
    value = content.document.value
    nodes = content.document.items() if isinstance(value, list) else [content.document]
    return [n for n in nodes if isinstance(n.value, dict) and {"data", "noise_variances"} <= n.value.keys()]


def read_info(contents: tuple[Content, ...], wanted: Wanted) -> Found:
    """Read the calibration from the messages of both sensors, in one file or in two."""
    triads: dict[str, Triad] = {}
    for node in (message for content in contents for message in _messages(content)):
        matrix = node.get("data").array(12).reshape(3, 4)
        sensor = _sensor(node)
        if sensor in triads:
            raise FormatError(f"{node.file}: {node.path}: a second message of the {sensor}: give one of each")
        triads[sensor] = corrected_by(matrix[:, :3], matrix[:, 3])
    return Found(triads.get("accelerometer"), triads.get("gyroscope"), missing=("noise",), notes=(NOTE,))


def _sensor(node: Node) -> str:
    """The sensor of a message, identified by its frame name, such as camera_accel_optical_frame."""
    header = node.get("header") if "header" in node.mapping() else node
    frame = header.get("frame_id").text()
    found = [name for word, name in SENSORS.items() if word in frame.lower()]
    if len(found) != 1:
        raise FormatError(
            f"{node.file}: {header.path}.frame_id is {frame!r}: a frame of accel or gyro is needed"
        )
    return found[0]


NOTE: Final = (
    "raw samples are samples with motion correction switched off (enable_motion_correction 0), along the "
    "axes of the depth sensor: x right, y down, z forward"
)

REALSENSE: Final = Reader(
    name="realsense",
    title="RealSense: calibration.json of rs-imu-calibration",
    program="librealsense",
    formula="corrected = S raw - bias for both sensors, S being scale_and_alignment column by column",
    source="librealsense, motion-transform.cpp, correct_motion_helper; rs-imu-calibration.py",
    recognises=is_calibration,
    read=read,
    without="covariance, temperature, noise",
)

IMU_INFO: Final = Reader(
    name="realsense-imu-info",
    title="RealSense: IMUInfo messages of the ROS driver as YAML (`ros2 topic echo`), one file or two",
    program="librealsense",
    formula="corrected = S raw - bias for both sensors, data being the 3x4 matrix of S and bias row by row",
    source="librealsense, ds-private.h, create_motion_intrinsics; motion-transform.cpp",
    recognises=is_info,
    read=read_info,
    without="covariance, temperature, noise",
    files=(1, 2),
)
